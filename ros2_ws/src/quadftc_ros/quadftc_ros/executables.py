"""The executables of this package: each imports its node when it is called."""

from quadftc_ros.starting import executable

recorder = executable("quadftc_ros.recorder_node")
scene = executable("quadftc_ros.scene_node")
