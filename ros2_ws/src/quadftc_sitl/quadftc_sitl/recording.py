"""The bag of a flight: what the autopilot got from our IMU, what it commanded, the truth, the diagnosis.

`ROWS` samples are kept and then written. An error of the disk ends the recording, not the flight.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np

from quadftc_bags.bag_file import BagFile
from quadftc_bags.cdr.writer import MessageWriter
from quadftc_flight.loop_bag import CHUNK, Message, add_topic, encoded, imu_fields, write_messages
from quadftc_model.samples import DiagnosisReport
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_sim.autopilot import Shown
from quadftc_sim.injection import TRUTH
from quadftc_sim.rotor_fault import ROTOR

ROWS = 4000  # samples kept
DIAGNOSTICS = "/diagnostics"
WARNS = 1  # diagnostic_msgs/DiagnosticStatus.WARN
RECORDED = ("imu/data", "rotors/command", "rotors/speed", "plant/odometry", "diagnosis", DIAGNOSTICS)


class Recorder:
    """Writes the bag of a flight, a rosbag2 directory; a context manager that closes it."""

    def __init__(self, directory: Path, attachments: Mapping[str, bytes], channels: Collection[str]) -> None:
        """Create the bag, with the truth of faults on some channels; OSError if that cannot be done."""
        self.problem = ""  # why the recording has ended; empty: it has not
        self._file = BagFile(directory, attachments, {"mode": "lockstep"}, "zstd", CHUNK)
        self._rows: dict[str, dict[str, list[object]]] = {}
        self._messages: list[Message] = []
        self._write_report = DiagnosisWire()
        self._truth = {channel: topic for channel, topic in TRUTH.items() if channel in channels}
        topics = [*RECORDED, *self._truth.values(), *(["rotors/fault"] if ROTOR in channels else [])]
        self._channels = {topic: number for number, topic in enumerate(topics, 1)}
        for topic in topics:
            add_topic(self._file, topic)

    def note(self, shown: Shown, commanded_ns: int | None) -> None:
        """Note a sample; the command that flew it here was given at a stamp [ns]."""
        emission, injected = shown.emission, shown.injected
        motion = emission.flight
        assert motion is not None
        now = emission.stamp_ns
        self._put("rotors/speed", now, {"velocity": motion.speeds})
        pose = {"pose.pose.position": motion.position, "pose.pose.orientation_xyzw": motion.q_xyzw}
        twist = {"twist.twist.linear": motion.body_velocity, "twist.twist.angular": emission.body_rate}
        self._put("plant/odometry", now, pose | twist)
        if commanded_ns is not None:
            self._put("rotors/command", commanded_ns, {"velocity": shown.command})
        if injected is not None:
            stamp_ns, sample = emission.sample_stamp_ns, injected.sample
            if injected.present:
                self._put("imu/data", stamp_ns, sample._asdict())
            for channel, topic in self._truth.items():
                self._put(topic, stamp_ns, {"vector": getattr(injected, channel)})
            if injected.rotors is not None and "rotors/fault" in self._channels:
                self._put("rotors/fault", stamp_ns, injected.rotors._asdict())
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

    def _put(self, topic: str, stamp_ns: int, fields: Mapping[str, object]) -> None:
        columns = self._rows.setdefault(topic, {})
        for name, value in {"stamp_ns": stamp_ns, **fields}.items():
            columns.setdefault(name, []).append(value)

    def _write(self) -> None:
        """Write all samples that are kept, in the order of their stamps."""
        rows, self._rows = self._rows, {}
        messages, self._messages = self._messages, []
        if self.problem:
            return
        for topic, columns in rows.items():
            fields = {name: np.array(values) for name, values in columns.items()}
            stamps = fields.pop("stamp_ns")
            data = encoded(topic, stamps, imu_fields(fields) if topic == "imu/data" else fields)
            channels = itertools.repeat(self._channels[topic], len(data))
            messages += zip(stamps.tolist(), channels, data, strict=True)

        def write() -> None:
            write_messages(self._file, messages)
            self._file.flush()

        self._try(write)

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        except OSError as error:
            self.problem = f"{self._file.path}: {error.strerror}"
            self._file.abandon()
