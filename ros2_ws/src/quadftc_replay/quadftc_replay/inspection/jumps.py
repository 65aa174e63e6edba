"""Jumps and drifts of what two slow signals do not agree on, such as a height and the integral of a velocity.

Around each sample a straight line and a shape h are fitted to the residual, by least squares over a window on
both sides; h is a step, or a ramp from there on:

    d(j) = a + b j + c h(j) + e,    c_hat(k) = sum_j w_j d(k + j)

So what drifts all along, or grows with the rate of a motion, is none. The largest jump is taken out of the
residual before the next one is looked for. The noise is the scatter of c_hat, by its median, so that a fault
hardly raises it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.steps import Step, join_ends
from quadftc_replay.inspection.whitening import Floats, Mask, find_gaps, scale

JUMP, DRIFT = 1.0, 5.0  # s; on each side of a jump, and of the begin of a drift
FEWEST = 4  # samples, on each side
LEVEL = 8.0  # standard deviations, as of steps
MOST = 20  # jumps of one element


class Shape(NamedTuple):
    """What begins at a sample: a step, or a ramp."""

    window: float  # s
    power: int

    def at(self, late: Floats) -> Floats:
        """Return what it adds at times since it began (n,) [s]."""
        return np.where(late >= 0.0, np.maximum(late, 0.0) ** self.power, 0.0)


STEP, RAMP = Shape(JUMP, 0), Shape(DRIFT, 1)


def find_jumps(residual: Signal, watched: Mask, smallest: Floats) -> tuple[list[Step], list[Step]]:
    """Find jumps and drifts of a residual (n, k), in the order of time, each with its end.

    ``watched`` (n,) says where; ``smallest`` (n,) is a jump that healthy sensors reach, and that over `DRIFT`
    a drift that they reach. The size of a drift counts per second. NaN are left out.
    """
    jumps, drifts = list[Step](), list[Step]()
    for axis in range(residual.value.shape[1]):
        rows = np.flatnonzero(np.isfinite(residual.value[:, axis]))
        time, values = residual.time[rows], residual.value[rows, axis]
        steps, rest = _along(axis, STEP, time, values, watched[rows], smallest[rows])
        jumps += steps
        drifts += _along(axis, RAMP, time, rest, watched[rows], smallest[rows] / DRIFT)[0]
    return sorted(jumps, key=lambda step: step.onset), sorted(drifts, key=lambda step: step.onset)


def _along(
    axis: int, shape: Shape, time: Floats, values: Floats, watched: Mask, smallest: Floats
) -> tuple[list[Step], Floats]:
    """Find what begins in one element (n,); return what is left of it, too."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else shape.window
    side = max(FEWEST, round(shape.window / period))
    if len(time) < 4 * side:
        return [], values
    place: Floats = period * np.arange(-side, side, dtype=np.float64)
    weights = np.linalg.pinv(np.column_stack([np.ones_like(place), place, shape.at(place)]))[2]
    gaps = np.cumsum(find_gaps(time))
    inside = slice(side, len(time) - side + 1)
    whole = np.zeros(len(time), np.bool_)  # no gap among the samples of the fit
    whole[inside] = gaps[2 * side - 1 :] == gaps[: len(time) - 2 * side + 1]
    whole &= watched
    found: list[Step] = []
    sigma = 0.0
    for _ in range(MOST):
        size = np.zeros(len(time))
        size[inside] = np.correlate(values, weights, "valid")
        sigma = sigma or max(scale(size[whole]), 1e-12)  # before anything is taken out
        score = np.where(whole, np.abs(size) / np.maximum(smallest, LEVEL * sigma), 0.0)
        row = int(np.argmax(score))
        if score[row] < 1.0:
            break
        found.append(Step(axis, float(time[row]), None, float(size[row]), sigma, float(score[row])))
        values = values - size[row] * shape.at(time - time[row])
    return join_ends(sorted(found, key=lambda step: step.onset), shape.window), values
