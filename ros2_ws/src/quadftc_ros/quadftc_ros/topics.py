"""The one table of the graph: every topic with its type, who publishes it, who reads it, and how.

Names without a leading slash are relative: they follow the namespace of the vehicle. Every message begins
with a stamp, which equals the stamp of the IMU sample it belongs to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

QosClass = Literal["sensor", "reliable", "latched", "clock"]

IMU = "sensor_msgs/msg/Imu"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
HEADER = "std_msgs/msg/Header"
FAULT_STATUS = "quadftc_msgs/msg/FaultStatus"
REFERENCE = "quadftc_msgs/msg/AttitudeReference"
CONTROL_STATUS = "quadftc_msgs/msg/ControlStatus"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
CLOCK = "rosgraph_msgs/msg/Clock"


@dataclass(frozen=True)
class Topic:
    """One topic of the graph.

    Parameters
    ----------
    name : str
        Relative to the vehicle's namespace, or absolute with a leading slash.
    type_name : str
        Message type, ``package/msg/Name``.
    publishers, readers : tuple of str
        Names of the nodes that publish and subscribe; the recorder, which may read anything, is not listed.
    qos : str
        ``sensor``: best effort in real time; ``reliable``: in order, none lost; ``latched``: the last message
        also reaches a late reader; ``clock``: the clock of a simulation.
    """

    name: str
    type_name: str
    publishers: tuple[str, ...]
    readers: tuple[str, ...]
    qos: QosClass


NODES = ("plant", "fault_injector", "fault_observer", "disturbance_observer", "controller", "reference")

_ROWS = (
    Topic("plant/imu", IMU, ("plant",), ("fault_injector",), "sensor"),
    Topic("imu/data", IMU, ("fault_injector",), ("fault_observer", "reference", "controller"), "sensor"),
    Topic("imu/corrected", IMU, ("fault_observer",), ("disturbance_observer", "controller"), "sensor"),
    Topic("fault/estimate", VECTOR, ("fault_observer",), (), "reliable"),
    Topic("fault/status", FAULT_STATUS, ("fault_observer",), ("controller",), "reliable"),
    Topic("disturbance/estimate", VECTOR, ("disturbance_observer",), ("controller",), "reliable"),
    Topic("attitude/reference", REFERENCE, ("reference",), ("controller",), "reliable"),
    Topic("attitude/setpoint", VECTOR, (), ("reference",), "reliable"),
    Topic(
        "torque/command",
        VECTOR,
        ("controller",),
        ("plant", "fault_observer", "disturbance_observer"),
        "reliable",
    ),
    Topic("control/status", CONTROL_STATUS, ("controller",), (), "reliable"),
    # real time: the last words of an observer that has fallen silent, for the one started in its place
    Topic("fault/kept", FAULT_STATUS, ("controller",), ("fault_observer",), "latched"),
    Topic("gyro/kept", VECTOR, ("controller",), ("fault_observer",), "latched"),
    Topic("disturbance/kept", VECTOR, ("controller",), ("disturbance_observer",), "latched"),
    Topic("plant/attitude", VECTOR, ("plant",), (), "reliable"),
    Topic("plant/rate", VECTOR, ("plant",), (), "reliable"),
    Topic("disturbance/applied", VECTOR, ("plant",), (), "reliable"),
    Topic("fault/injected", VECTOR, ("fault_injector",), (), "reliable"),
    Topic("fault/injected/gyro", VECTOR, ("fault_injector",), (), "reliable"),
    Topic("fault/injected/accelerometer", VECTOR, ("fault_injector",), (), "reliable"),
    Topic("fault/dropped", HEADER, ("fault_injector",), ("plant",), "reliable"),
    Topic("/diagnostics", DIAGNOSTICS, NODES, (), "reliable"),
    Topic("/clock", CLOCK, ("plant",), (), "clock"),  # read by whoever sets use_sim_time
)

TOPICS: Mapping[str, Topic] = MappingProxyType({row.name: row for row in _ROWS})
