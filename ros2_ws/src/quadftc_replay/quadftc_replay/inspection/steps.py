"""Steps of a sensor in flight that no motion explains: offsets that begin or end from sample to sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.whitening import find_steps, is_pulse, peaks

Floats = NDArray[np.float64]

LEVEL = 8.0  # standard deviations; the largest in healthy flights of Crazyflies and PX4 is 4.2
SLOWEST = 80.0  # Hz; below, motion itself looks like steps
PULSE = 0.03  # s; what goes back within it is a pulse
UNKNOWN = 0.5  # s; at the begin of a log, of which nobody knows what was before
APART = 12  # samples; within which there is one step
SAME = 0.5  # 1; an end has the size of its begin to this share
TOGETHER = 0.012  # s; steps of several axes within it have one cause


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
    """What counts as a step of a sensor, in its unit."""

    smallest: float
    floor: float  # standard deviation of its noise, at least


def steps_of(flight: Flight, sensor: Signal, limits: Limits, level: float = LEVEL) -> list[Step]:
    """Find the steps of a sensor (n, 3) in flight, in the order of time; begins and ends alike."""
    time = sensor.time
    if sensor.rate < SLOWEST or len(sensor) < 200:
        return []
    flying = flight.in_flight(time)
    watched = flying & ~flight.near_impact(time) & (time > time[0] + UNKNOWN)
    found: list[Step] = []
    for axis in range(sensor.value.shape[1]):
        steps = find_steps(time, sensor.value[:, axis], flying, limits.floor)
        size, sigma = steps.size, steps.sigma
        score = np.where(watched & (np.abs(size) > limits.smallest), np.abs(size) / sigma, 0.0)
        for k in peaks(score, level, APART):
            pulse = is_pulse(steps, k, APART)
            found.append(
                Step(axis, float(time[k]), None, float(size[k]), float(sigma[k]), float(score[k]), pulse)
            )
    return sorted(found, key=lambda step: step.onset)


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


def step_sizes(flight: Flight, sensor: Signal, limits: Limits, axis: int) -> Floats:
    """Return the step that best explains what follows each sample, on one axis (n,)."""
    flying = flight.in_flight(sensor.time)
    return find_steps(sensor.time, sensor.value[:, axis], flying, limits.floor).size


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
