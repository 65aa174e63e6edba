"""Jumps of what two slow signals do not agree on, such as a barometer and the integral of a velocity.

Around each sample a straight line and a step are fitted to the residual, by least squares over `WINDOW` on
both sides:

    d(j) = a + b j + c H(j) + e,    c_hat(k) = sum_j w_j d(k + j)

So what drifts, or grows with the rate of a motion, is no jump. The largest jump is taken out of the residual
before the next one is looked for. Its noise is the scatter of c_hat, by its median, so that a fault hardly
raises it.
"""

from __future__ import annotations

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.steps import Step, join_ends
from quadftc_replay.inspection.whitening import Floats, Mask, find_gaps, scale

WINDOW, FEWEST = 1.0, 4  # s, samples; on each side of a jump
LEVEL = 8.0  # standard deviations, as of steps
MOST = 20  # jumps of one element


def find_jumps(residual: Signal, watched: Mask, smallest: Floats) -> list[Step]:
    """Find the jumps of a residual (n, k), in the order of time, each with its end.

    ``watched`` (n,) says where; ``smallest`` (n,) is the size that healthy sensors reach. NaN are left out.
    """
    found: list[Step] = []
    for axis in range(residual.value.shape[1]):
        rows = np.flatnonzero(np.isfinite(residual.value[:, axis]))
        found += _along(
            axis, residual.time[rows], residual.value[rows, axis].copy(), watched[rows], smallest[rows]
        )
    return sorted(found, key=lambda step: step.onset)


def _along(axis: int, time: Floats, values: Floats, watched: Mask, smallest: Floats) -> list[Step]:
    """Find the jumps of one element (n,)."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else WINDOW
    side = max(FEWEST, round(WINDOW / period))
    if len(time) < 4 * side:
        return []
    weights = _weights(side)
    gaps = np.cumsum(find_gaps(time))
    whole = np.zeros(len(time), np.bool_)  # no gap among the samples of the fit
    whole[side : len(time) - side + 1] = gaps[2 * side - 1 :] == gaps[: len(time) - 2 * side + 1]
    whole &= watched
    found: list[Step] = []
    sigma = 0.0
    for _ in range(MOST):
        size = np.zeros(len(time))
        size[side : len(time) - side + 1] = np.correlate(values, weights, "valid")
        sigma = sigma or max(scale(size[whole]), 1e-12)  # of the noise: once, before anything is taken out
        score = np.where(whole, np.abs(size) / np.maximum(smallest, LEVEL * sigma), 0.0)
        row = int(np.argmax(score))
        if score[row] < 1.0:
            break
        found.append(Step(axis, float(time[row]), None, float(size[row]), sigma, float(score[row])))
        values[row:] -= size[row]
    return join_ends(sorted(found, key=lambda step: step.onset), WINDOW)


def _weights(side: int) -> Floats:
    """What each of the samples around a jump adds to its least-squares estimate (2 side,)."""
    place = np.arange(-side, side, dtype=float)
    design = np.column_stack([np.ones_like(place), place, place >= 0.0])
    return np.linalg.pinv(design)[2]
