"""One flight of the study through its observers: what is kept of each is a record, ready for JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics import diagnosis_metrics
from quadftc_flight.diagnosis_metrics.columns import Columns
from quadftc_flight.diagnosis_metrics.roc import estimate_over_std_dev, estimate_size
from quadftc_flight.diagnosis_metrics.verdicts import has_size, truth
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight
from quadftc_model.samples import AXES
from quadftc_replay.diagnose import diagnose, flight_of
from quadftc_replay.imu_recording import Recording
from quadftc_replay.overlay import faults_from, injector_of, replay_events
from quadftc_replay.plan import choose_observer
from quadftc_tools.diagnosis_study.flights import DrawnFault, FlightPlan, prepare
from quadftc_tools.diagnosis_study.settings import DURATION, WINDOWS, Variant

Floats = NDArray[np.float64]
Record = dict[str, Any]

AGES = (0.1, 0.2, 0.5, 1.0, 2.0, 3.5, 5.0, 7.5, 10.0, 12.5, 15.0, 17.5, 20.0)  # s since the onset
WITHIN = 5.0  # s; a fault that is found later does not count in the ROC
DIGITS = 6  # significant, of what is kept sample by sample

SIZES = np.radians(np.geomspace(0.02, 50.0, 86))  # rad
RATIOS = np.geomspace(0.5, 500.0, 76)  # 1
SCORES: dict[str, tuple[Callable[[Flight], Floats], Floats]] = {
    "sliding_mode": (estimate_size, SIZES),
    "edwards_spurgeon": (estimate_size, SIZES),
    "augmented_kalman": (estimate_over_std_dev, RATIOS),
}  # observer whose estimate is alive without a fault -> what is held against a level, and the levels


class Task(NamedTuple):
    """A flight, and the observers that it is still to be flown with."""

    plan: FlightPlan
    variants: tuple[Variant, ...]
    seed: int
    duration: float = DURATION  # s, of a simulated flight
    windows: tuple[tuple[float, float], ...] = WINDOWS  # s, of its faults


def fly(task: Task) -> list[Record]:
    """Fly a flight with each of its observers.

    Raises
    ------
    ValueError
        If the bag cannot be used, or a parameter of an observer is wrong.
    """
    recording, drawn = prepare(task.plan, task.seed, task.duration, task.windows)
    return [_record(task, variant, recording, drawn) for variant in task.variants]


def _record(
    task: Task, variant: Variant, recording: Recording, drawn: tuple[DrawnFault, ...]
) -> dict[str, Any]:
    faults = faults_from((), [fault.spec for fault in drawn])
    law = choose_observer(recording, variant.observer, settings=variant.settings).law
    flight = flight_of(recording, diagnose(recording, law, injector_of(faults, task.seed)))
    events = replay_events(recording, faults)
    return {
        "setting": task.plan.setting.name,
        "variant": variant.name,
        "flight": task.plan.name,
        "diagnosis": diagnosis_metrics(flight, events),
        "faults": [{**fault._asdict(), **profile(flight, fault)} for fault in drawn],
        "score": score_counts(flight, events, *SCORES[variant.name]) if variant.name in SCORES else None,
    }


def profile(flight: Flight, fault: DrawnFault) -> dict[str, list[float | None]]:
    """Error and reported standard deviation [deg] at ``AGES``; None while the axis is not declared faulty."""
    columns, axis = Columns(flight), AXES.index(fault.axis)
    rows = columns.rows(fault.start, fault.stop)
    if rows.stop == rows.start:
        return {"errors_deg": [None] * len(AGES), "std_devs_deg": [None] * len(AGES)}
    at = columns.time.searchsorted(fault.start + np.asarray(AGES) - 1e-9)
    at = np.minimum(at, rows.stop - 1)
    declared = columns.declared[at, axis]
    std_dev = np.degrees(flight.fault_std_dev[at, axis])
    return {
        "errors_deg": _kept(columns.error[at, axis], declared),
        "std_devs_deg": _kept(std_dev, declared & (std_dev > 0.0)),
    }


def score_counts(
    flight: Flight,
    events: Sequence[FaultEvent],
    score: Callable[[Flight], Floats],
    levels: Floats,
    within: float = WITHIN,
) -> dict[str, Any]:
    """Count what each level would say, of those of `detection_scores`; the counts of several flights add up.

    Returns
    -------
    dict
        ``levels``; ``alarms``: healthy samples at or above each, of ``healthy``; ``found``: faults at or
        above each within ``within`` [s] of the onset, of ``faults``.
    """
    columns, scores = Columns(flight), score(flight)
    known = np.isfinite(scores)
    healthy = np.sort(scores[truth(columns, events, [True] * len(events)).healthy & known])
    highest: list[float] = []
    for event in (event for event in events if has_size(columns, event)):
        rows = columns.rows(event.start, min(event.start + within, event.stop))
        values = scores[rows, AXES.index(event.axis)]
        if np.isfinite(values).any():
            highest.append(float(np.nanmax(values)))
    top = np.sort(np.asarray(highest, np.float64))
    return {
        "levels": [_short(level) for level in levels.tolist()],
        "alarms": (len(healthy) - np.searchsorted(healthy, levels, side="left")).tolist(),
        "healthy": len(healthy),
        "found": (len(top) - np.searchsorted(top, levels, side="left")).tolist(),
        "faults": len(top),
    }


def _kept(values: Floats, there: NDArray[np.bool_]) -> list[float | None]:
    good = there & np.isfinite(values)
    return [
        _short(value) if known else None for value, known in zip(values.tolist(), good.tolist(), strict=True)
    ]


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
