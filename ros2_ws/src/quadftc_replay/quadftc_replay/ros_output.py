# pyright: basic
"""A replay as a rosbag2 bag that any ROS 2 tool opens, with a summary beside it.

| topic | what |
|---|---|
| plant/imu | the samples as recorded: what went into the fault injector |
| imu/data | the samples with the overlaid faults: what the observer saw |
| fault/injected, fault/injected/gyro, fault/injected/accelerometer | truth: recorded and overlaid |
| fault/dropped | stamps of samples that an overlaid fault withheld |
| imu/corrected, fault/estimate, fault/status | what the observer said |
| torque/command | as recorded, if it was |

They are the topics of the graph, with its stamps: messages are stored under the time of their sample. What
cannot be used of a recorded sample (not finite, no unit quaternion) is marked absent in imu/data.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from quadftc_bags.bag import BagError
from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import TopicRecord, offered_qos
from quadftc_bags.cdr.arrays import encode_topic
from quadftc_bags.cdr.padding import PaddingCleaner
from quadftc_bags.interfaces import load_interface
from quadftc_flight.flight import onset_ns
from quadftc_flight.run_directory import DESCRIPTION, PARAMETERS, SUMMARY
from quadftc_flight.runs import RunError, prepare
from quadftc_model.samples import ABSENT, ImuSample
from quadftc_msgs.msg import FaultStatus
from quadftc_replay.diagnose import Diagnosed, true_fault
from quadftc_replay.imu_from_bag import CORRECTED, DATA, DROPPED, HEADER, IMU, TRUTH, UNTOUCHED, VECTOR
from quadftc_replay.imu_recording import SerializedTopic, Stamps
from quadftc_replay.plan import Replay, ReplayOptions, plan_replay
from quadftc_ros.qos import topic_profile
from quadftc_ros.topics import EARTH_FRAME, IMU_FRAME, TOPICS
from quadftc_ros.versions import versions

CHUNK = 1024 * 1024  # bytes
DIAGNOSING = 0.85  # share of the work; the rest is writing
STRIDE = 4096  # messages between two looks of the progress bar

Progress = Callable[[float], None]


def replay(
    path: Path, options: ReplayOptions, out: Path, force: bool = False, progress: Progress | None = None
) -> dict[str, Any]:
    """Replay a recording; return the summary that is written beside the bag.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, an ``.mcap`` or ``.db3`` file, or a PX4 log.
    options : ReplayOptions
    out : Path
        The bag becomes the directory ``out/<recording>-<observer>``.
    force : bool
        Replace an earlier replay of that name.
    progress : callable, optional
        Called with the share of the work that is done.

    Raises
    ------
    ValueError
        If the recording cannot be used (`BagError`), or an option is wrong.
    RunError
        If the bag cannot be written, or is there already.
    """
    follow = progress or (lambda share: None)
    begin = time.perf_counter()
    plan = plan_replay(path, options)
    directory = out / plan.name
    _spare_the_source(path, directory)
    prepare(out, [plan.name], force)
    diagnosed = plan.diagnose(lambda share: follow(DIAGNOSING * share))
    diagnosing = time.perf_counter() - begin
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
            "warnings": [*plan.recording.warnings, *_warnings(diagnosed)],
            "versions": versions(),
        }
        (directory / SUMMARY).write_text(
            json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise RunError(f"{directory}: {error.strerror or error}") from None
    except KeyboardInterrupt:
        shutil.rmtree(directory, ignore_errors=True)
        raise
    return result


def _spare_the_source(path: Path, directory: Path) -> None:
    """Refuse to replace what is being read."""
    source, target = path.resolve(), directory.resolve()
    if source == target or target in source.parents:
        raise BagError(f"{path}: lies in {directory}, which the replay would replace; choose another --out")


def _warnings(diagnosed: Diagnosed) -> list[str]:
    count = diagnosed.unusable
    return [f"the estimate was not finite at {count} samples; the observer restarted after each"] * bool(
        count
    )


def _write(plan: Replay, diagnosed: Diagnosed, directory: Path, follow: Progress) -> None:
    texts = {PARAMETERS: plan.parameter_file(), DESCRIPTION: plan.origin.description()}
    attachments = {name: text.encode() for name, text in texts.items()}
    bag = BagFile(directory, attachments, {"mode": "replay", **versions()}, "zstd", CHUNK)
    topics = _topics(plan, diagnosed)
    for name, topic in topics.items():
        interface = load_interface(topic.type_name)
        qos = offered_qos(topic_profile(TOPICS[name].qos, "realtime"))
        record = TopicRecord(f"{plan.namespace}{name}", topic.type_name, interface.type_hash, qos)
        bag.add_topic(record, interface.text)
    total = sum(len(topic.messages) for topic in topics.values())
    try:
        for number, (channel, stamp_ns, data) in enumerate(_in_order(list(topics.values()))):
            bag.write(channel, stamp_ns, stamp_ns, data)
            if number % STRIDE == 0:
                follow(number / total)
        bag.close()
    except BaseException:
        bag.abandon()
        raise
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")


def _in_order(topics: list[SerializedTopic]) -> Iterator[tuple[int, int, bytes]]:
    """Yield (channel, stamp [ns], message) by stamp, then channel; channels count from 1."""
    stamps = np.concatenate([topic.stamp_ns for topic in topics])
    counts = [len(topic.messages) for topic in topics]
    channels = np.repeat(np.arange(1, len(topics) + 1), counts)
    rows = np.concatenate([np.arange(count) for count in counts])
    for place in np.lexsort((rows, channels, stamps)).tolist():
        channel = int(channels[place])
        yield channel, int(stamps[place]), topics[channel - 1].messages[rows[place]]


def _topics(plan: Replay, diagnosed: Diagnosed) -> dict[str, SerializedTopic]:
    """Messages of every topic, in the order of the table of the graph."""
    recording, rows = plan.recording, diagnosed.delivered
    stamps = recording.stamp_ns
    made = {
        **(recording.passed_on or {UNTOUCHED: _imus(stamps, recording.imu)}),
        DATA: _imus(stamps[rows], _take(diagnosed.seen, rows)),
        CORRECTED: _imus(stamps[rows], _take(diagnosed.corrected, rows)),
        "fault/status": _statuses(stamps[rows], diagnosed, rows),
        "fault/estimate": _vectors(EARTH_FRAME, stamps[rows], diagnosed.fault[rows]),
    }
    for channel, topic in TRUTH.items():
        is_overlaid = any(item.injection.channel == channel for item in plan.faults)
        if channel == "attitude" or channel in recording.faults or is_overlaid:
            frame = EARTH_FRAME if channel == "attitude" else IMU_FRAME
            made[topic] = _vectors(frame, stamps, true_fault(recording, diagnosed, channel))
    if not rows.all():
        template = serialize_message(Header(frame_id=IMU_FRAME))
        made[DROPPED] = _encode(HEADER, template, stamps[~rows], {})
    return {topic: made[topic] for topic in TOPICS if topic in made}


def _take(samples: ImuSample, rows: NDArray[np.bool_]) -> ImuSample:
    return ImuSample(*(column[rows] for column in samples))


def _imus(stamp_ns: Stamps, samples: ImuSample) -> SerializedTopic:
    template = serialize_message(Imu(header=Header(frame_id=IMU_FRAME)))
    valid = (samples.attitude_valid, samples.rate_valid, samples.force_valid)
    covariances = np.zeros((3, len(stamp_ns), 9))
    covariances[:, :, 0] = np.where(valid, 0.0, ABSENT)
    columns = {
        "orientation_xyzw": samples.q_xyzw,
        "orientation_covariance": covariances[0],
        "angular_velocity": samples.body_rate,
        "angular_velocity_covariance": covariances[1],
        "linear_acceleration": samples.specific_force,
        "linear_acceleration_covariance": covariances[2],
    }
    return _encode(IMU, template, stamp_ns, columns)


def _vectors(frame: str, stamp_ns: Stamps, values: NDArray[np.float64]) -> SerializedTopic:
    template = serialize_message(Vector3Stamped(header=Header(frame_id=frame)))
    return _encode(VECTOR, template, stamp_ns, {"vector": values})


def _statuses(stamp_ns: Stamps, diagnosed: Diagnosed, rows: NDArray[np.bool_]) -> SerializedTopic:
    message = FaultStatus()
    message.header.frame_id = IMU_FRAME
    columns = {
        "state": diagnosed.state[rows],
        "estimate": diagnosed.fault[rows],
        "std_dev": diagnosed.std_dev[rows],
        "onset_ns": onset_ns(stamp_ns[:, None], diagnosed.onset_age[rows]),
    }
    return _encode("quadftc_msgs/msg/FaultStatus", serialize_message(message), stamp_ns, columns)


def _encode(
    type_name: str, template: bytes, stamp_ns: Stamps, columns: Mapping[str, NDArray[Any]]
) -> SerializedTopic:
    clean = PaddingCleaner(type_name).clean(template)
    definition = load_interface(type_name).text
    messages = encode_topic(type_name, definition, clean, {"stamp_ns": stamp_ns, **columns})
    return SerializedTopic(type_name, stamp_ns, messages)
