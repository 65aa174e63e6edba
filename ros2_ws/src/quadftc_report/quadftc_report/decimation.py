"""Which samples of a series to draw: few enough for a browser, and every visible feature stays.

1. The ends, and both edges of every gap (NaN). Of a few hundred stretches of time each, the smallest and the
   largest sample (MinMax, by tsdownsample).
2. Then, repeatedly, the sample farthest from the line drawn so far, between any two neighbours. This ends
   when the line is nowhere off by more than ``TOLERANCE`` of the range, or ``LIMIT`` samples are drawn.

Metrics are never computed from decimated samples.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import tsdownsample
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

LIMIT = 1600  # samples of a trace that are drawn
STRETCHES = 300  # of time, each with its extremes
TOLERANCE = 1e-3  # of the range; a fifth of a pixel in a panel of 200


def choose_samples(t: Floats, *series: Floats, limit: int = LIMIT) -> Indices:
    """Return rising indices (m,) of the samples that are drawn of one or more series (n,), one for each gap.

    A gap is where any of the series is NaN. Ends, extremes and gaps are kept even if they are more than
    ``limit`` samples.
    """
    if len(t) <= limit:
        return np.arange(len(t))
    columns = np.stack(series, axis=1)
    known = np.flatnonzero(np.all(np.isfinite(columns), axis=1))
    if len(known) == 0:
        return known
    gap = np.flatnonzero(np.diff(known) > 1)  # each lies behind known[gap]
    values = columns[known]
    start = np.concatenate([[0, len(known) - 1], gap, gap + 1, *map(_extremes, values.T)])
    chosen = _refine(t[known], values, np.unique(start).astype(np.intp), limit - len(gap))
    return np.sort(np.concatenate([known[chosen], known[gap] + 1]))


def _extremes(values: Floats) -> Indices:
    """The smallest and the largest sample of each stretch."""
    count = 2 * STRETCHES
    if len(values) <= count:
        return np.arange(len(values))
    downsampler = cast("Any", tsdownsample).MinMaxDownsampler()
    return np.asarray(downsampler.downsample(np.ascontiguousarray(values), n_out=count), np.intp)


def _refine(times: Floats, values: Floats, chosen: Indices, limit: int) -> Indices:
    """Add the samples farthest from the line through those chosen, until it is good or long enough."""
    span = np.ptp(values, axis=0)
    scaled = values / np.where(span > 0.0, span, 1.0)
    while len(chosen) < limit:
        lines: list[Floats] = [np.interp(times, times[chosen], column[chosen]) for column in scaled.T]
        error = np.max(np.abs(scaled - np.stack(lines, axis=1)), axis=1)[: chosen[-1]]
        # The first sample with the largest error between each two neighbours that were chosen
        which = np.repeat(np.arange(len(chosen) - 1), np.diff(chosen))
        hits = np.flatnonzero(error == np.maximum.reduceat(error, chosen[:-1])[which])
        worst = hits[np.unique(which[hits], return_index=True)[1]]
        worst = worst[error[worst] > TOLERANCE]
        if len(worst) == 0:
            break
        largest_first = worst[np.argsort(-error[worst], kind="stable")]
        chosen = np.union1d(chosen, largest_first[: limit - len(chosen)])
    return chosen
