"""Jumps and drifts of what two slow signals do not agree on, such as a height and the integral of a velocity.

Around each sample a straight line and a shape h are fitted to the residual, by least squares over a window on
both sides; h is a step, or a ramp from there on:

    d(t) = a + b t + c h(t) + e,    c_hat(k) = sum_j w_kj d(t_j)

So what drifts all along, or grows with the rate of a motion, is none. The weights follow the times of the
samples, of which a log may lack some. The largest jump is taken out of the residual before the next one is
looked for, and all of them before drifts are. The noise is the scatter of c_hat in calm, so that a fault
hardly raises it. What healthy sensors jump by does not pass for a drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.steps import Step, join_ends
from quadftc_replay.inspection.whitening import Floats, Mask

JUMP, DRIFT = 1.0, 3.0  # s; on each side of a jump, and of the begin of a drift
FEWEST, ENOUGH = 4, 10  # samples on each side; more are thinned out
SPREAD = 1.5  # 1; times the usual length of a window, which lost samples may add to it
CALM, CALM_SIGMA = 0.3, 0.385  # 1; quantile of |c_hat| that is calm, and what it is of a normal distribution
LEVEL = 8.0  # standard deviations, as of steps
TINY = 1e-9  # 1; of what one sample tells
MOST = 20  # jumps of one element
NOWHERE = np.zeros(0)


class Shape(NamedTuple):
    """What begins at a sample: a step, or a ramp."""

    window: float  # s
    power: int

    def at(self, late: Floats) -> Floats:
        """Return what it adds at times since it began [s]."""
        return np.where(late >= 0.0, np.maximum(late, 0.0) ** self.power, 0.0)


STEP, RAMP = Shape(JUMP, 0), Shape(DRIFT, 1)


def find_jumps(
    residual: Signal, watched: Mask, smallest: Floats, breaks: Floats = NOWHERE
) -> tuple[list[Step], list[Step]]:
    """Find jumps and drifts of a residual (n, k), in the order of time, each with its end.

    ``watched`` (n,) says where; ``smallest`` (n,) is a jump that healthy sensors reach. The size of a drift
    counts per second. NaN are left out, and windows across ``breaks`` [s], where the residual starts anew.
    """
    jumps, drifts = list[Step](), list[Step]()
    for axis in range(residual.value.shape[1]):
        rows = np.flatnonzero(np.isfinite(residual.value[:, axis]))
        rows = rows[:: max(1, int(residual.rate * JUMP / ENOUGH))]
        time, least = residual.time[rows], smallest[rows]
        steps, rest = _begins(STEP, time, residual.value[rows, axis], watched[rows], least, breaks)
        ramps, _ = _begins(RAMP, time, rest, watched[rows], least, breaks)
        jumps += [each._replace(axis=axis) for each in join_ends(steps, JUMP)]
        drifts += [each._replace(axis=axis) for each in join_ends(ramps, DRIFT)]
    return sorted(jumps, key=lambda step: step.onset), sorted(drifts, key=lambda step: step.onset)


def _begins(
    shape: Shape, time: Floats, values: Floats, watched: Mask, smallest: Floats, breaks: Floats
) -> tuple[list[Step], Floats]:
    """Find what begins in one element (n,), in the order of time; return what is left of it, too."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else shape.window
    each_side = max(FEWEST, round(shape.window / period))
    stride = -(-each_side // ENOUGH)
    side = -(-each_side // stride)
    reach = side * stride
    if len(time) < 4 * reach:
        return [], values
    centres = np.arange(reach, len(time) - reach + stride)
    first, last = time[centres - reach], time[centres + reach - stride]
    whole = np.searchsorted(breaks, first, "right") == np.searchsorted(breaks, last, "right")
    centres = centres[watched[centres] & (last - first < SPREAD * 2.0 * reach * period) & whole]
    if not len(centres):
        return [], values
    rows = centres[:, None] + stride * np.arange(-side, side)
    weights = _weights(shape, time[rows] - time[centres, None])
    of_a_jump = np.max(np.abs(np.cumsum(weights, axis=1)), axis=1)  # what a jump of 1 looks like at most
    least = smallest[centres] * of_a_jump
    found: list[Step] = []
    sigma = 0.0
    for _ in range(MOST):
        size = np.sum(weights * values[rows], axis=1)
        sigma = sigma or max(float(np.quantile(np.abs(size), CALM)) / CALM_SIGMA, 1e-9)
        score = np.abs(size) / np.maximum(least, LEVEL * sigma)
        best = int(np.argmax(score))
        if score[best] < 1.0:
            break
        onset, amount = float(time[centres[best]]), float(size[best])
        found.append(Step(0, onset, None, amount, sigma, float(score[best])))
        values = values - amount * shape.at(time - onset)
    return sorted(found, key=lambda step: step.onset), values


def _weights(shape: Shape, late: Floats) -> Floats:
    """What each sample adds to the least-squares estimate of the shape (m, k), at times since it (m, k)."""
    late = late / shape.window
    design = np.stack([np.ones_like(late), late, shape.at(late)], axis=-1)
    across = np.swapaxes(design, 1, 2)
    normal = across @ design + TINY * np.eye(3)  # samples at next to one time tell nothing apart
    return np.asarray(np.linalg.solve(normal, across)[:, 2], np.float64) / shape.window**shape.power
