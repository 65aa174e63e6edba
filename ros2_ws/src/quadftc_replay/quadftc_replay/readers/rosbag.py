"""A bag of ROS 2 (MCAP or SQLite) or ROS 1 as a flight log.

| signal | message type, topic |
|---|---|
| gyros, accelerometers | every ``sensor_msgs/Imu``; the main one is ``imu/data``, or has most samples |
| magnetometer | ``sensor_msgs/MagneticField`` [T] |
| attitude | that of ``Imu``, else of ``geometry_msgs/PoseStamped``, else of ``nav_msgs/Odometry`` |
| position, velocity | ``nav_msgs/Odometry``, else ``PoseStamped`` |
| body rate | angular velocity of ``Odometry``, if no gyro is there |
| rotor speeds | ``sensor_msgs/JointState`` on ``rotors/speed`` [rad/s], and more (`bag_rotors`) |
| rotor commands | ``sensor_msgs/JointState`` on ``rotors/command`` [rad/s, or 0 to 1], and more |
| torque command | ``geometry_msgs/Vector3Stamped`` on ``torque/command`` [N m] |
| battery | ``sensor_msgs/BatteryState.voltage`` [V] |
| vehicle | parameters of the node ``fault_observer``, where `quadftc run` has recorded |

Stamps are those of the headers; where none is set, the times of recording. Axes are those of REP-103. Absent
orientations and rates are marked by covariance element 0, as REP-145 says. Of two IMUs with the same samples
one is left out, and so is what `quadftc run` records beside the sensors: the truth, and its own estimates.
Commanded speeds of the rotors become shares of the greatest thrust by their squares.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.ros1 import is_ros1
from quadftc_flight.run_directory import NO_PARAMETERS, PARAMETERS, attached_text, parse_parameters
from quadftc_model.rotations import to_earth
from quadftc_model.samples import ABSENT
from quadftc_model.vehicle import Vehicle, load_vehicle
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.bag_columns import Choose, ColumnBag, Columns, ColumnTopic, is_named, read_columns
from quadftc_replay.readers.bag_rotors import add_rotors, find_rotor_choice
from quadftc_replay.readers.layouts import Layout
from quadftc_replay.readers.signals import Signals

FORMAT, FORMAT_1 = "ROS 2 bag", "ROS 1 bag"
IMU, FIELD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
VECTOR, BATTERY = "geometry_msgs/msg/Vector3Stamped", "sensor_msgs/msg/BatteryState"
MAIN_IMU, POSITION, TORQUE = "imu/data", "position/data", "torque/command"
# what `quadftc run` records beside the sensors: the truth, and what nodes made of the samples
BESIDE = {MAIN_IMU: ("plant/imu", "imu/corrected"), POSITION: ("plant/odometry", "position/estimate")}
WISHES = re.compile(r"setpoint|reference|command|goal|target|desired", re.IGNORECASE)
MILLIGAUSS = 1e7  # of a tesla
OUTSIDE = re.compile(r"mocap|motion_capture|vicon|vrpn|optitrack|natnet|qualisys|phasespace", re.IGNORECASE)


def _part(*names: str) -> Choose:
    """Keep these fields; of a covariance its first element."""

    def choose(fields: Columns) -> Columns:
        kept = ((name, fields[name]) for name in names)
        return {name: each[:, 0].copy() if "covariance" in name else each for name, each in kept}

    return choose


CHOOSERS: Mapping[str, Choose] = {
    IMU: _part(
        *("orientation_xyzw", "orientation_covariance"),
        *("angular_velocity", "angular_velocity_covariance"),
        *("linear_acceleration", "linear_acceleration_covariance"),
    ),
    FIELD: _part("magnetic_field"),
    ODOMETRY: _part(
        *("frame_id", "child_frame_id"),
        *("pose.pose.position", "pose.pose.orientation_xyzw", "pose.covariance"),
        *("twist.twist.linear", "twist.twist.angular", "twist.covariance"),
    ),
    POSE: _part("pose.position", "pose.orientation_xyzw"),
    VECTOR: _part("vector"),
    BATTERY: _part("voltage"),
}


def read(path: Path) -> FlightLog:
    """Read a bag; BagError if it cannot be opened, or if nothing in it can be used."""
    bag = read_columns(path, _find_choice)
    is_old = path.is_file() and is_ros1(path)
    signals = Signals(path, FORMAT_1 if is_old else FORMAT)
    if bag.problem or bag.truncated:
        remedy = "" if is_old else bag.remedy
        signals.notes.append(bag.problem or f"cut short or damaged; read what is there{remedy}")
    topics = _Topics(bag, signals.notes)
    vehicle = _vehicle(bag)
    _add_imus(signals, topics)
    is_outside = vehicle is not None and signals.has("attitude")  # `quadftc run` has a sensor of the attitude
    if source := _add_motion(signals, topics):
        is_outside = OUTSIDE.search(source) is not None
    if name := topics.best(FIELD):
        field = MILLIGAUSS * topics[name]["magnetic_field"]
        signals.add("magnetometers", topics[name]["stamp_ns"], field, name)
    if name := topics.best(BATTERY):
        signals.add("battery", topics[name]["stamp_ns"], topics[name]["voltage"], name)
    add_rotors(signals, topics.kinds, topics.data, vehicle)
    if name := topics.best(VECTOR, TORQUE):
        signals.add("torque_command", topics[name]["stamp_ns"], topics[name]["vector"], name)
    return signals.flight_log(
        Layout(vehicle.rotors.positions, vehicle.rotors.yaw_sign) if vehicle else None,
        vehicle=vehicle.name if vehicle else None,
        attitude_from_gyro=False if is_outside else None,
    )


class _Topics:
    """The topics of a bag that have samples, by full name."""

    def __init__(self, bag: ColumnBag, notes: list[str]) -> None:
        self.kinds: dict[str, str] = {}
        self.data: dict[str, Columns] = {}
        names = [f"/{name.strip('/')}" for name in bag.topics]
        for name, topic in bag.topics.items():
            topic = cast("ColumnTopic", topic)
            columns = topic.columns()
            if topic.damaged:
                notes.append(f"{name}: {topic.damaged} of {topic.count} messages cannot be decoded; left out")
            notes += topic.thinning.notes(name)
            if columns and not _is_beside(f"/{name.strip('/')}", names):
                self.kinds[name], self.data[name] = topic.type_name, columns

    def __getitem__(self, name: str) -> Columns:
        return self.data[name]

    def of(self, kind: str, ending: str = "") -> list[str]:
        """Topics of a type whose names end so, those with most samples first; no setpoints."""
        names = (name for name, its in self.kinds.items() if its == kind)
        fit = [name for name in names if (is_named(name, ending) if ending else not WISHES.search(name))]
        return sorted(fit, key=lambda name: -len(self.data[name]["stamp_ns"]))

    def best(self, kind: str, ending: str = "") -> str:
        """Topic of a type with most samples; empty if there is none."""
        return next(iter(self.of(kind, ending)), "")


def _find_choice(name: str, kind: str) -> Choose | None:
    """Whether a topic counts, and what is kept of its messages."""
    if kind == VECTOR and not is_named(name, TORQUE):
        return None
    return CHOOSERS.get(kind) or find_rotor_choice(name, kind)


def _is_beside(name: str, names: list[str]) -> bool:
    """Whether `quadftc run` has recorded a topic beside that of a sensor."""
    for sensor, others in BESIDE.items():
        for other in others:
            if name.endswith(f"/{other}") and name.removesuffix(other) + sensor in names:
                return True
    return False


def _add_imus(signals: Signals, topics: _Topics) -> None:
    names = topics.of(IMU)
    names.sort(key=lambda name: not is_named(name, MAIN_IMU))
    for number, name in enumerate(names):
        data = topics[name]
        if twin := next((other for other in names[:number] if _is_same(data, topics[other])), ""):
            signals.notes.append(f"{name}: the same samples as {twin}; left out")
            continue
        key, stamp_ns = ("" if number == 0 else name), data["stamp_ns"]
        for field, column in (("gyros", "angular_velocity"), ("accelerometers", "linear_acceleration")):
            value = _present(data[column], data[f"{column}_covariance"])
            if np.any(value):  # a driver without such a sensor leaves zeros
                signals.add(field, stamp_ns, value, name, key)
        if not signals.has("attitude"):
            _add_attitude(signals, stamp_ns, data["orientation_xyzw"], data["orientation_covariance"], name)


def _is_same(data: Columns, other: Columns) -> bool:
    """Whether two IMUs have the same rates, at least in nine of ten samples."""
    shared: Any = np.intersect1d(data["stamp_ns"], other["stamp_ns"], return_indices=True)
    mine, theirs = shared[1], shared[2]
    if len(mine) < 0.5 * len(data["stamp_ns"]):
        return False
    rates: Floats = data["angular_velocity"][mine]
    others: Floats = other["angular_velocity"][theirs]
    return int(np.count_nonzero((rates == others).all(axis=1))) > 0.9 * len(rates)


def _present(value: Floats, covariance: Floats) -> Floats:
    return np.where((covariance != ABSENT)[:, None], value, np.nan)


def _add_attitude(
    signals: Signals, stamp_ns: NDArray[np.int64], q_xyzw: Floats, covariance: Floats, name: str
) -> bool:
    """Add an orientation, if it is one: of unit length, and not always the same."""
    with np.errstate(over="ignore", invalid="ignore"):  # damaged numbers may be of any size
        length = np.linalg.norm(q_xyzw, axis=1)
    good = (np.abs(length - 1.0) < 0.1) & (covariance != ABSENT)  # False for NaN, too
    if not good.any() or np.all(q_xyzw[good] == q_xyzw[good][0]):
        return False
    value = np.where(good[:, None], q_xyzw / np.where(good, length, 1.0)[:, None], np.nan)
    return signals.add("attitude", stamp_ns, value, name)


def _add_motion(signals: Signals, topics: _Topics) -> str:
    """Add what poses and odometry tell; return the topic of the attitude, if it comes from here."""
    source = ""
    odometry = topics.best(ODOMETRY, POSITION) or topics.best(ODOMETRY)
    if pose := topics.best(POSE):
        data = topics[pose]
        stamp_ns, q_xyzw = data["stamp_ns"], data["pose.orientation_xyzw"]
        if not signals.has("attitude") and _add_attitude(
            signals, stamp_ns, q_xyzw, np.zeros(len(q_xyzw)), pose
        ):
            source = pose
        if not odometry:
            signals.add("position", stamp_ns, data["pose.position"], pose)
    if odometry:
        data = topics[odometry]
        stamp_ns, q_xyzw = data["stamp_ns"], data["pose.pose.orientation_xyzw"]
        covariance = data["pose.covariance"]
        signals.add("position", stamp_ns, _present(data["pose.pose.position"], covariance), odometry)
        if not signals.has("attitude") and _add_attitude(signals, stamp_ns, q_xyzw, covariance, odometry):
            source = odometry
        _add_twist(signals, data, odometry)
    return source


def _add_twist(signals: Signals, data: Columns, name: str) -> None:
    linear, angular = (
        _present(data[f"twist.twist.{part}"], data["twist.covariance"]) for part in ("linear", "angular")
    )
    in_body = data["child_frame_id"] != data["frame_id"]
    if np.any(np.nan_to_num(linear)):
        earth = np.asarray(to_earth(data["pose.pose.orientation_xyzw"], linear))
        signals.add("velocity", data["stamp_ns"], np.where(in_body[:, None], earth, linear), name)
    if np.any(np.nan_to_num(angular)) and in_body.all() and not signals.has("gyros"):
        signals.add("body_rate", data["stamp_ns"], angular, name)


def _vehicle(bag: ColumnBag) -> Vehicle | None:
    """Vehicle of a flight of `quadftc run`, by the parameters in the bag."""
    try:
        nodes = parse_parameters(attached_text(bag, PARAMETERS) or "")
        return load_vehicle(str(nodes["fault_observer"]["vehicle"]))
    except (*NO_PARAMETERS, OSError):
        return None
