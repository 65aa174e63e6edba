"""A recording from a rosbag2 bag: which of its topics is the IMU, and what else there is to know.

The faults that a bag of ``quadftc run`` already has in its samples are part of the truth; so are its torque
commands, which observers take as input.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from quadftc_bags.bag import Bag, BagError, Series, TopicInfo, bag_topics, read_bag
from quadftc_flight.run_directory import (
    NO_PARAMETERS,
    PARAMETERS,
    attached_text,
    run_name,
)
from quadftc_model.samples import ABSENT, ImuSample
from quadftc_replay.bag_truth import DROPPED, TRUTH, fault_windows, recorded_events, recorded_faults
from quadftc_replay.recording import Passenger, Recording, cleaned, keep_good_stamps, torque_before

IMU = "sensor_msgs/msg/Imu"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
HEADER = "std_msgs/msg/Header"
DATA, UNTOUCHED, CORRECTED = (
    "imu/data",
    "plant/imu",
    "imu/corrected",
)  # behind the injector, before it, diagnosed
TORQUE = "torque/command"
SHOWN = 12  # topics in one line

_FIELDS = {
    "q_xyzw": ("orientation_xyzw", "orientation_covariance"),
    "body_rate": ("angular_velocity", "angular_velocity_covariance"),
    "specific_force": ("linear_acceleration", "linear_acceleration_covariance"),
}


def recording_from_bag(path: Path, topic: str = "", skip_backwards: bool = False) -> Recording:
    """Read the samples of one IMU.

    Parameters
    ----------
    path : Path
        A rosbag2 directory (MCAP or SQLite), an ``.mcap`` or a ``.db3`` file.
    topic : str
        Of the IMU, in full or its end; empty: the only one there is, or ``imu/data``.
    skip_backwards : bool
        Leave out samples whose stamp goes back, instead of refusing the bag.

    Raises
    ------
    BagError
        If there is no such topic, or it holds nothing that can be diagnosed; one line.
    """
    topics = bag_topics(path)
    name = choose_imu(topics, topic, path)
    namespace = _namespace(name)
    torque_topic = _torque_topic(topics, name, namespace)
    wanted = [name, *([torque_topic] if torque_topic else []), *_truth_topics(topics, name, namespace)]
    bag = read_bag(path, wanted)
    imu, where = bag.series(name), f"{path}: {name}"
    kept = keep_good_stamps(imu.stamp_ns, imu.log_time_ns, where, skip_backwards)
    samples, absences = cleaned(_samples(imu, kept.rows), kept.stamp_ns, where)
    messages = _messages(bag, name)
    passengers = {UNTOUCHED: Passenger(IMU, kept.stamp_ns, [messages[row] for row in kept.rows.tolist()])}
    torque = np.zeros((len(kept.rows), 3))
    if torque_topic:
        commands = bag.series(torque_topic)
        torque = torque_before(kept.stamp_ns, commands.stamp_ns, commands["vector"])
        passengers[TORQUE] = Passenger(VECTOR, commands.stamp_ns, _messages(bag, torque_topic))
    faults = recorded_faults(bag, wanted, namespace, kept.stamp_ns)
    cut = [f"{path}: cut short; read up to there{bag.remedy}"] if bag.truncated else []
    return Recording(
        name=run_name(path),
        path=path,
        topic=name,
        namespace=namespace,
        stamp_ns=kept.stamp_ns,
        imu=samples,
        torque=torque,
        torque_topic=torque_topic,
        faults=faults,
        fault_windows=fault_windows(bag, wanted, namespace, kept.stamp_ns, faults),
        fault_events=recorded_events(bag, wanted, namespace, kept.stamp_ns, faults),
        observer=_observer_parameters(bag, namespace),
        passengers=passengers,
        rejected=kept.rejected,
        warnings=(*cut, *kept.warnings, *absences),
    )


def choose_imu(topics: Mapping[str, TopicInfo], wanted: str, path: Path) -> str:
    """Return the full name of the topic to replay.

    Raises
    ------
    BagError
        If there is none, it is empty or no IMU, or there are several and none was asked for.
    """
    if wanted:
        name = _resolved(topics, wanted, path)
        if topics[name].type_name != IMU:
            raise BagError(f"{path}: topic '{name}' is of type {topics[name].type_name}, expected {IMU}")
        if not topics[name].count:
            raise BagError(f"{path}: no message on '{name}'")
        return name
    imus = [name for name, info in topics.items() if info.type_name == IMU]
    filled = [name for name in imus if topics[name].count]
    if not imus:
        raise BagError(f"{path}: no topic of type {IMU}; topics there: {_listed(topics)}")
    if not filled:
        raise BagError(f"{path}: no message on {', '.join(imus)}")
    chosen = filled if len(filled) == 1 else [name for name in filled if _is(name, DATA)]
    if len(chosen) != 1:
        raise BagError(f"{path}: several IMUs, choose one with --topic: {', '.join(sorted(filled))}")
    return chosen[0]


def _samples(series: Series, rows: NDArray[np.intp]) -> ImuSample:
    """Samples of IMU messages; absent channels are marked by covariance element 0 as REP-145 says."""
    values = {part: series[field][rows] for part, (field, _) in _FIELDS.items()}
    valid = [series[covariance][rows, 0] != ABSENT for _, covariance in _FIELDS.values()]
    return ImuSample(**values, attitude_valid=valid[0], rate_valid=valid[1], force_valid=valid[2])


def _messages(bag: Bag, topic: str) -> list[bytes]:
    return [data for _, _, data in bag.messages([topic])]


def _resolved(topics: Mapping[str, TopicInfo], wanted: str, path: Path) -> str:
    """Full name of a topic: as given, with or without its slash, or in the only namespace that has it."""
    exact = [name for name in topics if name == wanted] or [
        name for name in topics if name.strip("/") == wanted.strip("/")
    ]
    names = exact or [name for name in topics if _is(name, wanted.strip("/"))]
    if len(names) == 1:
        return names[0]
    problem = "is in more than one namespace" if names else "is not in the bag"
    there = ", ".join(sorted(names)) if names else _listed(topics)
    raise BagError(f"{path}: topic '{wanted}' {problem}; topics there: {there}")


def _listed(topics: Mapping[str, TopicInfo]) -> str:
    words = [f"{name} ({info.type_name})" for name, info in sorted(topics.items())]
    more = f" and {len(words) - SHOWN} more" if len(words) > SHOWN else ""
    return (", ".join(words[:SHOWN]) or "none") + more


def _is(name: str, topic: str) -> bool:
    """Whether a full name is that of a relative topic, in whatever namespace."""
    return f"/{name.lstrip('/')}".endswith(f"/{topic}")


def _graph_topic(name: str) -> str | None:
    """The topic of the graph that a full name stands for, if any."""
    return next((topic for topic in (DATA, UNTOUCHED, CORRECTED) if _is(name, topic)), None)


def _namespace(name: str) -> str:
    """Namespace of the vehicle whose graph has this topic; ``/`` if it is no topic of the graph."""
    topic = _graph_topic(name)
    return "/" if topic is None else name.removesuffix(topic)


def _torque_topic(topics: Mapping[str, TopicInfo], imu: str, namespace: str) -> str | None:
    """The commands that belong to an IMU: of its namespace; beside a foreign IMU, the only ones there are."""
    there = [
        name for name, info in topics.items() if _is(name, TORQUE) and info.type_name == VECTOR and info.count
    ]
    own = f"{namespace}{TORQUE}"
    if own in there:
        return own
    return there[0] if len(there) == 1 and _graph_topic(imu) is None else None


def _truth_topics(topics: Mapping[str, TopicInfo], imu: str, namespace: str) -> list[str]:
    """Topics that say which faults are in these samples: only those behind the injector have any."""
    if _graph_topic(imu) != DATA:
        return []
    types = {f"{namespace}{topic}": VECTOR for topic in TRUTH.values()} | {f"{namespace}{DROPPED}": HEADER}
    there = {name: topics[name] for name in types if name in topics}
    return [name for name, info in there.items() if info.type_name == types[name] and info.count]


def _observer_parameters(bag: Bag, namespace: str) -> dict[str, Any] | None:
    """Parameters of the node that diagnosed these samples; empty: not stored; None: stored, but no sense."""
    text = attached_text(bag, PARAMETERS)
    if text is None:
        return {}
    try:
        nodes = cast("dict[str, Any]", yaml.safe_load(text))
        named = [node for node in nodes if str(node).rpartition("/")[2] == "fault_observer"]
        own = [node for node in named if node == f"{namespace}fault_observer"] or named
        found = dict(nodes[own[0]]["ros__parameters"]) if own else {}
        return found if all(isinstance(name, str) for name in found) else None
    except NO_PARAMETERS:
        return None
