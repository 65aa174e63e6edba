"""The executables of this package: each imports its node when it is called."""

from quadftc_ros.starting import executable

guardian = executable("quadftc_sitl.guardian_node")
