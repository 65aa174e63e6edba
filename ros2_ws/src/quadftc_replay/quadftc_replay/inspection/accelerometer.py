"""Tests of an accelerometer: steps in flight, and what it reads at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.attitude import LONG
from quadftc_replay.inspection.flight import Flight, rests_of
from quadftc_replay.inspection.found import BODY_AXES, Found, make_found
from quadftc_replay.inspection.steps import (
    LIMITS,
    SAME,
    Step,
    begins_within,
    join_ends,
    shows,
    step_found,
    steps_of,
)

PULSE = 0.1  # s; what goes back within it is a knock
REST = 0.15  # m/s²; largest scatter at rest
OFFSET = 1.0  # m/s²; of the magnitude at rest


def accelerometer_findings(
    flight: Flight, component: str, sensor: Signal, others: Sequence[Signal]
) -> Iterator[Found]:
    """Test an accelerometer; ``others`` are those beside it."""
    limits = LIMITS["accelerometer"]
    if flight.phases_known:
        steps = steps_of(flight, sensor, limits)
        own = [
            each for each in steps if not each.is_pulse and not any(shows(other, each) for other in others)
        ]
        for step in (each for each in join_ends(own, PULSE) if _stays(flight, sensor, each)):
            yield step_found(flight, component, sensor, limits, step)
    yield from _rest_findings(flight, component, sensor)


def _stays(flight: Flight, sensor: Signal, step: Step) -> bool:
    """Whether most of a step stays: a load that falls off is a step, too, until the rotors give less."""
    until = min(flight.until, step.onset + LONG, np.inf if step.end is None else step.end)
    edges = np.searchsorted(sensor.time, (step.onset - LONG, step.onset, until))
    before, after = (sensor.value[slice(*each), step.axis] for each in (edges[:2], edges[1:]))
    change = float(np.nanmedian(after) - np.nanmedian(before)) if len(before) and len(after) else 0.0
    return change * np.sign(step.size) > SAME * abs(step.size)


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
        onset = begins_within(flight, sensor, LIMITS["accelerometer"], axis, size, (begin, end))
        said.append(f"at rest until {begin:.2f} s it was right, from {end:.2f} s on it is not")
    yield make_found(
        *(component, element, "offset", onset),
        size=size,
        sigma=float(sizes[off].std()),
        unit="m/s^2",
        evidence=tuple(said),
        is_direct=True,
    )
