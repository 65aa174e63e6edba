"""A flight of the closed loop as the bag that a graph in lock-step would record, but for what nobody reads.

The topics are those that a `Flight` is made of. A quantity that the closed loop does not keep is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import TopicRecord
from quadftc_bags.cdr.arrays import encode_topic
from quadftc_bags.interfaces import load_interface
from quadftc_flight.closed_loop import FlightRecord, Rows
from quadftc_flight.flight import DIAGNOSIS, Flight, columns_by_topic
from quadftc_flight.loop import LoopOutput
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ABSENT
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, TOPICS

CHUNK = 1024 * 1024  # bytes


class BagRecord(FlightRecord):
    """A flight with what a bag holds besides: samples of the sensors, and the rotor speeds commanded."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.parts: dict[str, list[dict[str, NDArray[Any]]]] = {}  # by topic; with their rows of the flight

    def note(self, begin: int, output: LoopOutput) -> None:
        """Note what was put out from a row on, arrays (n, ...)."""
        super().note(begin, output)
        first = begin - self._loop.vehicle.imu.delay
        came = np.flatnonzero(output.left & output.faulty.present)
        sample = rows_of(output.faulty.sample, came)
        self._keep("imu/data", first + came, sample._asdict())
        speeds = output.said.attitude.said.speeds
        if speeds is not None:
            self._keep("rotors/command", first + came, {"velocity": np.asarray(speeds)[came]})
        if (place := output.motion.position) is not None:
            there = np.flatnonzero(output.left & place.there)
            fields = {"position": place.position[there], "velocity": place.velocity[there]}
            self._keep("position/data", first + there, fields)

    def column(self, topic: str, name: str) -> NDArray[Any]:
        """Return a quantity of all messages of a topic."""
        return np.concatenate([part[name] for part in self.parts[topic]])

    def _keep(self, topic: str, rows: Rows, fields: Mapping[str, Any]) -> None:
        copied = {name: np.array(values) for name, values in {"rows": rows, **fields}.items()}
        self.parts.setdefault(topic, []).append(copied)


class _Rows(NamedTuple):
    """The messages of a topic: a stamp [ns] and the bytes of each."""

    stamp_ns: NDArray[np.int64]
    messages: Sequence[bytes]


def write_loop_bag(record: BagRecord, directory: Path, attachments: Mapping[str, bytes]) -> dict[str, int]:
    """Write the bag; return its messages by topic. OSError if it cannot be written."""
    file = BagFile(directory, attachments, {"mode": "lockstep"}, "zstd", CHUNK)
    messages: list[tuple[int, int, bytes]] = []
    for channel, (topic, rows) in enumerate(_topics(record), 1):
        row = TOPICS[topic]
        interface = load_interface(row.type_name)
        file.add_topic(TopicRecord(f"/{topic}", row.type_name, interface.type_hash, "", interface.text))
        stamps = rows.stamp_ns.tolist()
        messages += ((at, channel, data) for at, data in zip(stamps, rows.messages, strict=True))
    for stamp_ns, channel, data in sorted(messages, key=itemgetter(0, 1)):
        file.write(channel, stamp_ns, stamp_ns, data)
    file.close()
    return dict(file.counts)


def _topics(record: BagRecord) -> Iterator[tuple[str, _Rows]]:
    flight = record.flight()
    for topic, fields in _sensed(record):
        yield topic, _encoded(topic, flight.stamp_ns[record.column(topic, "rows")], fields)
    dropped = flight.stamp_ns[~flight.delivered]
    if len(dropped):
        yield "fault/dropped", _encoded("fault/dropped", dropped, {})
    for topic, fields in columns_by_topic(flight).items():
        known = np.any([_is_known(column) for column in fields.values()], axis=0)
        if topic != DIAGNOSIS and known.any():
            completed = _completed(topic, flight, fields).items()
            given: dict[str, Any] = {
                name: each if name == "name" else each[known] for name, each in completed
            }
            yield topic, _encoded(topic, flight.stamp_ns[known], given)
    if record.reports:
        write = DiagnosisWire()
        stamps = np.array([report.stamp_ns for report in record.reports], np.int64)
        yield DIAGNOSIS, _Rows(stamps, [write(report) for report in record.reports])


def _is_known(column: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (n,) whether a row says something."""
    is_float = column.dtype.kind == "f"  # of what is none the others of its topic tell
    return np.asarray(~np.isnan(column).all(axis=1) if is_float else np.zeros(len(column)), np.bool_)


def _completed(topic: str, flight: Flight, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Add to the fields of a topic what its readers need besides."""
    given = dict(fields)
    if topic == "fault/status":
        given["estimate"] = flight.fault_estimate
    elif topic == "rotors/fault":
        given["speed_limit"] = np.full_like(flight.rotor_effectiveness, np.inf)
        given["stuck"] = np.zeros(flight.rotor_effectiveness.shape, np.bool_)
    elif topic == "rotors/speed":
        given = _named_rotors(given)
    elif topic == "plant/odometry":
        given["pose.pose.orientation_xyzw"] = np.asarray(quaternion_from_euler(flight.angles))
        given["twist.twist.angular"] = flight.body_rate
    elif topic in ("position/reference", "position/estimate"):
        name = "pose.orientation_xyzw" if topic == "position/reference" else "pose.pose.orientation_xyzw"
        given[name] = np.tile([0.0, 0.0, 0.0, 1.0], (len(flight), 1))
    return given


def _sensed(record: BagRecord) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what sensors measured and the rotors were told, by topic and field."""

    def imu(name: str) -> NDArray[Any]:
        return record.column("imu/data", name)

    def covariance(*absent: NDArray[np.bool_], size: int = 9) -> NDArray[Any]:
        values = np.zeros((len(absent[0]), size))
        values[:, 0 if size == 9 else 21] = np.where(absent[0], ABSENT, 0.0)
        return values

    yield (
        "imu/data",
        {
            "orientation_xyzw": imu("q_xyzw"),
            "angular_velocity": imu("body_rate"),
            "linear_acceleration": imu("specific_force"),
            "orientation_covariance": covariance(~imu("attitude_valid")),
            "angular_velocity_covariance": covariance(~imu("rate_valid")),
            "linear_acceleration_covariance": covariance(~imu("force_valid")),
        },
    )
    if "rotors/command" in record.parts:
        yield "rotors/command", _named_rotors({"velocity": record.column("rotors/command", "velocity")})
    if "position/data" in record.parts:
        place, velocity = (record.column("position/data", name) for name in ("position", "velocity"))
        unknown = covariance(np.ones(len(place), np.bool_), size=36)  # attitude and body rate
        fields = {"pose.pose.position": place, "twist.twist.linear": velocity}
        fields |= {"pose.covariance": unknown, "twist.covariance": unknown}
        yield "position/data", fields | {"child_frame_id": EARTH_FRAME}


def _named_rotors(fields: dict[str, Any]) -> dict[str, Any]:
    """Add the names of the rotors to their speeds."""
    count = fields["velocity"].shape[1]
    return fields | {"name": [f"rotor_{number}" for number in range(1, count + 1)]}


def _encoded(topic: str, stamp_ns: NDArray[np.int64], fields: Mapping[str, Any]) -> _Rows:
    row = TOPICS[topic]
    types = get_types_from_msg(load_interface(row.type_name).text, row.type_name)
    given = {"stamp_ns": stamp_ns[:, None], "frame_id": row.frame, "child_frame_id": BASE_FRAME, **fields}
    return _Rows(stamp_ns, encode_topic(types, row.type_name, given, len(stamp_ns)))
