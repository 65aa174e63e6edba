"""Alarms of a fault observer on a trial: found in its estimates, stored as text, compared, counted.

An alarm is a time in which one element of a component (``gyro/x``) is declared without a break, in one state.
That is FAULTY (recovering ones, too), or AMBIGUOUS where another element may be the faulty one.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import elements_of, watched_sensors
from quadftc_fdi.fault_observer import FaultObserver
from quadftc_flight.metrics import LOST
from quadftc_model.samples import ALARMS, FAULT_KINDS, FaultEstimate, SensorEstimate
from quadftc_tools.study.numbers import write_degrees, write_number, write_times
from quadftc_tools.study.page import NOTHING, markdown

Floats = NDArray[np.float64]

STATES = ("", "FAULTY", "AMBIGUOUS")
LATER = 0.005  # s; by which times may differ: one sample of most trials
ROUNDING = 0.1  # 1; by which numbers of two digits may differ: 0.10 and 0.11
DOUBT = 0.015  # 1; the same of probabilities


class Alarm(NamedTuple):
    """One element, declared without a break; times since the first sample of the trial."""

    element: str
    state: str  # FAULTY or AMBIGUOUS
    declared: float  # [s]
    onset: float  # as the observer dates it when it declares [s]
    end: float  # [s]; the last sample if it lasts
    probability: float  # median over this time [1]; -1: the observer gives none
    size: float  # median: rad, rad/s, m/s², of a rotor the share of its thrust that is lost
    kind: str  # that it has most of the time, of `FAULT_KINDS`


class Event(NamedTuple):
    """A true fault of one element."""

    element: str
    start: float  # [s]
    stop: float  # [s]


class Verdict(NamedTuple):
    """What an observer said on a trial, and how it flew with it."""

    alarms: tuple[Alarm, ...]
    error_deg: float | None = None  # largest attitude error [deg]; None: a recording
    judged: tuple[float, float] = (0.0, 0.0)  # in which alarms count [s]; not stored
    events: tuple[Event, ...] = ()  # not stored
    absences: tuple[Event, ...] = ()  # samples that a recording lacks: no alarm is false there; not stored


def alarms_of(law: FaultObserver, time: Floats, estimate: FaultEstimate) -> tuple[Alarm, ...]:
    """Return the alarms in the estimates (n, ...) of an observer at some times (n,) [s]."""
    found = [
        alarm
        for component, sensor in watched_sensors(law, estimate).items()
        for alarm in _alarms_of_component(component, time, sensor)
    ]
    return tuple(sorted(found, key=lambda alarm: (alarm.declared, alarm.element)))


def _alarms_of_component(component: str, time: Floats, sensor: SensorEstimate) -> Iterator[Alarm]:
    state, size, _, age, probability, kind, ambiguous = map(np.asarray, sensor)
    shape = state.shape
    probability, kind, ambiguous = (np.broadcast_to(each, shape) for each in (probability, kind, ambiguous))
    codes = np.isin(state, ALARMS) * (1 + ambiguous.astype(np.int8))
    for column, name in enumerate(elements_of(component, shape[-1])[0]):
        code = codes[:, column]
        edges = np.flatnonzero(np.diff(code, prepend=0, append=0)).tolist()
        for first, last in itertools.pairwise(edges):
            if code[first]:
                rows = slice(first, last)
                yield Alarm(
                    f"{component}/{name}",
                    STATES[code[first]],
                    round(float(time[first]), 3),
                    round(float(time[first] - max(age[first, column], 0.0)), 3),
                    round(float(time[min(last, len(time) - 1)]), 3),
                    round(float(np.median(probability[rows, column])), 2),
                    two_digits(float(np.median(size[rows, column]))),
                    FAULT_KINDS[int(np.bincount(kind[rows, column]).argmax())],
                )


def two_digits(value: float) -> float:
    """Return a number, rounded to two significant digits."""
    return float(f"{value:.2g}")


def write_verdicts(path: Path, verdicts: Mapping[str, Verdict]) -> None:
    """Write verdicts by the names of their trials, one line an alarm."""
    blocks: list[str] = []
    for name, verdict in verdicts.items():
        lines = ",\n ".join(json.dumps(alarm) for alarm in verdict.alarms)
        alarms = f"[\n {lines}]" if lines else "[]"
        blocks.append(
            f'{json.dumps(name)}: {{"error_deg": {json.dumps(verdict.error_deg)}, "alarms": {alarms}}}'
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("{\n" + ",\n".join(blocks) + "\n}\n", encoding="utf-8")


def read_verdicts(path: Path) -> dict[str, Verdict]:
    """Read what `write_verdicts` wrote; a ValueError names the file."""
    try:
        stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return {
            name: Verdict(tuple(Alarm(*alarm) for alarm in each["alarms"]), each["error_deg"])
            for name, each in stored.items()
        }
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: {error}; expected verdicts as `golden --write` writes them") from None


def differences(stored: Mapping[str, Verdict], said: Mapping[str, Verdict]) -> list[str]:
    """Lines on what is said now (+) and was stored (-) of each trial of ``said``, beyond the tolerances."""
    lines: list[str] = []
    for name, now in said.items():
        then = stored.get(name)
        if then is None:
            lines.append(f"{name}: not stored")
            continue
        left = list(now.alarms)
        for alarm in then.alarms:
            same = next((each for each in left if _is_close(each, alarm)), None)
            if same is None:
                lines.append(f"{name}: - {_shown(alarm)}")
            else:
                left.remove(same)
        lines += (f"{name}: + {_shown(alarm)}" for alarm in left)
        if not _is_same_number(now.error_deg, then.error_deg):
            lines.append(f"{name}: largest attitude error {now.error_deg} deg, stored {then.error_deg} deg")
    return lines


def _is_close(one: Alarm, other: Alarm) -> bool:
    times = zip(one[2:5], other[2:5], strict=True)
    return (
        (one.element, one.state, one.kind) == (other.element, other.state, other.kind)
        and all(abs(a - b) <= LATER for a, b in times)
        and abs(one.probability - other.probability) <= DOUBT
        and _is_same_number(one.size, other.size)
    )


def _is_same_number(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is other
    return abs(one - other) <= ROUNDING * max(abs(one), abs(other))


def _shown(alarm: Alarm) -> str:
    element, state, declared, onset, end, probability, size, kind = alarm
    return f"{element} {state} {declared} to {end} s, onset {onset} s, p {probability}, {kind} {size}"


HEADS = (
    *("set", "kind", "trials", "flown", "false alarms", "in alarm", "per hour"),
    *("faults", "declared", "named", "misnamed", "named after, median", "largest error", "lost"),
)


class Count(NamedTuple):
    """What the verdicts on some trials come to."""

    flown: float  # [s]
    alarms: int  # false ones, by axis: attitude/roll and gyro/x at once are one
    alarmed: float  # time in which a false one lasts [s]
    delays: tuple[float | None, ...]  # of each true fault until it is named [s]; None: never
    declared: int  # true faults that are named, or AMBIGUOUS
    misnamed: int  # true faults during which a healthy element is named
    errors: tuple[float, ...]  # largest attitude error of each flight [deg]


def count(verdicts: Iterable[Verdict]) -> Count:
    """Count what the verdicts on some trials come to."""
    flown, alarms, alarmed, declared, misnamed = 0.0, 0, 0.0, 0, 0
    delays, errors = list[float | None](), list[float]()
    for verdict in verdicts:
        begin, end = verdict.judged
        flown += end - begin
        false = _false_alarms(verdict)
        alarms += sum(len(_merged(spans)) for spans in false.values())
        every = [span for spans in false.values() for span in spans]
        alarmed += sum(min(last, end) - max(first, begin) for first, last in _merged(every))
        delays += (_delay(event, verdict.alarms, STATES[1:2]) for event in verdict.events)
        declared += sum(_delay(event, verdict.alarms, STATES) is not None for event in verdict.events)
        misnamed += sum(_is_misnamed(event, verdict) for event in verdict.events)
        errors += [] if verdict.error_deg is None else [verdict.error_deg]
    return Count(flown, alarms, alarmed, tuple(delays), declared, misnamed, tuple(errors))


Span = tuple[float, float]


def _false_alarms(verdict: Verdict) -> dict[str, list[Span]]:
    """Times of alarms that last where they count, and begin while nothing is faulty or absent, by axis."""
    begin, end = verdict.judged
    excused = (*verdict.events, *verdict.absences)
    spans: dict[str, list[Span]] = {}
    for alarm in verdict.alarms:
        spans.setdefault(_axis(alarm.element), []).append((alarm.declared, alarm.end))
    return {
        axis: [
            span
            for span in _merged(found)
            if span[0] < end and begin < span[1] and not any(e.start <= span[0] < e.stop for e in excused)
        ]
        for axis, found in spans.items()
    }


def _axis(element: str) -> str:
    """Return what roll of the attitude and x of gyro and accelerometer have in common."""
    component, name = element.split("/")
    names = elements_of(component, 0)[0]
    return str(names.index(name)) if name in names else element


def _merged(spans: Iterable[Span]) -> list[Span]:
    merged: list[Span] = []
    for first, last in sorted(spans):
        if merged and first <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(last, merged[-1][1])
        else:
            merged.append((first, last))
    return merged


def _delay(event: Event, alarms: Sequence[Alarm], states: Sequence[str]) -> float | None:
    """Time until the element of a fault is declared, in some state, while the fault lasts [s]."""
    named = [
        alarm.declared - event.start
        for alarm in alarms
        if alarm.element == event.element
        and alarm.state in states
        and event.start <= alarm.declared < event.stop
    ]
    return min(named, default=None)


def _is_misnamed(event: Event, verdict: Verdict) -> bool:
    """Whether an element is declared FAULTY, while a fault lasts, that has none then."""
    return any(
        alarm.state == STATES[1]
        and event.start <= alarm.declared < event.stop
        and not any(e.element == alarm.element and e.start <= alarm.declared < e.stop for e in verdict.events)
        for alarm in verdict.alarms
    )


def count_table(groups: Mapping[tuple[str, str], Sequence[Verdict]]) -> str:
    """Write what the verdicts come to, by set and kind of trial."""
    return markdown(HEADS, (_cells(*key, verdicts) for key, verdicts in groups.items()))


def _cells(half: str, group: str, verdicts: Sequence[Verdict]) -> tuple[str, ...]:
    found = count(verdicts)
    named = [delay for delay in found.delays if delay is not None]
    errors, faults = found.errors, len(found.delays)
    lost = sum(error > np.degrees(LOST) for error in errors)
    return (
        *(half, group, str(len(verdicts)), f"{found.flown / 3600.0:.3f} h"),
        *(str(found.alarms), f"{found.alarmed:.1f} s", write_number(3600.0 * found.alarms / found.flown)),
        *(map(str, (faults, found.declared, len(named), found.misnamed)) if faults else (NOTHING,) * 4),
        write_times((float(np.median(named)),)) if named else NOTHING,
        *((write_degrees((max(errors),)), str(lost)) if errors else (NOTHING,) * 2),
    )
