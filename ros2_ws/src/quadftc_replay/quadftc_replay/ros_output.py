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
cannot be used of a recorded sample (no number, no unit quaternion) is marked absent in imu/data.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
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
from quadftc_flight.run_directory import DESCRIPTION, PARAMETERS, SUMMARY
from quadftc_flight.runs import RunError, prepare
from quadftc_model.samples import ABSENT, ImuSample
from quadftc_msgs.msg import FaultStatus
from quadftc_replay.bag_truth import DROPPED, TRUTH
from quadftc_replay.diagnose import Diagnosed, true_fault
from quadftc_replay.plan import YAML_WIDTH, Replay, ReplayOptions, plan_replay
from quadftc_replay.recording import Passenger, Stamps
from quadftc_replay.results import replay_events, replay_windows, truth_text
from quadftc_ros.conversions import NANOSECONDS
from quadftc_ros.qos import topic_profile
from quadftc_ros.topics import EARTH_FRAME, HEADER, IMU_FRAME, TOPICS
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
        result = _finished(plan, diagnosed, path, diagnosing, wall_time)
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


def _finished(
    plan: Replay, diagnosed: Diagnosed, path: Path, diagnosing: float, wall_time: float
) -> dict[str, Any]:
    result = plan.summary(diagnosed)
    duration = plan.recording.duration
    return {
        **result,
        "source": str(path),
        "bag": plan.name,
        "wall_time_s": wall_time,
        "diagnosis_time_s": diagnosing,
        "real_time_factor": duration / wall_time,
        "warnings": list(plan.recording.warnings) + _own_warnings(diagnosed),
        "versions": versions(),
    }


def _own_warnings(diagnosed: Diagnosed) -> list[str]:
    if not diagnosed.no_number:
        return []
    return [f"the observer gave no number at {diagnosed.no_number} samples, and started anew after each"]


def _write(plan: Replay, diagnosed: Diagnosed, directory: Path, follow: Progress) -> None:
    texts = {PARAMETERS: plan.parameter_file(), DESCRIPTION: _description(plan)}
    attachments = {name: text.encode() for name, text in texts.items()}
    bag = BagFile(directory, attachments, {"mode": "replay", **versions()}, "zstd", CHUNK)
    passengers = _passengers(plan, diagnosed)
    prefix = f"/{plan.recording.namespace.strip('/')}/".replace("//", "/")
    for topic, passenger in passengers.items():
        interface = load_interface(passenger.type_name)
        qos = offered_qos(topic_profile(TOPICS[topic].qos, "realtime"))
        record = TopicRecord(f"{prefix}{topic}", passenger.type_name, interface.type_hash, qos)
        bag.add_topic(record, interface.text)
    total = sum(len(passenger.messages) for passenger in passengers.values())
    try:
        for number, (channel, stamp_ns, data) in enumerate(_in_order(list(passengers.values()))):
            bag.write(channel, stamp_ns, stamp_ns, data)
            if number % STRIDE == 0:
                follow(number / total)
        bag.close()
    except BaseException:
        bag.abandon()
        raise
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")


def _in_order(passengers: list[Passenger]) -> Iterator[tuple[int, int, bytes]]:
    """Yield (channel, stamp [ns], message) by stamp, then channel; channels count from 1."""
    stamps = np.concatenate([passenger.stamp_ns for passenger in passengers])
    channels = np.repeat(np.arange(1, len(passengers) + 1), [len(p.messages) for p in passengers])
    rows = np.concatenate([np.arange(len(p.messages)) for p in passengers])
    for place in np.lexsort((rows, channels, stamps)).tolist():
        channel = int(channels[place])
        yield channel, int(stamps[place]), passengers[channel - 1].messages[rows[place]]


def _description(plan: Replay) -> str:
    """What was replayed, and by which faults it is judged; the parameters stand in the parameter file."""
    recording = plan.recording
    windows, events = replay_windows(recording, plan.faults), replay_events(recording, plan.faults)
    content = {
        "recording": recording.name,
        "topic": recording.topic,
        "observer": plan.observer.name,
        "faults": [fault.spec for fault in plan.faults],
        "seed": plan.seed,
        "torque": recording.torque_topic or "zero: none recorded",
        "truth": truth_text(recording, plan.faults),
        "duration": recording.duration,
        "samples": len(recording),
        "samples_left_out": dict(recording.rejected),
        "fault_windows": [
            {"start": float(start), "stop": float(stop), "axes": list(axes)} for start, stop, axes in windows
        ],
        "fault_events": [
            {"axis": axis, "kind": kind, "start": float(start), "stop": float(stop)}
            for axis, kind, start, stop in events
        ],
    }
    return yaml.safe_dump(content, sort_keys=False, width=YAML_WIDTH)


def _passengers(plan: Replay, diagnosed: Diagnosed) -> dict[str, Passenger]:
    """Messages of every topic, in the order of the table of the graph."""
    recording, rows = plan.recording, diagnosed.delivered
    stamps = recording.stamp_ns
    vectors = {TRUTH["attitude"]: (EARTH_FRAME, stamps, true_fault(recording, diagnosed, "attitude"))}
    for channel in ("gyro", "accelerometer"):
        fault = true_fault(recording, diagnosed, channel)
        if channel in recording.faults or any(item.injection.channel == channel for item in plan.faults):
            vectors[TRUTH[channel]] = (IMU_FRAME, stamps, fault)
    vectors["fault/estimate"] = (EARTH_FRAME, stamps[rows], diagnosed.fault[rows])
    made = {
        **(recording.passengers or {"plant/imu": _imus(stamps, recording.imu)}),
        "imu/data": _imus(stamps[rows], _taken(diagnosed.seen, rows)),
        "imu/corrected": _imus(stamps[rows], _taken(diagnosed.corrected, rows)),
        "fault/status": _statuses(stamps[rows], diagnosed, rows),
        **{topic: _vectors(*content) for topic, content in vectors.items()},
    }
    if not rows.all():
        template = serialize_message(Header(frame_id=IMU_FRAME))
        made[DROPPED] = _encoded(HEADER, template, stamps[~rows], {})
    return {topic: made[topic] for topic in TOPICS if topic in made}


def _taken(samples: ImuSample, rows: NDArray[np.bool_]) -> ImuSample:
    return ImuSample(*(column[rows] for column in samples))


def _imus(stamp_ns: Stamps, samples: ImuSample) -> Passenger:
    template = serialize_message(Imu(header=Header(frame_id=IMU_FRAME)))
    covariances = np.zeros((3, len(stamp_ns), 9))
    for covariance, valid in zip(
        covariances, (samples.attitude_valid, samples.rate_valid, samples.force_valid), strict=True
    ):
        covariance[:, 0] = np.where(valid, 0.0, ABSENT)
    columns = {
        "orientation_xyzw": samples.q_xyzw,
        "orientation_covariance": covariances[0],
        "angular_velocity": samples.body_rate,
        "angular_velocity_covariance": covariances[1],
        "linear_acceleration": samples.specific_force,
        "linear_acceleration_covariance": covariances[2],
    }
    return _encoded("sensor_msgs/msg/Imu", template, stamp_ns, columns)


def _vectors(frame: str, stamp_ns: Stamps, values: NDArray[np.float64]) -> Passenger:
    template = serialize_message(Vector3Stamped(header=Header(frame_id=frame)))
    return _encoded("geometry_msgs/msg/Vector3Stamped", template, stamp_ns, {"vector": values})


def _statuses(stamp_ns: Stamps, diagnosed: Diagnosed, rows: NDArray[np.bool_]) -> Passenger:
    message = FaultStatus()
    message.header.frame_id = IMU_FRAME
    age = diagnosed.onset_age[rows]
    onset = stamp_ns[:, None] - np.round(age * NANOSECONDS).astype(np.int64)
    columns = {
        "state": diagnosed.state[rows],
        "estimate": diagnosed.fault[rows],
        "std_dev": diagnosed.std_dev[rows],
        "onset_ns": np.where(age >= 0.0, onset, 0),
    }
    return _encoded("quadftc_msgs/msg/FaultStatus", serialize_message(message), stamp_ns, columns)


def _encoded(
    type_name: str, template: bytes, stamp_ns: Stamps, columns: Mapping[str, NDArray[Any]]
) -> Passenger:
    clean = PaddingCleaner(type_name).clean(template)
    definition = load_interface(type_name).text
    messages = encode_topic(type_name, definition, clean, {"stamp_ns": stamp_ns, **columns})
    return Passenger(type_name, stamp_ns, messages)
