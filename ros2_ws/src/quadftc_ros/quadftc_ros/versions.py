"""The versions that a bag or a summary states."""

from __future__ import annotations

import importlib.util
import os
import platform

from quadftc_model.versions import software_version


def versions() -> dict[str, str]:
    """Return the versions of this software and of what it stands on."""
    from importlib.metadata import version  # takes long to import

    found = {
        "quadftc": software_version(),
        "python": platform.python_version(),
        "mcap": version("mcap"),
        "numpy": version("numpy"),
    }
    if importlib.util.find_spec("rclpy") is not None:
        from rclpy.utilities import get_rmw_implementation_identifier

        found["ros_distro"] = os.environ.get("ROS_DISTRO", "jazzy")
        found["rmw_implementation"] = get_rmw_implementation_identifier()
    return found
