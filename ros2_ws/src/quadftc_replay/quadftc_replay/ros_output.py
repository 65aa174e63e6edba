# pyright: basic
"""A replay as a rosbag2 bag that any ROS 2 tool opens, with a summary beside it.

The topics are those of the graph, with its stamps: messages are stored under the time of their sample.
plant/imu and torque/command are as recorded. imu/data is what the observer saw. fault/injected is the
recorded and the overlaid fault together. What cannot be used of a recorded sample (not finite, no unit
quaternion) is marked absent in imu/data.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable
from itertools import repeat
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from quadftc_bags.bag import BagError
from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import describe_topic
from quadftc_flight.run_directory import DESCRIPTION, PARAMETERS, SUMMARY
from quadftc_flight.run_files import RunError, prepare
from quadftc_model.samples import FaultEstimate, ImuSample, level_sample
from quadftc_replay.diagnose import Diagnosed, Progress, true_fault
from quadftc_replay.imu_from_bag import CORRECTED, DATA, DROPPED, HEADER, IMU, UNTOUCHED, VECTOR
from quadftc_replay.imu_recording import SerializedTopic, Stamps
from quadftc_replay.plan import Replay, ReplayOptions, plan_replay
from quadftc_ros.conversions import time_message
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.qos import topic_profile
from quadftc_ros.topics import DIAGNOSIS, EARTH_FRAME, IMU_FRAME, TOPICS
from quadftc_ros.versions import versions
from quadftc_ros.wire import FaultStatusWire, ImuWire, VectorWire
from quadftc_sim.injection import TRUTH

T = TypeVar("T")

CHUNK = 1024 * 1024  # bytes
DIAGNOSING = 0.85  # share of the work; the rest is writing
STRIDE = 4096  # messages between two looks of the progress bar


def replay(
    path: Path, options: ReplayOptions, out: Path, force: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Replay a recording (see `plan_replay`); return the summary that is written beside the bag.

    The bag becomes the directory ``out/<recording>-<observer>``; ``force`` replaces an earlier one. If it
    cannot be written, or is there already, a RunError says so.
    """
    follow = progress or (lambda share: None)
    begin = time.perf_counter()
    plan = plan_replay(path, options)
    directory = out / plan.name
    source, target = path.resolve(), directory.resolve()
    if target in (source, *source.parents):
        raise BagError(f"{path}: lies in {directory}, which the replay would replace; choose another --out")
    prepare(out, [plan.name], force)
    diagnosed = plan.diagnose(lambda share: follow(DIAGNOSING * share))
    diagnosing = time.perf_counter() - begin
    warnings = list(plan.recording.warnings)
    if count := diagnosed.unusable:
        warnings.append(f"the estimate was not finite at {count} samples; the observer restarted after each")
    try:
        _write(plan, diagnosed, directory, lambda share: follow(DIAGNOSING + (1.0 - DIAGNOSING) * share))
        wall_time = time.perf_counter() - begin
        result = {
            **plan.summary(diagnosed),
            "source": str(path),
            "bag": plan.name,
            "wall_time_s": wall_time,
            "diagnosis_time_s": diagnosing,
            "real_time_factor": plan.recording.duration / wall_time,
            "warnings": warnings,
            "versions": versions(),
        }
        text = json.dumps(result, indent=2, allow_nan=False) + "\n"
        (directory / SUMMARY).write_text(text, encoding="utf-8")
    except OSError as error:
        raise RunError(f"{directory}: {error.strerror or error}") from None
    except KeyboardInterrupt:
        shutil.rmtree(directory, ignore_errors=True)
        raise
    return result


def _write(plan: Replay, diagnosed: Diagnosed, directory: Path, follow: Progress) -> None:
    texts = {PARAMETERS: plan.parameter_file(), DESCRIPTION: plan.origin.description()}
    attachments = {name: text.encode() for name, text in texts.items()}
    bag = BagFile(directory, attachments, {"mode": "replay", **versions()}, "zstd", CHUNK)
    topics = _topics(plan, diagnosed)
    for name, topic in topics.items():
        qos = topic_profile(TOPICS[name].qos, "realtime")
        bag.add_topic(describe_topic(f"{plan.recording.namespace}{name}", topic.type_name, qos))
    # in the order of the stamps, then of the topics, whose channels count from 1
    stamps = np.concatenate([topic.stamp_ns for topic in topics.values()])
    messages = [(channel, data) for channel, each in enumerate(topics.values(), 1) for data in each.messages]
    try:
        for number, row in enumerate(np.argsort(stamps, kind="stable").tolist()):
            (channel, data), stamp_ns = messages[row], int(stamps[row])
            bag.write(channel, stamp_ns, stamp_ns, data)
            if number % STRIDE == 0:
                follow(number / len(messages))
        bag.close()
    except BaseException:
        bag.abandon()
        raise
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")


def _topics(plan: Replay, diagnosed: Diagnosed) -> dict[str, SerializedTopic]:
    """Messages of every topic, in the order of the table of the graph."""
    recording, rows, said = plan.recording, diagnosed.delivered, diagnosed.estimate
    every, given = recording.stamp_ns, recording.stamp_ns[rows]
    frame = f"{recording.namespace.lstrip('/')}{IMU_FRAME}"  # as the graph names it in a namespace
    columns = said.fault, said.std_dev, said.state, said.onset_age
    estimates = map(FaultEstimate, *(column[rows] for column in columns), repeat(level_sample()))
    made = {
        **(recording.passed_on or {UNTOUCHED: _encode_imu(every, recording.imu, frame)}),
        DATA: _encode_imu(given, ImuSample(*(column[rows] for column in diagnosed.seen)), frame),
        CORRECTED: _encode_imu(given, ImuSample(*(column[rows] for column in said.corrected)), frame),
        "fault/status": _serialise("quadftc_msgs/msg/FaultStatus", given, FaultStatusWire(frame), estimates),
        "fault/estimate": _serialise(VECTOR, given, VectorWire(EARTH_FRAME), said.fault[rows]),
    }
    stamps = np.array([report.stamp_ns for report in diagnosed.reports], np.int64)
    write_report = DiagnosisWire(frame)
    messages = [write_report(report) for report in diagnosed.reports]
    made["diagnosis"] = SerializedTopic(DIAGNOSIS, stamps, messages)
    overlaid = {fault.injection.channel for fault in plan.faults}
    for channel, topic in TRUTH.items():
        if channel == "attitude" or channel in recording.faults or channel in overlaid:
            wire = VectorWire(EARTH_FRAME if channel == "attitude" else frame)
            made[topic] = _serialise(VECTOR, every, wire, true_fault(recording, diagnosed, channel))
    if not rows.all():
        made[DROPPED] = _serialise(HEADER, every[~rows], _dropped, repeat(frame, int((~rows).sum())))
    return {topic: made[topic] for topic in TOPICS if topic in made}


def _encode_imu(stamp_ns: Stamps, samples: ImuSample, frame: str) -> SerializedTopic:
    return _serialise(IMU, stamp_ns, ImuWire(frame), map(ImuSample, *samples))


def _dropped(stamp_ns: int, frame: str) -> bytes:
    return serialize_message(Header(stamp=time_message(stamp_ns), frame_id=frame))


def _serialise(
    type_name: str, stamp_ns: Stamps, write: Callable[[int, T], bytes], values: Iterable[T]
) -> SerializedTopic:
    messages = [write(stamp, value) for stamp, value in zip(stamp_ns.tolist(), values, strict=True)]
    return SerializedTopic(type_name, stamp_ns, messages)
