"""The executables of this package: each imports its node when it is called."""

from quadftc_ros.starting import executable

fault_observer = executable("quadftc_fdi.fault_observer_node")
attitude_estimator = executable("quadftc_fdi.attitude_estimator_node")
disturbance_observer = executable("quadftc_fdi.disturbance_observer_node")
