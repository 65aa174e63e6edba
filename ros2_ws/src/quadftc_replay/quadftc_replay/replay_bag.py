"""A replay as a rosbag2 bag that any ROS 2 tool opens, with a summary beside it.

The topics are those of the graph, with its stamps: messages are stored under the time of their sample.
Of a bag, plant/imu and torque/command are as recorded; of a log, plant/imu is made of its samples. imu/data
is what the observer saw. fault/injected is the recorded and the overlaid fault together. What cannot be used
of a recorded sample (not finite, no unit quaternion) is marked absent in imu/data.
"""

from __future__ import annotations

import json
import shutil
import time
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_bags.bag_file import BagFile
from quadftc_flight.flight import onset_ns
from quadftc_flight.loop_bag import CHUNK, Fields, Message, add_topic, encoded, imu_fields, write_messages
from quadftc_flight.run_directory import DESCRIPTION, PARAMETERS, SUMMARY
from quadftc_flight.run_files import RunError, prepare
from quadftc_model.samples import ImuSample
from quadftc_replay.diagnose import Diagnosed, Progress, true_fault
from quadftc_replay.imu_from_bag import CORRECTED, DATA, DROPPED, UNTOUCHED
from quadftc_replay.imu_recording import SerializedTopic, Stamps
from quadftc_replay.plan import Replay, ReplayOptions, plan_replay
from quadftc_ros.diagnosis_wire import DiagnosisWire
from quadftc_ros.topics import IMU_FRAME, TOPICS
from quadftc_ros.versions import versions
from quadftc_sim.injection import TRUTH


def replay(
    path: Path, options: ReplayOptions, out: Path, force: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Replay a recording (see `plan_replay`); return the summary that is written beside the bag.

    The bag becomes the directory ``out/<recording>-<observer>``; ``force`` replaces an earlier one. If it
    cannot be written, or is there already, a RunError says so.
    """
    begin = time.perf_counter()
    plan = plan_replay(path, options)
    directory = out / plan.name
    source, target = path.resolve(), directory.resolve()
    if target in (source, *source.parents):
        raise BagError(f"{path}: lies in {directory}, which the replay would replace; choose another --out")
    # from here on an earlier replay is gone; an interrupted one leaves nothing that looks whole
    prepare(out, [plan.name], force)
    diagnosed = plan.diagnose(progress)
    diagnosing = time.perf_counter() - begin
    warnings = list(plan.recording.warnings)
    if count := diagnosed.unusable:
        warnings.append(f"the estimate was not finite at {count} samples; the observer restarted after each")
    try:
        _write(plan, diagnosed, directory)
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


def _write(plan: Replay, diagnosed: Diagnosed, directory: Path) -> None:
    texts = {PARAMETERS: plan.parameter_file(), DESCRIPTION: plan.origin.description()}
    attachments = {name: text.encode() for name, text in texts.items()}
    bag = BagFile(directory, attachments, {"mode": "replay", **versions()}, "zstd", CHUNK)
    messages: list[Message] = []
    for channel, (name, topic) in enumerate(_topics(plan, diagnosed).items(), 1):
        add_topic(bag, name, plan.recording.namespace)
        messages += zip(topic.stamp_ns.tolist(), repeat(channel), topic.messages)
    try:
        write_messages(bag, messages)
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

    def made_of(topic: str, stamp_ns: Stamps, fields: Fields) -> None:
        frames = {"frame_id": frame} if TOPICS[topic].frame == IMU_FRAME else {}
        made[topic] = SerializedTopic(stamp_ns, encoded(topic, stamp_ns, {**frames, **fields}))

    made = {**recording.passed_on}
    if not made:
        made_of(UNTOUCHED, every, imu_fields(recording.imu._asdict()))
    for topic, samples in ((DATA, diagnosed.seen), (CORRECTED, said.corrected)):
        made_of(topic, given, imu_fields(ImuSample(*(column[rows] for column in samples))._asdict()))
    status = {"state": said.state, "estimate": said.fault, "std_dev": said.std_dev}
    status["onset_ns"] = onset_ns(every[:, None], said.onset_age)
    made_of("fault/status", given, {name: column[rows] for name, column in status.items()})
    made_of("fault/estimate", given, {"vector": said.fault[rows]})
    stamps = np.array([report.stamp_ns for report in diagnosed.reports], np.int64)
    write_report = DiagnosisWire(frame)
    made["diagnosis"] = SerializedTopic(stamps, [write_report(report) for report in diagnosed.reports])
    overlaid = {fault.injection.channel for fault in plan.faults}
    for channel, topic in TRUTH.items():
        if channel == "attitude" or channel in recording.faults or channel in overlaid:
            made_of(topic, every, {"vector": true_fault(recording, diagnosed, channel)})
    if not rows.all():
        made_of(DROPPED, every[~rows], {})
    return {topic: made[topic] for topic in TOPICS if topic in made}
