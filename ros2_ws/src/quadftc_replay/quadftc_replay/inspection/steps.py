"""Steps of a sensor in flight that no motion explains: offsets that begin or end from sample to sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, confidence, make_found
from quadftc_replay.inspection.whitening import Floats, Mask, Steps, find_steps, is_pulse, peaks

LEVEL = 8.0  # standard deviations; the largest in healthy flights of Crazyflies and PX4 is 4.2
SLOWEST = 80.0  # Hz; below, motion itself looks like steps
PULSE = 0.03  # s; what goes back within it is a pulse
UNKNOWN = 0.5  # s; at the begin of a log, of which nobody knows what was before
APART = 12  # samples; within which there is one step
SAME = 0.5  # 1; an end has the size of its begin to this share
SEEN, NEAR = 0.5, 0.02  # 1, s; share of a step that another sensor has to show, and over which


class Step(NamedTuple):
    """An offset of one axis."""

    axis: int
    onset: float  # s
    end: float | None  # s; None: it lasts
    size: float
    sigma: float
    score: float  # standard deviations
    is_pulse: bool = False  # it goes back within a few samples


class Limits(NamedTuple):
    """What counts as a step of a kind of sensor, in its unit."""

    unit: str
    smallest: float
    floor: float  # standard deviation of its noise, at least
    apart: float  # by which two of a kind may differ: ArduPilot's arming checks (5 deg/s, ARMING_ACCTHRESH)


LIMITS = {"gyro": Limits("rad/s", 0.05, 0.003, 0.087), "accelerometer": Limits("m/s^2", 1.5, 0.1, 0.75)}


def steps_of(flight: Flight, sensor: Signal, limits: Limits, level: float = LEVEL) -> list[Step]:
    """Find the steps of a sensor (n, 3) in flight, in the order of time; begins and ends alike."""
    time = sensor.time
    if sensor.rate < SLOWEST or len(sensor) < 200:
        return []
    flying = flight.in_flight(time)
    watched = flight.is_calm(time) & (time > time[0] + UNKNOWN)
    found: list[Step] = []
    for axis in range(sensor.value.shape[1]):
        steps = find_steps(time, sensor.value[:, axis], flying, limits.floor)
        found += steps_beyond(time, steps, axis, watched, limits.smallest, level)
    return sorted(found, key=lambda step: step.onset)


def steps_beyond(
    time: Floats, steps: Steps, axis: int, watched: Mask, smallest: float, level: float
) -> list[Step]:
    """Steps of one axis beyond a size and a level [standard deviations], where it is watched (n,)."""
    score = np.where(watched & (np.abs(steps.size) > smallest), np.abs(steps.size) / steps.sigma, 0.0)
    return [
        Step(
            *(axis, float(time[k]), None, float(steps.size[k]), float(steps.sigma[k]), float(score[k])),
            is_pulse(steps, k, APART),
        )
        for k in peaks(score, level, APART)
    ]


def join_ends(steps: Sequence[Step], pulse: float = PULSE) -> list[Step]:
    """Join each begin on an axis with its end; drop what goes back within ``pulse`` [s]."""
    found: list[Step] = []
    for step in steps:
        fit = [
            k
            for k, each in enumerate(found)
            if each.axis == step.axis
            and each.end is None
            and abs(step.size + each.size) < SAME * abs(each.size)
        ]
        if fit:
            found[fit[-1]] = found[fit[-1]]._replace(end=step.onset)
        else:
            found.append(step)
    return [each for each in found if each.end is None or each.end - each.onset > pulse]


def shows(sensor: Signal, step: Step) -> bool:
    """Whether another sensor of a kind shows the same step."""
    change = change_at(sensor.time, sensor.value[:, step.axis], step.onset, NEAR)
    return change is not None and change * np.sign(step.size) > SEEN * abs(step.size)


def change_at(time: Floats, values: Floats, moment: float, reach: float) -> float | None:
    """Mean after a moment less that before it; None without samples."""
    before = values[slice(*np.searchsorted(time, (moment - reach, moment - 1e-6)))]
    after = values[slice(*np.searchsorted(time, (moment + 1e-6, moment + reach)))]
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    return float(after.mean() - before.mean()) if len(before) and len(after) else None


def step_found(
    flight: Flight, component: str, sensor: Signal, limits: Limits, step: Step, is_sure: bool = True
) -> Found:
    """The finding of a step; not ``is_sure``: other axes jump with it."""
    element, unit = BODY_AXES[step.axis], limits.unit.replace("^2", "²")
    said = [
        f"it jumps by {step.size:+.3g} {unit} from one sample to the next,"
        f" {step.score:.0f} standard deviations of what it does otherwise"
    ]
    if not is_sure:
        said.append("other axes jump with it, as in a collision")
    flying = flight.in_flight(sensor.time)
    sizes = find_steps(sensor.time, sensor.value[:, step.axis], flying, limits.floor).size
    lines = {"step that best explains what follows": sizes}
    return make_found(
        *(component, element, "offset", step.onset),
        end_s=step.end,
        size=step.size,
        sigma=step.sigma,
        unit=limits.unit,
        probability=(1.0 if is_sure else 0.7) * confidence(step.score, LEVEL),
        ambiguous_with=() if is_sure else ("collision",),
        evidence=tuple(said),
        curve=Curve(f"step of {component} {element}", unit, sensor.time, lines),
    )


def begins_within(
    flight: Flight,
    sensor: Signal,
    limits: Limits,
    axis: int,
    size: float,
    span: tuple[float, float],
    sigma: float = np.inf,
) -> float:
    """Return when an offset of a known size begins that is not there before a span and is there after it [s].

    The step counts that makes it most likely; ``sigma`` is the standard deviation [s] of its begin around the
    middle, if more is known than the span. The middle counts where the sensor shows none.
    """
    middle = 0.5 * (span[0] + span[1])
    rows = slice(*np.searchsorted(sensor.time, span))
    steps = find_steps(sensor.time, sensor.value[:, axis], flight.in_flight(sensor.time), limits.floor)
    time, seen = sensor.time[rows], np.minimum(steps.size[rows] * size, size**2)
    evidence = (2.0 * seen - size**2) / steps.sigma[rows] ** 2 - ((time - middle) / sigma) ** 2
    return float(time[int(np.argmax(evidence))]) if np.any(evidence > 0.0) else middle
