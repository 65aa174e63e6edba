"""A flight of the closed loop as the bag that a graph in lock-step would record, but for what nobody reads.

The topics are those that a `Flight` is made of. A quantity that the closed loop does not keep is NaN.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import TopicRecord
from quadftc_bags.cdr.arrays import encode_topic
from quadftc_bags.interfaces import load_interface
from quadftc_flight.closed_loop import FlightRecord, Rows, Watch
from quadftc_flight.flight import DIAGNOSIS, Flight, columns_by_topic
from quadftc_flight.loop import ClosedLoop, LoopOutput
from quadftc_model.arrays import AnyArray, Array, rows_of
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ABSENT
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, TOPICS

CHUNK = 1024 * 1024  # bytes

Columns = dict[str, AnyArray]  # arrays (n, ...) of any kind by field
Fields = Mapping[str, AnyArray | list[str] | str]  # those of messages, and what is the same in all
Message = tuple[int, int, bytes]  # stamp [ns], channel, data


class BagRecord(FlightRecord):
    """A flight with what a bag holds besides: samples of the sensors, and the rotor speeds commanded."""

    def __init__(self, loop: ClosedLoop, epoch_ns: int, count: int, watch: Watch | None = None) -> None:
        super().__init__(loop, epoch_ns, count, watch)
        self._parts: dict[str, list[Columns]] = {}  # by topic; with their rows of the flight

    def note(self, rows: slice, output: LoopOutput) -> None:
        """Note what was put out in some rows, arrays (n, ...)."""
        super().note(rows, output)
        first = rows.start - self._loop.vehicle.imu.delay
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

    def parts(self) -> dict[str, Columns]:
        """Return the quantities of all messages, and their rows of the flight, by topic."""
        return {
            topic: {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            for topic, parts in self._parts.items()
        }

    def _keep(self, topic: str, rows: Rows, fields: Mapping[str, Array]) -> None:
        copied = {name: np.array(values) for name, values in {"rows": rows, **fields}.items()}
        self._parts.setdefault(topic, []).append(copied)


def write_loop_bag(record: BagRecord, directory: Path, attachments: Mapping[str, bytes]) -> dict[str, int]:
    """Write the bag; return its messages by topic. OSError if it cannot be written."""
    file = BagFile(directory, attachments, {"mode": "lockstep"}, "zstd", CHUNK)
    messages: list[Message] = []
    for channel, (topic, stamps, data) in enumerate(_topics(record), 1):
        add_topic(file, topic)
        messages += zip(stamps.tolist(), itertools.repeat(channel, len(data)), data, strict=True)
    write_messages(file, messages)
    file.close()
    return dict(file.counts)


def add_topic(file: BagFile, topic: str, namespace: str = "/") -> None:
    """Declare a topic of the table, in the namespace of a vehicle."""
    name, kind = f"{namespace}{topic.lstrip('/')}", TOPICS[topic].type_name
    interface = load_interface(kind)
    file.add_topic(TopicRecord(name, kind, interface.type_hash, "", interface.text))


def write_messages(file: BagFile, messages: Iterable[Message]) -> None:
    """Write messages in the order of their stamps, those of one stamp in that of their channels."""
    for stamp_ns, channel, data in sorted(messages, key=itemgetter(0, 1)):
        file.write(channel, stamp_ns, stamp_ns, data)


def encoded(topic: str, stamp_ns: NDArray[np.int64], fields: Fields) -> list[bytes]:
    """Return the messages of a topic of the table, by their stamps (n,) [ns] and fields."""
    row = TOPICS[topic]
    types = get_types_from_msg(load_interface(row.type_name).text, row.type_name)
    given = {"stamp_ns": stamp_ns[:, None], "frame_id": row.frame, "child_frame_id": BASE_FRAME, **fields}
    return encode_topic(types, row.type_name, given, len(stamp_ns))


def imu_fields(sample: Columns) -> Columns:
    """Return the fields of IMU messages by the columns of their samples."""
    return {
        "orientation_xyzw": sample["q_xyzw"],
        "angular_velocity": sample["body_rate"],
        "linear_acceleration": sample["specific_force"],
        "orientation_covariance": _covariance(np.logical_not(sample["attitude_valid"])),
        "angular_velocity_covariance": _covariance(np.logical_not(sample["rate_valid"])),
        "linear_acceleration_covariance": _covariance(np.logical_not(sample["force_valid"])),
    }


def _covariance(absent: NDArray[np.bool_], size: int = 9) -> NDArray[np.float64]:
    """Return covariances (n, size) that are unknown, or say that what they are of is absent."""
    values = np.zeros((len(absent), size))
    values[:, 0 if size == 9 else 21] = np.where(absent, ABSENT, 0.0)
    return values


def _topics(record: BagRecord) -> Iterator[tuple[str, NDArray[np.int64], list[bytes]]]:
    """Yield the name of each topic, and stamps [ns] and bytes of its messages."""
    flight = record.flight()
    given: Fields
    parts = record.parts()
    for topic, given in _sensed(parts):
        stamps = flight.stamp_ns[parts[topic]["rows"]]
        yield topic, stamps, encoded(topic, stamps, given)
    dropped = flight.stamp_ns[~flight.delivered]
    if len(dropped):
        yield "fault/dropped", dropped, encoded("fault/dropped", dropped, {})
    for topic, fields in columns_by_topic(flight).items():
        known = np.any([_is_known(column) for column in fields.values()], axis=0)
        if topic != DIAGNOSIS and known.any():
            completed = _completed(topic, flight, fields).items()
            given = {name: each if isinstance(each, list) else each[known] for name, each in completed}
            yield topic, flight.stamp_ns[known], encoded(topic, flight.stamp_ns[known], given)
    if record.reports:
        write = DiagnosisWire()
        stamps = np.array([report.stamp_ns for report in record.reports], np.int64)
        yield DIAGNOSIS, stamps, [write(report) for report in record.reports]


def _is_known(column: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Return (n,) whether a row says something."""
    is_float = column.dtype.kind == "f"  # of what is none the others of its topic tell
    return np.asarray(~np.isnan(column).all(axis=1) if is_float else np.zeros(len(column)), np.bool_)


def _completed(topic: str, flight: Flight, fields: Columns) -> dict[str, AnyArray | list[str]]:
    """Add to the fields of a topic what its readers need besides."""
    given: dict[str, AnyArray | list[str]] = {**fields}
    if topic == "fault/status":
        given["estimate"] = flight.fault_estimate
    elif topic == "rotors/fault":
        given["speed_limit"] = np.full_like(flight.rotor_effectiveness, np.inf)
        given["stuck"] = np.zeros(flight.rotor_effectiveness.shape, np.bool_)
    elif topic == "rotors/speed":
        given = _named_rotors(fields)
    elif topic == "plant/odometry":
        given["pose.pose.orientation_xyzw"] = np.asarray(quaternion_from_euler(flight.angles))
        given["twist.twist.angular"] = flight.body_rate
    elif topic in ("position/reference", "position/estimate"):
        name = "pose.orientation_xyzw" if topic == "position/reference" else "pose.pose.orientation_xyzw"
        given[name] = np.tile([0.0, 0.0, 0.0, 1.0], (len(flight), 1))
    return given


def _sensed(parts: Mapping[str, Columns]) -> Iterator[tuple[str, Fields]]:
    """Yield what sensors measured and the rotors were told, by topic and field."""
    yield "imu/data", imu_fields(parts["imu/data"])
    if "rotors/command" in parts:
        yield "rotors/command", _named_rotors({"velocity": parts["rotors/command"]["velocity"]})
    if "position/data" in parts:
        place = parts["position/data"]["position"]
        unknown = _covariance(np.ones(len(place), np.bool_), size=36)  # attitude and body rate
        fields = {"pose.pose.position": place, "twist.twist.linear": parts["position/data"]["velocity"]}
        fields |= {"pose.covariance": unknown, "twist.covariance": unknown}
        yield "position/data", fields | {"child_frame_id": EARTH_FRAME}


def _named_rotors(fields: Columns) -> dict[str, AnyArray | list[str]]:
    """Add the names of the rotors to their speeds."""
    count = fields["velocity"].shape[1]
    return {**fields, "name": [f"rotor_{number}" for number in range(1, count + 1)]}
