"""The executables of this package: each imports its node when it is called."""

from quadftc_ros.starting import executable

plant = executable("quadftc_sim.plant_node")
fault_injector = executable("quadftc_sim.fault_injector_node")
ardupilot_backend = executable("quadftc_sim.ardupilot_backend_node")
betaflight_backend = executable("quadftc_sim.betaflight_backend_node")
