"""A flight that was recorded live, without a scenario: by a recorder, or by ``ros2 bag record``.

The bag stands for the scenario: its length, its rate, the faults on fault/injected and rotors/fault. The
fault injector says their kinds on /diagnostics. Parts and vehicle are those of
``parameters.yaml`` in or beside the bag, else the nodes' defaults. Times are those of the samples, which fall
behind the clock of the machine when it is too slow.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from quadftc_bags.bag import Bag, BagError
from quadftc_flight.fault_schedule import (
    KINDS,
    SENSORS,
    UNKNOWN_KIND,
    FaultEvent,
    FaultWindow,
    attitude_events,
    merge_windows,
)
from quadftc_flight.flight import Flight, flight_from_bag, has_messages
from quadftc_flight.run_directory import (
    SCENARIO,
    WANTED,
    MissingPartError,
    Parameters,
    RecordedRun,
    attached_text,
    is_replay,
    read_parameters,
    run_name,
    versions_of,
    without_messages,
)
from quadftc_flight.scenario import Scenario, ScenarioError, parse_scenario
from quadftc_flight.summary import summary
from quadftc_model.samples import AXES
from quadftc_sim.rotor_fault import ROTOR

# by one of these topics a bag is a flight of quadftc, not any IMU's
SIGNS = ("attitude/reference", "torque/command", "fault/estimate")
# node -> the parameter that names its part, the role in a scheme, and the node's default
PARTS = {
    "fault_observer": ("observer", "observer", "bank"),
    "disturbance_observer": ("observer", "disturbance_observer", "exosystem"),
    "controller": ("controller", "controller", "ismc"),
}
VEHICLE = "qball_x4"  # default of the nodes
SCHEME = "live"
GAP = 0.5  # s; a fault that is zero for less goes on: a sine, spikes
ZERO = 1e-9  # SI; less is no fault
DIAGNOSTICS = "diagnostics"
ACTING = re.compile(r"(\w+) on (\w+) (.+) until")  # kind, channel, elements of a fault that acts
COLUMNS = dict(zip(SENSORS, ("fault", "gyro_fault", "accelerometer_fault"), strict=True))

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]  # [ns]


class Setpoint(NamedTuple):
    """Where a live vehicle was sent."""

    time: float  # s, since the first sample, on the clock of the samples
    text: str


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LiveRun(RecordedRun):
    """A flight whose faults are those that were injected, whenever that was."""

    events: tuple[FaultEvent, ...]
    rotor_events: tuple[FaultEvent, ...]  # the axis of each is the number of the rotor
    setpoints: tuple[Setpoint, ...]

    @property
    def fault_events(self) -> tuple[FaultEvent, ...]:  # type: ignore[override]
        """When which axis of which sensor was faulty."""
        return self.events

    @property
    def is_whole(self) -> bool:
        """Whether the flight was recorded to its end: as far as anybody knows."""
        return True


def is_live(bag: Bag) -> bool:
    """Whether a bag is a flight of quadftc that was recorded without a scenario."""
    if attached_text(bag, SCENARIO) is not None or is_replay(bag):
        return False
    return has_messages(bag, "imu/data") and any(has_messages(bag, topic) for topic in SIGNS)


def live_run(bag: Bag) -> LiveRun:
    """Make what can be made of a flight without a scenario; BagError if a part of it is not known here."""
    warnings = [f"{bag.path}: recorded live, without a scenario: faults are those on fault/injected"]
    parameters = read_parameters(bag, "vehicle and parts are taken for the nodes' defaults", warnings)
    flight = flight_from_bag(bag)
    scenario = _scenario(bag, parameters, flight)
    events, of_rotors = (with_kinds(bag, found) for found in (events_of(flight), rotor_events_of(flight)))
    windows = merge_windows(
        FaultWindow(event.start, event.stop, (event.axis,)) for event in attitude_events(events)
    )
    scheme = scenario.schemes[SCHEME]
    if missing := without_messages(bag, ("plant/attitude", *WANTED)):
        warnings.append(f"{bag.path}: no message on {', '.join(missing)}; their numbers are missing")
    return LiveRun(
        name=run_name(bag.path),
        path=bag.path,
        bag=bag,
        parameters=parameters,
        flight=flight,
        summary={**summary(flight, scenario, scheme, None, (windows, events, of_rotors)), "mode": "realtime"},
        versions=versions_of({}, bag),
        warnings=tuple(warnings),
        scenario=scenario,
        scheme=scheme,
        events=events,
        rotor_events=of_rotors,
        setpoints=_setpoints(bag),
    )


def events_of(flight: Flight) -> tuple[FaultEvent, ...]:
    """Return when which axis of which sensor was faulty, by the truth that was recorded."""
    found: list[FaultEvent] = []
    for component, column in COLUMNS.items():
        sizes: Floats = getattr(flight, column)
        for axis, name in enumerate(AXES):
            faulty = np.abs(sizes[:, axis]) > ZERO  # false where it is not known
            found += [
                FaultEvent(name, UNKNOWN_KIND, start, stop, component)
                for start, stop in _spans(flight.time, faulty)
            ]
    return tuple(sorted(found, key=lambda event: event.start))


def rotor_events_of(flight: Flight) -> tuple[FaultEvent, ...]:
    """Return when which rotor gave another thrust than a healthy one, by the truth that was recorded."""
    lost = np.abs(1.0 - flight.rotor_effectiveness) > ZERO  # (n, rotors); false where it is not known
    found = [
        FaultEvent(str(rotor), UNKNOWN_KIND, start, stop, ROTOR)
        for rotor, faulty in enumerate(lost.T, 1)
        for start, stop in _spans(flight.time, faulty)
    ]
    return tuple(sorted(found, key=lambda event: event.start))


def with_kinds(bag: Bag, events: Iterable[FaultEvent]) -> tuple[FaultEvent, ...]:
    """Give events the kinds that the fault injector said meanwhile; without its words they keep theirs."""
    told: list[tuple[float, re.Match[str]]] = []  # time of flight [s]
    if has_messages(bag, DIAGNOSTICS):
        series, samples = bag.series(DIAGNOSTICS), bag.series("imu/data")
        times = flight_times(series.log_time_ns, samples.log_time_ns, samples.stamp_ns)
        for time, statuses in zip(times.tolist(), series["status"], strict=True):
            pairs = [pair for each in statuses if each.name.endswith(": faults") for pair in each.values]
            told += [(time, words) for pair in pairs if (words := ACTING.match(pair.value))]

    def kind_of(event: FaultEvent) -> str:
        kinds = dict.fromkeys(
            KINDS.get(words[1], words[1])
            for time, words in told
            if event.start <= time <= event.stop
            and words[2] == event.component
            and event.axis in words[3].split(", ")
        )
        return "+".join(kinds) or event.kind

    return tuple(event._replace(kind=kind_of(event)) for event in events)


def flight_times(log_ns: Stamps, sample_log_ns: Stamps, sample_stamp_ns: Stamps) -> Floats:
    """Return the time of flight [s] at which something was recorded, (n,) each.

    Samples say by when they were recorded how their stamps go on; they may lag the clock of the machine.
    """
    first = sample_log_ns[0]
    since = (sample_stamp_ns - sample_stamp_ns[0]) * 1e-9
    return np.asarray(np.interp(log_ns - first, sample_log_ns - first, since), np.float64)


def _spans(time: Floats, there: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return begin and end [s] of the times in which something is there, across short gaps."""
    times = time[there]
    if not len(times):
        return []
    last = np.flatnonzero(np.diff(times) > GAP)
    begins, ends = times[np.r_[0, last + 1]], times[np.r_[last, len(times) - 1]]
    after = np.r_[time, time[-1] + _period(time)]  # the first moment without it
    return [
        (float(begin), float(after[np.searchsorted(after, end) + 1]))
        for begin, end in zip(begins, ends, strict=True)
    ]


def _period(time: Floats) -> float:
    """Return the usual time between two samples [s]."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.01


def _scenario(bag: Bag, parameters: Parameters, flight: Flight) -> Scenario:
    """Describe the flight as a scenario does, as far as the bag tells."""
    period = _period(flight.time)
    scheme = {
        role: str(parameters.get(node, {}).get(name, default))
        for node, (name, role, default) in PARTS.items()
    }
    for role, topic in (("observer", "fault/estimate"), ("disturbance_observer", "disturbance/estimate")):
        if not parameters and not has_messages(bag, topic):
            scheme[role] = "none"
    vehicle = parameters.get("controller", {}).get("vehicle", VEHICLE)
    told = {
        "description": "recorded live; this is what the bag tells",
        "name": "".join(each if each.isalnum() or each in "_-" else "_" for each in run_name(bag.path)),
        "duration": float(flight.time[-1]) + period,
        "rate": round(1.0 / period, 3),
        "vehicle": str(vehicle),
        "schemes": {SCHEME: scheme},
    }
    try:
        return parse_scenario(yaml.safe_dump(told, sort_keys=False), str(bag.path))
    except ScenarioError as error:
        raise MissingPartError(f"{bag.path}: {str(error).splitlines()[0]}") from None
    except ValueError as error:
        raise BagError(f"{bag.path}: {error}") from None


def _setpoints(bag: Bag) -> tuple[Setpoint, ...]:
    """Return the live setpoints of the attitude and of the position."""
    found: list[Setpoint] = []
    for topic, field, unit in (
        ("attitude/setpoint", "vector", "deg"),
        ("position/setpoint", "pose.position", "m"),
    ):
        if not has_messages(bag, topic):
            continue
        series, samples = bag.series(topic), bag.series("imu/data")
        times = flight_times(series.log_time_ns, samples.log_time_ns, samples.stamp_ns)
        for time, values in zip(times, series[field], strict=True):
            numbers = [math.degrees(value) if unit == "deg" else value for value in values]
            text = f"{topic.partition('/')[0]}: {', '.join(f'{number:.4g}' for number in numbers)} {unit}"
            found.append(Setpoint(float(time), text))
    return tuple(sorted(found))
