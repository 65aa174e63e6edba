"""The bag of a flight: what the autopilot got from our IMU, what it commanded, the truth, the diagnosis.

`ROWS` samples are kept and then written. An error of the disk ends the recording, not the flight.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import TopicRecord
from quadftc_bags.cdr.arrays import encode_topic
from quadftc_bags.cdr.writer import MessageWriter
from quadftc_bags.interfaces import load_interface
from quadftc_model.samples import ABSENT, DiagnosisReport
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.topics import BASE_FRAME, TOPICS
from quadftc_sim.autopilot import Shown
from quadftc_sim.injection import TRUTH
from quadftc_sim.rotor_fault import ROTOR

ROWS = 4000  # samples kept
CHUNK = 1024 * 1024  # bytes
IMU_FIELDS = (  # field of the message, whether it is there, and field of an `ImuSample`
    ("orientation_xyzw", "attitude_valid", "q_xyzw"),
    ("angular_velocity", "rate_valid", "body_rate"),
    ("linear_acceleration", "force_valid", "specific_force"),
)
DIAGNOSTICS = "/diagnostics"
WARNS = 1  # diagnostic_msgs/DiagnosticStatus.WARN
RECORDED = ("imu/data", "rotors/command", "rotors/speed", "plant/odometry", "diagnosis", DIAGNOSTICS)


class Recorder:
    """Writes the bag of a flight, a rosbag2 directory; a context manager that closes it."""

    def __init__(self, directory: Path, attachments: Mapping[str, bytes], channels: Collection[str]) -> None:
        """Create the bag, with the truth of faults on some channels; OSError if that cannot be done."""
        self.problem = ""  # why the recording has ended; empty: it has not
        self._file = BagFile(directory, attachments, {"mode": "lockstep"}, "zstd", CHUNK)
        self._rows: dict[str, dict[str, list[Any]]] = {}
        self._messages: list[tuple[int, int, bytes]] = []
        self._write_report = DiagnosisWire()
        self._truth = {channel: topic for channel, topic in TRUTH.items() if channel in channels}
        topics = [*RECORDED, *self._truth.values(), *(["rotors/fault"] if ROTOR in channels else [])]
        self._channels = {topic: number for number, topic in enumerate(topics, 1)}
        for topic in topics:
            row = TOPICS[topic]
            interface = load_interface(row.type_name)
            self._file.add_topic(
                TopicRecord(f"/{topic.lstrip('/')}", row.type_name, interface.type_hash, "", interface.text)
            )

    def note(self, shown: Shown, commanded_ns: int | None) -> None:
        """Note a sample; the command that flew it here was given at a stamp [ns]."""
        emission, injected = shown.emission, shown.injected
        motion = emission.flight
        assert motion is not None
        now = emission.stamp_ns
        self._put("rotors/speed", now, velocity=motion.speeds)
        self._put(
            "plant/odometry",
            now,
            **{
                "pose.pose.position": motion.position,
                "pose.pose.orientation_xyzw": motion.q_xyzw,
                "twist.twist.linear": motion.body_velocity,
                "twist.twist.angular": emission.body_rate,
            },
        )
        if commanded_ns is not None:
            self._put("rotors/command", commanded_ns, velocity=shown.command)
        if injected is not None:
            stamp_ns, sample = emission.sample_stamp_ns, injected.sample
            if injected.present:
                self._put("imu/data", stamp_ns, **sample._asdict())
            for channel, topic in self._truth.items():
                self._put(topic, stamp_ns, vector=getattr(injected, channel))
            if injected.rotors is not None and "rotors/fault" in self._channels:
                self._put("rotors/fault", stamp_ns, **injected.rotors._asdict())
        if len(self._rows["rotors/speed"]["stamp_ns"]) >= ROWS:
            self._write()

    def report(self, report: DiagnosisReport) -> None:
        """Note what the diagnosis says."""
        self._messages.append((report.stamp_ns, self._channels["diagnosis"], self._write_report(report)))

    def tell(self, stamp_ns: int, name: str, words: str) -> None:
        """Note a diagnostic status, a warning, at a stamp [ns]."""
        writer = MessageWriter(stamp_ns)
        writer.number("I", 1)
        writer.number("B", WARNS)
        for text in (name, words, ""):
            writer.text(text)
        writer.number("I", 0)
        self._messages.append((stamp_ns, self._channels[DIAGNOSTICS], writer.data))

    def close(self) -> None:
        """Write what is left, and close the bag."""
        self._write()
        if not self.problem:
            self._try(self._file.close)

    @property
    def counts(self) -> dict[str, int]:
        """Messages that were written, by topic."""
        return dict(self._file.counts)

    def _put(self, topic: str, stamp_ns: int, **fields: Any) -> None:
        columns = self._rows.setdefault(topic, {})
        columns.setdefault("stamp_ns", []).append(stamp_ns)
        for name, value in fields.items():
            columns.setdefault(name, []).append(value)

    def _write(self) -> None:
        """Write all samples that are kept, in the order of their stamps."""
        rows, self._rows = self._rows, {}
        messages, self._messages = self._messages, []
        if self.problem:
            return
        for topic, columns in rows.items():
            stamps = columns["stamp_ns"]
            channel = self._channels[topic]
            messages += (
                (at, channel, data) for at, data in zip(stamps, _encoded(topic, columns), strict=True)
            )

        def write() -> None:
            for stamp_ns, channel, data in sorted(messages, key=itemgetter(0, 1)):
                self._file.write(channel, stamp_ns, stamp_ns, data)
            self._file.flush()

        self._try(write)

    def _try(self, action: Any) -> None:
        try:
            action()
        except OSError as error:
            self.problem = f"{self._file.path}: {error.strerror}"
            self._file.abandon()


def _encoded(topic: str, columns: Mapping[str, list[Any]]) -> list[bytes]:
    """Return the messages of a topic."""
    row = TOPICS[topic]
    types = get_types_from_msg(load_interface(row.type_name).text, row.type_name)
    count = len(columns["stamp_ns"])
    fields: dict[str, Any] = {name: np.array(values) for name, values in columns.items()}
    if topic == "imu/data":
        for name, there, ours in IMU_FIELDS:
            covariance = np.zeros((count, 9))
            covariance[~fields[there].astype(bool), 0] = ABSENT
            fields[f"{name.removesuffix('_xyzw')}_covariance"] = covariance
            fields[name] = fields.pop(ours)
    given = {**fields, "stamp_ns": fields["stamp_ns"][:, None]}
    given |= {"frame_id": row.frame, "child_frame_id": BASE_FRAME}
    return encode_topic(types, row.type_name, given, count)
