"""The one table of the graph: every topic with its type, who publishes it, who reads it, and how.

Names without a leading slash are relative: they follow the namespace of the vehicle. Every message begins
with a stamp, which equals the stamp of the IMU sample it belongs to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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

BASE_FRAME = "base_link"  # body, FLU (REP-103)
IMU_FRAME = "imu_link"  # the IMU, aligned with the body (REP-145)
EARTH_FRAME = "map"  # ENU (REP-105)


@dataclass(frozen=True)
class Topic:
    """One topic of the graph."""

    name: str  # relative to the vehicle's namespace, or absolute with a leading slash
    type_name: str  # ``package/msg/Name``
    publishers: tuple[str, ...]  # names of the nodes
    readers: tuple[str, ...]  # names of the nodes; the recorder, which may read anything, is not listed
    qos: QosClass  # see `quadftc_ros.qos`
    frame: str = ""  # of its header; empty: it has none


NODES = ("plant", "fault_injector", "fault_observer", "disturbance_observer", "controller", "reference")

_ROWS = (
    Topic("plant/imu", IMU, ("plant",), ("fault_injector",), "sensor", IMU_FRAME),
    Topic(
        "imu/data",
        IMU,
        ("fault_injector",),
        ("fault_observer", "reference", "controller"),
        "sensor",
        IMU_FRAME,
    ),
    Topic(
        "imu/corrected", IMU, ("fault_observer",), ("disturbance_observer", "controller"), "sensor", IMU_FRAME
    ),
    Topic("fault/estimate", VECTOR, ("fault_observer",), (), "reliable", EARTH_FRAME),
    Topic("fault/status", FAULT_STATUS, ("fault_observer",), ("controller",), "reliable", IMU_FRAME),
    Topic("disturbance/estimate", VECTOR, ("disturbance_observer",), ("controller",), "reliable", BASE_FRAME),
    Topic("attitude/reference", REFERENCE, ("reference",), ("controller",), "reliable", EARTH_FRAME),
    Topic("attitude/setpoint", VECTOR, (), ("reference",), "reliable", EARTH_FRAME),
    Topic(
        "torque/command",
        VECTOR,
        ("controller",),
        ("plant", "fault_observer", "disturbance_observer"),
        "reliable",
        BASE_FRAME,
    ),
    Topic("control/status", CONTROL_STATUS, ("controller",), (), "reliable", BASE_FRAME),
    # real time: the last words of an observer that has fallen silent, for the one started in its place
    Topic("fault/kept", FAULT_STATUS, ("controller",), ("fault_observer",), "latched", IMU_FRAME),
    Topic("gyro/kept", VECTOR, ("controller",), ("fault_observer",), "latched", BASE_FRAME),
    Topic("disturbance/kept", VECTOR, ("controller",), ("disturbance_observer",), "latched", BASE_FRAME),
    Topic("plant/attitude", VECTOR, ("plant",), (), "reliable", EARTH_FRAME),
    Topic("plant/rate", VECTOR, ("plant",), (), "reliable", BASE_FRAME),
    Topic("disturbance/applied", VECTOR, ("plant",), (), "reliable", BASE_FRAME),
    Topic("fault/injected", VECTOR, ("fault_injector",), (), "reliable", EARTH_FRAME),
    Topic("fault/injected/gyro", VECTOR, ("fault_injector",), (), "reliable", IMU_FRAME),
    Topic("fault/injected/accelerometer", VECTOR, ("fault_injector",), (), "reliable", IMU_FRAME),
    Topic("fault/dropped", HEADER, ("fault_injector",), ("plant",), "reliable", IMU_FRAME),
    Topic("/diagnostics", DIAGNOSTICS, NODES, (), "reliable"),
    Topic("/clock", CLOCK, ("plant",), (), "clock"),  # read by whoever sets use_sim_time
)

TOPICS: Mapping[str, Topic] = MappingProxyType({row.name: row for row in _ROWS})


def missing_connections(node: str, counts: Mapping[str, int], recorders: int = 0) -> list[str]:
    """Say which connections a node lacks to be part of a whole graph.

    ``counts`` are those of `GraphNode.connections`; ``recorders`` read every output besides the table.
    """
    missing: list[str] = []
    for topic, count in counts.items():
        row = TOPICS[topic]
        if node in row.publishers:
            wanted, kind = len(row.readers) + recorders, "readers"
        else:
            wanted, kind = len(row.publishers), "publishers"
        if count < wanted:
            missing.append(f"{topic}: {count} of {wanted} {kind}")
    return missing


def crowded_topics(count_publishers: Callable[[str], int]) -> list[str]:
    """Say which topics have more publishers than one graph gives them: another graph is there, too.

    ``count_publishers`` is that of a node in the namespace of the graph.
    """
    counts = {name: count_publishers(name) for name in TOPICS if not name.startswith("/")}
    return [
        f"{name} has {count} publishers"
        for name, count in counts.items()
        if TOPICS[name].publishers and count > len(TOPICS[name].publishers)
    ]
