"""Sensors of one kind against each other, element by element.

Two IMUs on one vehicle turn alike and, nearly, feel the same force. Their difference needs no model of
motion. Where its mean over `WINDOW` leaves what autopilots tolerate, one of them is wrong. Of three it is the
one that differs from both others. Of two a witness has to say which:

- the sensor that jumps while the other goes on, when the difference begins;
- gyros: the attitude's rate over the whole stretch, as every estimator finds its way back to the true one;
- accelerometers: the velocity that satellites measure (`path`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.attitude import Creep, Owner, stretches
from quadftc_replay.inspection.compass import robust_fit
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.steps import LIMITS
from quadftc_replay.inspection.whitening import GAP, TO_SIGMA, Floats, Mask

WINDOW = 0.5  # s
FEWEST = 5  # samples of it
SCALE = 0.05  # 1; of what they measure, by which scale and alignment may differ
LEVEL = 6.0  # standard deviations of the mean
CLEAR = 0.3  # 1; by how much of the difference one has to be worse than the other


class Parting(NamedTuple):
    """A stretch in which two sensors differ on one axis."""

    axis: int
    onset: float  # s
    end: float | None  # s; None: to the end
    size: float  # first less second
    sigma: float
    score: float  # 1: just enough
    names: tuple[str, str]


def differ(first: Signal, second: Signal) -> tuple[Signal, Signal, Signal]:
    """Both sensors and their difference, at the times of the slower one; gaps of the other are left out."""
    slow, fast = (first, second) if first.rate <= second.rate else (second, first)
    period = 1.0 / max(fast.rate, 1e-9)
    after = np.clip(np.searchsorted(fast.time, slow.time), 1, len(fast) - 1)
    near = (fast.time[after] - fast.time[after - 1] < GAP * period) & (slow.time >= fast.time[0])
    time = slow.time[near & (slow.time <= fast.time[-1])]
    a, b = (Signal(time, each.at(time)) for each in (first, second))
    return a, b, Signal(time, a.value - b.value)


def partings(
    flight: Flight, kind: str, sensors: Mapping[str, Signal], ignored: Sequence[tuple[str, float, float]]
) -> Iterator[Parting]:
    """Find where two sensors differ; ``ignored`` (name, start, end) are stretches known to be wrong."""
    names = [name for name, each in sensors.items() if len(each) > 2 * FEWEST]
    for number, name in enumerate(names):
        for other in names[number + 1 :]:
            a, b, difference = differ(sensors[name], sensors[other])
            if len(difference) < 4 * FEWEST:
                continue
            if kind == "accelerometer":
                difference = _without_lever(flight, difference)
            watched = ~flight.near_impact(difference.time) & (difference.time < flight.until)
            for which, start, end in ignored:
                if which in (name, other):
                    watched &= (difference.time < start - WINDOW) | (difference.time > end + WINDOW)
            level = np.maximum(abs(a.value), abs(b.value))
            for axis in range(3):
                yield from _along(kind, (name, other), axis, difference, level, watched)


def _without_lever(flight: Flight, difference: Signal) -> Signal:
    """Take out what two accelerometers differ by as they are not at one place: w x (w x d) + dw/dt x d."""
    if flight.gyro is None:
        return difference
    time, value = difference
    rates = np.nan_to_num(flight.gyro[1].at(time))
    moves = np.gradient(rates, time, axis=0), rates
    faster, across = (np.cross(each[:, None], np.eye(3)).swapaxes(1, 2) for each in moves)  # matrices of w x
    turning = faster + across @ across
    constant = np.broadcast_to(np.eye(3), turning.shape)
    found, _ = robust_fit(np.concatenate([turning, constant], axis=2).reshape(-1, 6), value.ravel())
    return Signal(time, value - turning @ found[:3])


def _along(
    kind: str, names: tuple[str, str], axis: int, difference: Signal, level: Floats, watched: Mask
) -> Iterator[Parting]:
    time, values = difference.time, difference.value[:, axis]
    count = max(FEWEST, round(WINDOW * difference.rate))
    rows = np.flatnonzero(watched & np.isfinite(values))
    if len(rows) < 2 * count:
        return
    mean = _means(values[rows], count)
    noise = TO_SIGMA * float(np.median(np.abs(np.diff(values[rows])))) / np.sqrt(2.0 * count)
    usual = _means(level[rows].max(axis=1), count)
    score = np.abs(mean) / (np.maximum(LIMITS[kind].apart, LEVEL * noise) + SCALE * usual)
    for run, _ in stretches(mean, score, 0):
        if run.stop - run.start < count:
            continue
        size = float(np.median(values[rows[run]]))
        first = _border(values[rows], run.start, count, 0.0, size)
        last = _border(values[rows], run.stop, count, size, 0.0)
        if last <= first:
            continue
        lasts = last >= len(rows) - count or rows[last - 1] >= len(time) - 1
        inside = values[rows[first:last]]
        scatter = float(np.std(inside)) / np.sqrt(max(len(inside) / count, 1.0))
        yield Parting(
            axis=axis,
            onset=float(time[rows[first]]),
            end=None if lasts else float(time[rows[last - 1]]),
            size=float(np.mean(inside)),
            sigma=max(scatter, noise),
            score=float(score[run].max()),
            names=names,
        )


def _means(values: Floats, count: int) -> Floats:
    """Means over ``count`` samples around each (n,)."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    rows = np.arange(len(values))
    first, last = np.maximum(rows - count // 2, 0), np.minimum(rows + (count + 1) // 2, len(values))
    return (total[last] - total[first]) / (last - first)


def _border(values: Floats, row: int, count: int, before: float, after: float) -> int:
    """Return the sample near a row from which a signal is nearer to one level than to another."""
    first, last = max(row - count, 0), min(row + count, len(values))
    left = np.concatenate([[0.0], np.cumsum((values[first:last] - before) ** 2)])
    right = np.concatenate([[0.0], np.cumsum((values[first:last] - after) ** 2)])
    return first + int(np.argmin(left + right[-1] - right))


def jumps_more(a: Signal, b: Signal, parting: Parting) -> float:
    """By how much the first sensor jumps more than the second when they part (-1 to 1)."""
    row = int(np.searchsorted(a.time, parting.onset))
    if row < 3 or row + 1 >= len(a):
        return 0.0

    def jump(signal: Signal) -> float:
        """What the sample after differs from a straight line through those before."""
        before = signal.value[row - 3 : row, parting.axis]
        trend = (before[-1] - before[0]) / 2.0
        return abs(float(signal.value[min(row, len(signal) - 1), parting.axis] - before[-1] - trend))

    return float(np.clip((jump(a) - jump(b)) / abs(parting.size), -1.0, 1.0))


def owner_by_other(creep: Creep, gyros: Mapping[str, Signal], is_own: bool) -> Owner | None:
    """Say whose creep it is by another gyro than the first: gyro or attitude; None: it cannot tell.

    ``is_own``: the attitude is computed from the gyro. It then knows more than two gyros that err alike.
    """
    main, *others = gyros.values()
    for other in others:
        difference = differ(main, other)[2]
        rows = slice(*np.searchsorted(difference.time, (creep.span.start, creep.span.end)))
        if rows.start == rows.stop:  # the other has no sample then
            continue
        share = float(np.mean(difference.value[rows, creep.axis])) / creep.size
        if abs(share - 1.0) < CLEAR or (abs(share) < CLEAR and not is_own):
            return Owner("gyro" if share > 0.5 else "attitude", "another gyro")
    return None
