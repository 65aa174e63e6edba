"""The recording of an IMU from a rosbag2 bag: which topic it is, and what else the bag tells.

The faults that a bag of ``quadftc run`` already has in its samples are part of the truth; so are its torque
commands, which observers take as input.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import yaml
from numpy.typing import NDArray

from quadftc_bags.bag import Bag, BagError, Series, TopicInfo, bag_topics, read_bag
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, events_of_windows
from quadftc_flight.flight import join_rows
from quadftc_flight.run_directory import NO_PARAMETERS, PARAMETERS, SCENARIO, attached_text, run_name
from quadftc_flight.scenario import ScenarioError, parse_scenario
from quadftc_model.samples import ABSENT, AXES, ImuSample
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay import imu_recording
from quadftc_replay.imu_recording import Floats, Recording, SerializedTopic, Stamps
from quadftc_replay.readers.bag_columns import is_named
from quadftc_replay.readers.contents import list_some
from quadftc_sim.injection import TRUTH

IMU = "sensor_msgs/msg/Imu"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
HEADER = "std_msgs/msg/Header"
# topics of an IMU: behind the fault injector, before it, corrected by the diagnosis
DATA, UNTOUCHED, CORRECTED = "imu/data", "plant/imu", "imu/corrected"
TORQUE = "torque/command"
DROPPED = "fault/dropped"
PAUSE = 1.0  # s; a fault that pauses for less is one fault
SHOWN = 12  # topics in one line

_Topics = Mapping[str, TopicInfo]
_Timed = TypeVar("_Timed", FaultWindow, FaultEvent)
_Truth = tuple[dict[str, Floats], tuple[FaultWindow, ...], tuple[FaultEvent, ...]]


def recording_from_bag(path: Path, topic: str = "", skip_backwards: bool = False) -> Recording:
    """Read the samples of one IMU from a rosbag2 directory (MCAP or SQLite), an ``.mcap`` or a ``.db3`` file.

    The topic is a full name or the end of one; empty: the only IMU there is, or ``imu/data``. A bag in which
    stamps go back is refused, unless ``skip_backwards`` leaves such samples out. A BagError of one line says
    that there is no such topic, or nothing that can be diagnosed.
    """
    # which topics belong to this IMU
    topics = bag_topics(path)
    name = _choose_imu(topics, topic, path)
    of_graph = next((each for each in (DATA, UNTOUCHED, CORRECTED) if is_named(name, each)), None)
    namespace = "/" if of_graph is None else name.removesuffix(of_graph)
    torque_topic = _torque_topic(topics, namespace, is_foreign=of_graph is None)
    truth = _truth_topics(topics, namespace) if of_graph == DATA else []  # what is before it has no fault
    # the samples
    bag = read_bag(path, [name, *truth, *([torque_topic] if torque_topic else [])])
    imu, where = bag.series(name), f"{path}: {name}"
    kept = imu_recording.keep_good_stamps(imu.stamp_ns, imu.log_time_ns, where, skip_backwards)
    samples, absences = imu_recording.clean_samples(_samples(imu, kept.rows), kept.stamp_ns, where)
    messages = [data for _, _, data in bag.messages([name])]
    passed_on = {UNTOUCHED: SerializedTopic(kept.stamp_ns, [messages[k] for k in kept.rows.tolist()])}
    # the torque that acted
    torque = np.zeros((len(kept.rows), 3))
    if torque_topic:
        commands = bag.series(torque_topic)
        torque = imu_recording.torque_before(kept.stamp_ns, commands.stamp_ns, commands["vector"])
        messages = [data for _, _, data in bag.messages([torque_topic])]
        passed_on[TORQUE] = SerializedTopic(commands.stamp_ns, messages)
    faults, windows, events = _read_truth(bag, truth, namespace, kept.stamp_ns)
    cut = [f"{path}: cut short; read up to there{bag.remedy}"] if bag.truncated else []
    return Recording(
        name=run_name(path),
        path=path,
        topic=name,
        namespace=f"/{namespace.strip('/')}/".replace("//", "/"),
        stamp_ns=kept.stamp_ns,
        imu=samples,
        torque=torque,
        torque_topic=torque_topic,
        faults=faults,
        fault_windows=windows,
        fault_events=events,
        observer=_observer_parameters(bag, namespace),
        passed_on=passed_on,
        rejected=kept.rejected,
        warnings=(*cut, *kept.warnings, *absences),
    )


def _choose_imu(topics: _Topics, wanted: str, path: Path) -> str:
    if wanted:
        names = [_full_name(topics, wanted, path)]
        type_name = topics[names[0]].type_name
        if type_name != IMU:
            raise BagError(f"{path}: topic '{names[0]}' is of type {type_name}, expected {IMU}")
    else:
        names = [name for name, info in topics.items() if info.type_name == IMU]
        if not names:
            raise BagError(f"{path}: no topic of type {IMU}; topics there: {_list_topics(topics)}")
    filled = [name for name in names if topics[name].count]
    if not filled:
        raise BagError(f"{path}: no message on {', '.join(names)}")
    chosen = filled if len(filled) == 1 else [name for name in filled if is_named(name, DATA)]
    if len(chosen) != 1:
        raise BagError(f"{path}: several IMUs, choose one with --topic: {', '.join(sorted(filled))}")
    return chosen[0]


def windows_of(stamp_ns: Stamps, fault: Floats) -> tuple[FaultWindow, ...]:
    """Return when a fault (n, 3) acts: a window for each time without a pause longer than ``PAUSE``."""
    acts = fault != 0.0  # true for NaN, too
    rows = np.flatnonzero(acts.any(axis=1))
    time = (stamp_ns - stamp_ns[0]) / NANOSECONDS_PER_SECOND
    breaks = np.flatnonzero(np.diff(time[rows]) > PAUSE) + 1
    windows: list[FaultWindow] = []
    for part in np.split(rows, breaks) if len(rows) else ():
        stop = time[min(int(part[-1]) + 1, len(time) - 1)]
        axes = tuple(axis for axis, on in zip(AXES, acts[part].any(axis=0), strict=True) if on)
        windows.append(FaultWindow(float(time[part[0]]), float(stop), axes))
    return tuple(windows)


def _samples(imu: Series, rows: NDArray[np.intp]) -> ImuSample:
    """Samples of IMU messages; absent channels are marked by covariance element 0 as REP-145 says."""
    fields = ("orientation_xyzw", "angular_velocity", "linear_acceleration")
    covariances = ("orientation_covariance", "angular_velocity_covariance", "linear_acceleration_covariance")
    valid = [imu[covariance][rows, 0] != ABSENT for covariance in covariances]
    return ImuSample(*(imu[field][rows] for field in fields), *valid)


def _full_name(topics: _Topics, wanted: str, path: Path) -> str:
    """Full name of a topic: as given, with or without its slash, or in the only namespace that has it."""
    short = wanted.strip("/")
    names = [wanted] if wanted in topics else [name for name in topics if name.strip("/") == short]
    names = names or [name for name in topics if is_named(name, short)]
    if len(names) == 1:
        return names[0]
    problem = "is in more than one namespace" if names else "is not in the bag"
    there = ", ".join(sorted(names)) if names else _list_topics(topics)
    raise BagError(f"{path}: topic '{wanted}' {problem}; topics there: {there}")


def _list_topics(topics: _Topics) -> str:
    return list_some([f"{name} ({info.type_name})" for name, info in sorted(topics.items())], SHOWN)


def _torque_topic(topics: _Topics, namespace: str, is_foreign: bool) -> str | None:
    """The commands that belong to an IMU: of its namespace; beside a foreign IMU, the only ones there are."""
    there = [
        n for n, info in topics.items() if info.type_name == VECTOR and info.count and is_named(n, TORQUE)
    ]
    own = f"{namespace}{TORQUE}"
    return own if own in there else there[0] if len(there) == 1 and is_foreign else None


def _truth_topics(topics: _Topics, namespace: str) -> list[str]:
    """Topics that say which faults are in the samples behind the injector."""
    types = {f"{namespace}{topic}": VECTOR for topic in TRUTH.values()} | {f"{namespace}{DROPPED}": HEADER}
    there = ((name, kind, topics[name]) for name, kind in types.items() if name in topics)
    return [name for name, kind, info in there if info.type_name == kind and info.count]


def _read_truth(bag: Bag, topics: Collection[str], namespace: str, stamp_ns: Stamps) -> _Truth:
    """Read the true faults on the rows of the samples, and when the attitude is faulty.

    The schedule of the attached scenario says when, else the recorded fault. Times count from the first
    sample; before it, samples were withheld.
    """
    faults = {
        channel: join_rows(bag.series(f"{namespace}{topic}"), "vector", stamp_ns, np.full(3, np.nan))
        for channel, topic in TRUTH.items()
        if f"{namespace}{topic}" in topics
    }
    if "attitude" not in faults:
        return faults, (), ()
    try:
        scenario = parse_scenario(attached_text(bag, SCENARIO) or "", f"{bag.path}: {SCENARIO}")
    except ScenarioError:  # none is there, too
        windows = windows_of(stamp_ns, faults["attitude"])
        return faults, windows, events_of_windows(windows)
    dropped = f"{namespace}{DROPPED}"
    first_ns = bag.series(dropped).stamp_ns.min() if dropped in topics else stamp_ns[0]
    late = max(0.0, float(int(stamp_ns[0]) - int(first_ns)) / NANOSECONDS_PER_SECOND)
    return faults, _shift(scenario.fault_windows, late), _shift(scenario.fault_events, late)


def _shift(items: tuple[_Timed, ...], late: float) -> tuple[_Timed, ...]:
    """Count times from a moment that is that much later [s]."""
    return tuple(
        item._replace(start=max(0.0, item.start - late), stop=item.stop - late)
        for item in items
        if item.stop > late
    )


def _observer_parameters(bag: Bag, namespace: str) -> dict[str, object] | None:
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
