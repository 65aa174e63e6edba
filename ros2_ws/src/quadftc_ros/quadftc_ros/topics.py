"""The one table of the graph: every topic with its type, who publishes it, who reads it, and how.

Names without a leading slash are relative: they follow the namespace of the vehicle. Every message begins
with a stamp, which equals the stamp of the IMU sample it belongs to.

Each kind of plant has a graph of its own. On the test stand, node `reference` gives the attitude to follow,
and the plant takes torques. In free flight, `position_controller` gives attitude and thrust, and the plant
takes rotor speeds. `policy.BESIDE` has what other nodes publish besides.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

QosClass = Literal["sensor", "reliable", "latched", "clock"]
PlantKind = Literal["test_stand", "free_flight"]

IMU = "sensor_msgs/msg/Imu"
FIELD = "sensor_msgs/msg/MagneticField"
PRESSURE = "sensor_msgs/msg/FluidPressure"
ROTORS = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
HEADER = "std_msgs/msg/Header"
FAULT_STATUS = "quadftc_msgs/msg/FaultStatus"
DIAGNOSIS = "quadftc_msgs/msg/Diagnosis"
REFERENCE = "quadftc_msgs/msg/AttitudeReference"
ROTOR_CONDITION = "quadftc_msgs/msg/RotorCondition"
ROTOR_STATUS = "quadftc_msgs/msg/RotorStatus"
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
    frame: str  # of its header; empty: it has none
    plants: tuple[PlantKind, ...]  # kinds of plant whose graph has it


STAND: tuple[PlantKind, ...] = ("test_stand",)
FREE: tuple[PlantKind, ...] = ("free_flight",)
PLANT_KINDS = (*STAND, *FREE)

_IN_BOTH = ("plant", "fault_injector", "fault_observer", "disturbance_observer", "controller")
NODES: Mapping[PlantKind, tuple[str, ...]] = MappingProxyType(
    {"test_stand": (*_IN_BOTH, "reference"), "free_flight": (*_IN_BOTH, "position_controller")}
)
OPTIONAL_NODES = ("attitude_estimator",)  # no part of a flight in simulation
_ALL_NODES = " ".join(dict.fromkeys(sum(NODES.values(), ())))


def _topic(
    name: str,
    type_name: str,
    publishers: str,
    readers: str,
    qos: QosClass,
    frame: str = "",
    plants: tuple[PlantKind, ...] = PLANT_KINDS,
) -> Topic:
    return Topic(name, type_name, tuple(publishers.split()), tuple(readers.split()), qos, frame, plants)


_ATTITUDE_SOURCES = "reference position_controller"  # one of them
_IMU_READERS = "fault_observer reference controller"
_CORRECTED_READERS = "disturbance_observer controller position_controller"
_TORQUE_READERS = "fault_observer disturbance_observer"
_POSITION_READERS = "fault_observer position_controller"

_ROWS = (
    _topic("plant/imu", IMU, "plant", "fault_injector", "sensor", IMU_FRAME),
    _topic("imu/data", IMU, "fault_injector", _IMU_READERS, "sensor", IMU_FRAME),
    _topic("imu/corrected", IMU, "fault_observer", _CORRECTED_READERS, "sensor", IMU_FRAME),
    # a driver without attitude: `attitude_estimator` makes imu/data of these. A plant that has a magnetometer
    # or a barometer publishes them, too; no node waits for it
    _topic("imu/data_raw", IMU, "", "attitude_estimator", "sensor", IMU_FRAME),
    _topic("imu/mag", FIELD, "", "attitude_estimator", "sensor", IMU_FRAME),
    _topic("imu/static_pressure", PRESSURE, "", "", "sensor", IMU_FRAME, FREE),
    _topic("mocap/pose", POSE, "", "attitude_estimator", "sensor", EARTH_FRAME),
    _topic("fault/estimate", VECTOR, "fault_observer", "", "reliable", EARTH_FRAME),
    _topic("fault/status", FAULT_STATUS, "fault_observer", "controller", "reliable", IMU_FRAME),
    _topic("diagnosis", DIAGNOSIS, "fault_observer", "", "reliable", IMU_FRAME),
    _topic("disturbance/estimate", VECTOR, "disturbance_observer", "controller", "reliable", BASE_FRAME),
    _topic("attitude/reference", REFERENCE, _ATTITUDE_SOURCES, "controller", "reliable", EARTH_FRAME),
    _topic("attitude/setpoint", VECTOR, "", "reference", "reliable", EARTH_FRAME, STAND),
    _topic("position/data", ODOMETRY, "plant", _POSITION_READERS, "sensor", EARTH_FRAME, FREE),
    _topic("position/setpoint", POSE, "", "position_controller", "reliable", EARTH_FRAME, FREE),
    _topic("position/reference", POSE, "position_controller", "", "reliable", EARTH_FRAME, FREE),
    _topic("position/estimate", ODOMETRY, "position_controller", "", "reliable", EARTH_FRAME, FREE),
    _topic("torque/command", VECTOR, "controller", "disturbance_observer", "reliable", BASE_FRAME, FREE),
    _topic("torque/command", VECTOR, "controller", f"plant {_TORQUE_READERS}", "reliable", BASE_FRAME, STAND),
    _topic("rotors/command", ROTORS, "controller", "plant fault_observer", "reliable", BASE_FRAME, FREE),
    _topic("rotors/speed", ROTORS, "plant", "controller fault_observer", "sensor", BASE_FRAME, FREE),
    _topic("rotors/fault", ROTOR_CONDITION, "fault_injector", "plant", "reliable", BASE_FRAME, FREE),
    _topic("rotors/status", ROTOR_STATUS, "fault_observer", "controller", "reliable", BASE_FRAME, FREE),
    _topic("control/status", CONTROL_STATUS, "controller", "", "reliable", BASE_FRAME),
    # real time: what the body rate of imu/data is off by, as far as the observer knows
    _topic("gyro/bias", VECTOR, "fault_observer", "controller", "reliable", IMU_FRAME),
    # real time: the last words of an observer that has fallen silent, for the one started in its place
    _topic("fault/kept", FAULT_STATUS, "controller", "fault_observer", "latched", IMU_FRAME),
    _topic("gyro/kept", VECTOR, "controller", "fault_observer", "latched", BASE_FRAME),
    _topic("disturbance/kept", VECTOR, "controller", "disturbance_observer", "latched", BASE_FRAME),
    _topic("plant/attitude", VECTOR, "plant", "", "reliable", EARTH_FRAME),
    _topic("plant/rate", VECTOR, "plant", "", "reliable", BASE_FRAME),
    _topic("plant/odometry", ODOMETRY, "plant", "", "reliable", EARTH_FRAME, FREE),
    _topic("disturbance/applied", VECTOR, "plant", "", "reliable", BASE_FRAME),
    _topic("wind/applied", VECTOR, "plant", "", "reliable", EARTH_FRAME, FREE),
    _topic("fault/injected", VECTOR, "fault_injector", "", "reliable", EARTH_FRAME),
    _topic("fault/injected/gyro", VECTOR, "fault_injector", "", "reliable", IMU_FRAME),
    _topic("fault/injected/accelerometer", VECTOR, "fault_injector", "", "reliable", IMU_FRAME),
    _topic("fault/dropped", HEADER, "fault_injector", "plant", "reliable", IMU_FRAME),
    _topic("/diagnostics", DIAGNOSTICS, _ALL_NODES, "", "reliable"),
    _topic("/clock", CLOCK, "plant", "", "clock"),  # read by whoever sets use_sim_time
)

# every topic; where the graphs differ, with the nodes of all of them
TOPICS: Mapping[str, Topic] = MappingProxyType({row.name: row for row in _ROWS})


def _graph(plant: PlantKind) -> Mapping[str, Topic]:
    """Return the topics of a graph, with those of their publishers and readers that it has."""
    nodes = {*NODES[plant], *OPTIONAL_NODES}
    return MappingProxyType(
        {
            row.name: replace(
                row, publishers=_those(row.publishers, nodes), readers=_those(row.readers, nodes)
            )
            for row in _ROWS
            if plant in row.plants
        }
    )


def _those(names: tuple[str, ...], nodes: set[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in nodes)


GRAPHS: Mapping[PlantKind, Mapping[str, Topic]] = MappingProxyType(
    {kind: _graph(kind) for kind in PLANT_KINDS}
)


def absolute(namespace: str, name: str) -> str:
    """Return the full name of what is in a namespace; a name with a leading slash is full already."""
    return posixpath.join("/", namespace.strip("/"), name)


def missing_connections(
    node: str, counts: Mapping[str, int], recorders: int = 0, plant: PlantKind = "test_stand"
) -> list[str]:
    """Say which connections a node lacks to be part of a whole graph for a kind of plant.

    ``counts`` are those of `GraphNode.connections`; ``recorders`` read every output besides the table.
    """
    missing: list[str] = []
    for topic, count in counts.items():
        row = GRAPHS[plant].get(topic)
        if row is None:  # a node may have more topics than the graph
            continue
        gives = node in row.publishers
        wanted = len(row.readers) + recorders if gives else len(row.publishers)
        if count < wanted:
            missing.append(f"{topic}: {count} of {wanted} {'readers' if gives else 'publishers'}")
    return missing


def crowded_topics(count_publishers: Callable[[str], int], plant: PlantKind = "test_stand") -> list[str]:
    """Say which topics have more publishers than one graph gives them: another graph is there, too.

    ``count_publishers`` is that of a node in the namespace of the graph.
    """
    rows = [row for name, row in GRAPHS[plant].items() if row.publishers and not name.startswith("/")]
    counts = [(row, count_publishers(row.name)) for row in rows]
    return [f"{row.name} has {count} publishers" for row, count in counts if count > len(row.publishers)]
