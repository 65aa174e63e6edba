r"""The fault of each faulty axis, by an alpha-beta filter that restarts at every jump, and its end.

With f the fault, v its slope, r the residual (measured minus predicted angle) and n samples since a jump:

    f^ = f + v dt,   e = r - f^,   f <- f^ + max(alpha, 1 / (n + 1)) e,   v <- v + (beta / dt) e

White noise of r comes through with the share (2 alpha² + 2 beta - 3 alpha beta) / (alpha (4 - 2 alpha -
beta)) of its variance, beta = alpha² / (2 - alpha) (Blair 1993).

A faulty axis is trusted again once its fault agrees with zero, stands still, and has done so long enough: for
longer if it never visibly moved, as it may be a slow ramp. A fault that stands still for ``patience`` seconds
is taken for an error of the observer: otherwise a wrong start or a false alarm would never end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.supervision.residual_tests import ResidualVariances
from quadftc_model.arrays import AnyArray, Column, Float, Mask, Vector, cache_numbers, namespace

AVERAGES = np.array([0.15, 0.6])  # s; two averages of a fault, whose difference shows that it moves
JUMPS = 25.0  # 1; squared standard deviations beyond which a fault jumps
AGREES, STANDS = 16.0, 9.0  # 1; squared standard deviations
GRADUAL = 6.0  # 1; how many times as long a fault that never visibly moved must look healthy
ALMOST_STILL = 0.0087  # rad, 0.5 deg; an error of the observer moves a little, as the vehicle does


class Track(NamedTuple):
    """The fault of each axis while it is faulty, all zero otherwise."""

    fault: Vector  # [rad]
    slope: Vector  # [rad/s]
    samples: Vector  # since the last jump
    moved: Vector  # 1: it has jumped, or visibly moved, since it was found
    means: Float[AnyArray, "*batch 3 2"]  # two averages of it [rad]
    age: Vector  # time since the onset [s]
    calm: Vector  # how long the axis has looked healthy again [s]


class TrackerGains(NamedTuple):
    """Gains of one step."""

    mean: NDArray[np.float64]  # (2,) of a sample in the two averages
    alpha: float  # of a sample in the fault
    beta_dt: float  # [1/s] in its slope: beta / dt
    noise: float  # share of white noise in the variance of the fault
    settled: float  # samples after a jump before the slope moves


@cache_numbers
def tracker_gains(dt: float, tracking: float) -> TrackerGains:
    """Gains for a step ``dt`` and an averaging time [s]."""
    starts = isinstance(dt, float) and dt == 0.0
    alpha = 1.4 * dt / (tracking + dt)
    beta = alpha**2 / (2.0 - alpha)
    noise = (2.0 * alpha**2 + 2.0 * beta - 3.0 * alpha * beta) / (4.0 - 2.0 * alpha - beta)
    return TrackerGains(
        mean=dt / (AVERAGES + dt),
        alpha=alpha,
        beta_dt=0.0 if starts else beta / dt,
        noise=1.0 if starts else noise / alpha,
        settled=math.inf if starts else 1.4 / alpha,
    )


def start_track(like: Vector) -> Track:
    """Return a track without faults."""
    zeros = namespace(like).zeros_like(like)
    return Track(zeros, zeros, zeros, zeros, namespace(like).zeros((*like.shape, 2)), zeros, zeros)


def track_fault(
    track: Track,
    residual: Vector,
    variances: ResidualVariances,
    alarm: Mask,
    suspicion: Vector,
    valid: Mask,
    gains: TrackerGains,
    dt: float,
) -> Track:
    """Follow the residual [rad] of the faulty axes, as far as they are measured in this sample (``valid``).

    The track starts where an axis is declared faulty (``alarm``), with the fault as old as the suspicion [s].
    """
    xp = namespace(residual)
    expected = track.fault + track.slope * dt
    error = residual - expected
    jump = alarm | (error**2 > JUMPS * (variances.noise + variances.slow))
    # right after a jump the fault is the mean of the samples since, and the slope waits
    samples = (track.samples + 1.0) * ~jump
    alpha = xp.maximum(gains.alpha, 1.0 / (samples + 1.0)) * valid
    means = track.means + valid[..., None] * gains.mean * (residual[..., None] - track.means)
    return track._replace(
        fault=expected + alpha * error,
        slope=(track.slope + gains.beta_dt * valid * error) * (samples > gains.settled),
        samples=samples,
        moved=xp.maximum(track.moved, 1.0 * jump) * ~alarm,
        means=xp.where(jump[..., None], residual[..., None], means),
        age=xp.where(alarm, suspicion, track.age + dt),
    )


def clear_healthy(track: Track, faulty: Mask) -> Track:
    """Set the track of all axes that are not faulty to zero."""
    return Track(*(part * (faulty if part.ndim == faulty.ndim else faulty[..., None]) for part in track))


def track_variance(track: Track, variances: ResidualVariances, gains: TrackerGains) -> Vector:
    """Variance [rad²] that the sensor's own noise gives the tracked fault."""
    share = namespace(track.samples).maximum(gains.noise, 1.0 / (track.samples + 1.0))
    return (variances.noise + variances.slow) * share


class Recovery(NamedTuple):
    """What is judged of each axis."""

    track: Track
    trusted: Mask  # the axis is trusted again
    outlasted: Mask  # trusted although the fault is there: it outlasted our patience


def judge_recovery(
    track: Track,
    faulty: Mask,
    predicted: Vector,
    spread: Vector,
    bias_variance: Column,
    recovery: float,
    patience: float,
    dt: float,
) -> Recovery:
    """Judge which faulty axes are trusted again.

    They must look healthy for ``recovery`` [s], or have stood still at the age of ``patience`` [s].
    ``predicted`` [rad²] is the variance of the dead-reckoned angle, ``spread`` [rad²] is `healthy_spread`,
    ``bias_variance`` [rad²/s²] that of the gyro bias, at which the angle drifts, and ``dt`` [s] the step.
    """
    xp = namespace(predicted)
    # Does it stand still? The two averages of a fault that moves differ.
    short, long = track.means[..., 0], track.means[..., 1]
    motion = short - long
    motion_variance = spread + bias_variance * (AVERAGES[1] - AVERAGES[0]) ** 2
    still = motion**2 < STANDS * motion_variance
    moved = xp.maximum(track.moved, 1.0 * (motion**2 > JUMPS * motion_variance))
    # Does it agree with zero, as far as dead reckoning knows?
    agrees = short**2 < AGREES * (predicted + spread)
    # Soon after a jump both averages are near their first value, and say nothing.
    known = (track.age > AVERAGES[1]) & (track.samples * dt > AVERAGES[1])
    outlasted = (track.age > patience) & (xp.abs(motion) < ALMOST_STILL)
    calm = (track.calm + dt) * (faulty & known & ((still & agrees) | outlasted))
    trusted = calm > recovery * xp.where(outlasted | (moved > 0.0), 1.0, GRADUAL)
    return Recovery(track._replace(calm=calm, moved=moved), trusted, trusted & ~agrees)
