"""Quality of service of every topic and service, in one place.

class      realtime                      lockstep                  used for
sensor     best effort, keep last 50     reliable, keep last 1000  IMU samples
reliable   reliable, keep last 100       reliable, keep last 1000  estimates, torque, status, truth
latched    reliable, transient local, 1  the same                  what a late reader needs
clock      best effort, keep last 1      reliable, keep last 1000  /clock

In lock-step none may be lost: the depth is what a recorder in another process may lag behind. In real time
IMU samples are not sent again: best effort, as in the sensor-data convention of ROS 2, also matches real
drivers. The depth is more than its five, as a node that was held up works samples off faster than an observer
a gap.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from quadftc_ros.topics import QosClass

LOCKSTEP_DEPTH = 1000  # messages a recorder may lag behind: seconds of flight
SERVICE_DEPTH = 1000  # requests that may wait: a burst of injections must not be lost


def topic_profile(kind: QosClass, mode: str) -> QoSProfile:
    """Return the profile that publishers and subscribers of a class of topics use in a mode."""
    reliable = kind in ("reliable", "latched") or mode == "lockstep"
    depth = {"sensor": 50, "reliable": 100, "latched": 1, "clock": 1}[kind]
    if mode == "lockstep" and kind != "latched":
        depth = LOCKSTEP_DEPTH
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kind == "latched" else DurabilityPolicy.VOLATILE,
    )


def service_profile() -> QoSProfile:
    """Return the profile of services whose requests may come in bursts."""
    volatile = DurabilityPolicy.VOLATILE
    return QoSProfile(depth=SERVICE_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=volatile)
