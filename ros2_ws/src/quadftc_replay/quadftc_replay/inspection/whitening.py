"""Steps of a signal with coloured noise, all at once.

The change of a sensor from sample to sample is modelled as an autoregressive process. So motion, disturbances
and vibration that were there all along become white noise w = A(z) Δy. A step of size f at sample k adds f to
Δy at k alone, hence f a_j to w at k + j. The generalised likelihood ratio of Willsky and Jones (IEEE Trans.
Automatic Control 21(1), 1976) then is a matched filter:

    f_hat(k) = sum_j a_j w(k + j) / sum_j a_j²,    z(k) = f_hat(k) / sigma(k)

sigma is the local scatter of f_hat, by the median of blocks, so that a fault hardly raises it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, ndimage, signal

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

ORDER = 8  # of the autoregression; 16 and 32 gain less than 10 % on flights of a Crazyflie
CLIP = 5.0  # scales; larger changes do not count in the fit
TO_SIGMA = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
BLOCK = 0.25  # s; in which the scatter counts as constant
MIN_BLOCK = 32  # samples
BETTER, BACK = 1.3, 0.5  # 1; how much better two steps explain, and what may remain of them
GAP = 1.7  # sampling periods; a longer step in time is a gap


class Steps(NamedTuple):
    """For each sample of a signal, the step that best explains what follows."""

    size: Floats  # (n,) f_hat; 0 where it cannot be told
    sigma: Floats  # (n,) its local standard deviation
    white: Floats  # (n,) w
    filter: Floats  # (p + 1,) a_j


def runs_of(mask: Mask) -> list[slice]:
    """Return the stretches in which a mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(first), int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]


def scale(values: Floats) -> float:
    """Return the standard deviation by the median absolute value; 0 for none."""
    return TO_SIGMA * float(np.median(np.abs(values))) if len(values) else 0.0


def find_gaps(time: Floats) -> Mask:
    """Whether the step in time before each sample is a gap (n,)."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return np.concatenate([[False], steps > GAP * usual])


def fit_autoregression(changes: Floats) -> Floats:
    """Fit A(z) = 1 + a_1 z^-1 + ..., (ORDER + 1,), to a stationary signal (n,) by Yule and Walker."""
    if len(changes) < 4 * ORDER:
        return np.eye(1, ORDER + 1)[0]
    bound = CLIP * scale(changes - np.median(changes))
    clipped = np.clip(changes, -bound, bound) if bound > 0.0 else changes
    count = len(clipped)
    if not np.any(clipped):
        return np.eye(1, ORDER + 1)[0]
    spectrum = np.abs(np.fft.rfft(clipped, 2 * count)) ** 2
    covariance = np.fft.irfft(spectrum)[: ORDER + 1] / count
    covariance[0] *= 1.0 + 1e-6
    return np.concatenate([[1.0], -linalg.solve_toeplitz(covariance[:-1], covariance[1:])])


def find_steps(time: Floats, values: Floats, fitted: Mask, floor: float) -> Steps:
    """Find steps of a signal (n,); the noise is that of the samples ``fitted``.

    ``floor`` is the least standard deviation. Samples next to a gap or without a value tell nothing.
    """
    changes = np.diff(values, prepend=values[:1])
    dark = find_gaps(time) | ~np.isfinite(changes)
    changes = np.where(dark, 0.0, changes)
    filter_ = fit_autoregression(changes[fitted & ~dark])
    white = signal.lfilter(filter_, [1.0], changes)
    size = np.correlate(np.concatenate([white, np.zeros(ORDER)]), filter_, "valid") / np.sum(filter_**2)
    reach = ORDER + 1
    near = ndimage.binary_dilation(dark, np.ones(2 * reach + 1, np.bool_))
    near[:reach] = near[-reach:] = True
    size = np.where(near, 0.0, size)
    return Steps(size, np.maximum(local_scatter(time, size), floor), white, filter_)


def is_pulse(steps: Steps, row: int, reach: int) -> bool:
    """Whether what looks like a step at a sample goes back, or came from, within ``reach`` samples.

    Two steps, one here and one of the opposite size nearby, then explain w far better than this one alone.
    """
    first, last = max(row - reach, 0), min(row + reach + ORDER + 1, len(steps.white))
    seen = steps.white[first:last]

    def signature(at: int) -> Floats:
        """What a step of size 1 at a sample adds to w."""
        column = np.zeros(len(seen))
        part = steps.filter[: max(len(seen) - (at - first), 0)]
        column[at - first : at - first + len(part)] = part
        return column

    here = signature(row)
    alone = float(here @ seen) ** 2 / float(here @ here)
    for other in range(max(row - reach, 0), min(row + reach + 1, len(steps.white))):
        if other == row:
            continue
        pair = np.column_stack([here, signature(other)])
        sizes = np.linalg.lstsq(pair, seen, rcond=None)[0]
        both = float(seen @ pair @ sizes)
        if both > BETTER * alone and abs(sizes.sum()) < BACK * abs(float(sizes[0])):
            return True
    return False


def local_scatter(time: Floats, values: Floats) -> Floats:
    """Return the standard deviation around each sample (n,), the largest of three blocks."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    length = max(MIN_BLOCK, round(BLOCK / period))
    count = len(values) // length
    if count < 2:
        return np.full(len(values), scale(values))
    blocks = np.abs(values[: count * length]).reshape(count, length)
    scatter = ndimage.maximum_filter1d(TO_SIGMA * np.median(blocks, axis=1), 3)
    return np.interp(np.arange(len(values)), (np.arange(count) + 0.5) * length, scatter)


def peaks(score: Floats, level: float, apart: int) -> list[int]:
    """Return the samples at which a score (n,) is largest within ``apart`` samples, and beyond ``level``."""
    found, _ = signal.find_peaks(np.concatenate([[0.0], score, [0.0]]), height=level, distance=max(apart, 1))
    return [int(row) - 1 for row in found]
