"""Tests of an accelerometer: steps in flight, and what it reads at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Found, confidence, curve_around, make_finding
from quadftc_replay.inspection.gyro import BODY_AXES, change_at
from quadftc_replay.inspection.rests import rests_of
from quadftc_replay.inspection.steps import (
    LEVEL,
    Limits,
    Step,
    begins_within,
    join_ends,
    step_sizes,
    steps_of,
)

LIMITS = Limits(smallest=1.5, floor=0.1)  # m/s²
PULSE = 0.1  # s; what goes back within it is a knock
SEEN = 0.5  # 1; share of a step that another accelerometer has to show
NEAR = 0.02  # s; over which another accelerometer is asked before and after a step
REST = 0.15  # m/s²; largest scatter at rest
OFFSET = 1.0  # m/s²; of the magnitude at rest
AROUND = 0.5  # s


def accelerometer_findings(
    flight: Flight, component: str, sensor: Signal, others: Sequence[Signal]
) -> Iterator[Found]:
    """Test an accelerometer; ``others`` are those beside it."""
    if flight.phases_known:
        yield from _step_findings(flight, component, sensor, others)
    yield from _rest_findings(flight, component, sensor)


def _step_findings(
    flight: Flight, component: str, sensor: Signal, others: Sequence[Signal]
) -> Iterator[Found]:
    steps = [
        step
        for step in steps_of(flight, sensor, LIMITS)
        if not step.is_pulse and not any(_shows(each, step) for each in others)
    ]
    for step in join_ends(steps, PULSE):
        said = (
            f"it jumps by {step.size:+.3g} m/s² from one sample to the next,"
            f" {step.score:.0f} standard deviations of what it does otherwise"
        )
        element = BODY_AXES[step.axis]
        finding = make_finding(
            *(component, element, "offset", step.onset),
            end_s=step.end,
            size=step.size,
            sigma=step.sigma,
            unit="m/s^2",
            probability=confidence(step.score, LEVEL),
            evidence=(said,),
        )
        span = (step.onset - AROUND, (step.end or step.onset) + AROUND)
        lines = {"step that best explains what follows": step_sizes(flight, sensor, LIMITS, step.axis)}
        yield Found(finding, curve_around(f"step of {component} {element}", "m/s²", sensor.time, lines, span))


def _shows(sensor: Signal, step: Step) -> bool:
    """Whether another accelerometer shows the same step."""
    change = change_at(sensor.time, sensor.value[:, step.axis], step.onset, NEAR)
    return change is not None and change * np.sign(step.size) > SEEN * abs(step.size)


def _rest_findings(flight: Flight, component: str, sensor: Signal) -> Iterator[Found]:
    """Say where it does not read gravity while the vehicle stands still."""
    rests = rests_of(flight, sensor, REST)
    if not rests:
        return
    means = np.array([each.mean for each in rests])
    sizes = np.linalg.norm(means, axis=1) - STANDARD_GRAVITY
    off = np.abs(sizes) > OFFSET
    if not off.any():
        return
    first = int(np.argmax(off))
    size, element, onset = float(np.median(sizes[off])), "", rests[first].start
    said = [f"it reads {size + STANDARD_GRAVITY:.2f} m/s² at rest, where gravity is 9.81 m/s²"]
    if first > 0:  # it was right before
        change = means[off].mean(axis=0) - means[first - 1]
        axis = int(np.argmax(np.abs(change)))
        element, size = BODY_AXES[axis], float(change[axis])
        begin, end = rests[first - 1].end, rests[first].start
        onset = begins_within(flight, sensor, LIMITS, axis, size, (begin, end))
        said.append(f"at rest until {begin:.2f} s it was right, from {end:.2f} s on it is not")
    finding = make_finding(
        *(component, element, "offset", onset),
        size=size,
        sigma=float(sizes[off].std()),
        unit="m/s^2",
        evidence=tuple(said),
    )
    yield Found(finding, None, True)
