"""The executables of this package: each imports its node when it is called."""

from quadftc_ros.starting import executable

controller = executable("quadftc_control.controller_node")
position_controller = executable("quadftc_control.position_controller_node")
reference = executable("quadftc_control.reference_node")
