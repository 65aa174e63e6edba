r"""The fault of each faulty axis, by an alpha-beta filter that restarts at every jump, and its end.

With f the fault, v its slope, r the residual (measured minus predicted angle) and n samples since a jump:

    f^ = f + v dt,   e = r - f^,   f <- f^ + max(alpha, 1 / (n + 1)) e,   v <- v + (beta / dt) e

with beta = alpha² / (2 - alpha).

A faulty axis is trusted again once its fault agrees with zero, stands still, and has done so long enough:
the shorter the fault, the sooner. Zero alone is not enough: the uncertainty of dead reckoning grows, and in
the end every fault agrees with it. So a fault that was seen to leave zero must be seen to come back: by a
jump to less than half of its peak, or by more than dead reckoning can err. Every fault must be down to half
of its peak, in standard deviations. One that stands still for ``patience`` seconds is taken for an error of
the observer: otherwise a wrong start or a false alarm would never end. Samples without a measurement speak
neither for an axis nor against it. Close to a pole, where dead reckoning errs more, a fault must be seen to
come back the better.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.supervision.sensor_noise import MIDDLE, SAMPLE, SHORT, Statistics
from quadftc_model.arrays import (
    AnyArray,
    Array,
    Column,
    Float,
    Mask,
    Scalar,
    Vector,
    clip,
    column,
    larger,
    namespace,
    smaller,
    sqrt,
    where,
)

AVERAGES = np.array([0.15, 0.6])  # s; two averages of a fault, whose difference shows that it moves
SLOWER = np.array([0.0, 0.5])  # 1; share by which their gains are less where the sensor errs slowly
JUMPS = 25.0  # 1; squared standard deviations beyond which a fault jumps
AGREES, STANDS = 8.0, 9.0  # 1; squared standard deviations
LEAPT = 25.0  # 1; the same of a fault that has jumped back: jumps to anywhere else are rare
CLOSE = 6.0  # 1; the same of a fault that was never seen to move: it may be a slow ramp
RETURNED, BACK = 0.25, 0.5  # 1; shares of the peak, in variances and in rad
CERTAIN = 9.0  # 1; squared standard deviations of dead reckoning by which a fault has come back for certain
SEEN = 0.3  # s; so long after a jump or a visible motion it is judged whether the fault has left zero
QUICK, SOONEST = 0.3, 0.15  # 1, s; share of a fault's age for which its axis must look healthy, and the least
LONG_AGO = 1e3  # s
ALMOST_STILL = 0.0087  # rad, 0.5 deg; an error of the observer moves a little, as the vehicle does


class Track(NamedTuple):
    """The fault of each axis while it is faulty, all zero otherwise."""

    fault: Vector  # [rad]
    slope: Vector  # [rad/s]
    samples: Vector  # since the last jump
    still: Vector  # time since it was last seen to jump or to move [s]
    peak: Vector  # largest squared deviation from zero, in variances
    top: Vector  # the same in rad²
    away: Vector  # 1: it was seen to leave zero, and not yet to come back; -1: it jumped back
    means: Float[AnyArray, "*batch 3 2"]  # two averages of it [rad]
    age: Vector  # time since the onset [s]
    calm: Vector  # how long the axis has looked healthy again [s]


class TrackerGains(NamedTuple):
    """Gains of one step."""

    mean: Array  # (2,) of a sample in the two averages
    alpha: Scalar  # of a sample in the fault
    beta_dt: Scalar  # [1/s] in its slope: beta / dt
    settled: Scalar  # samples after a jump before the slope moves


def tracker_gains(dt: Scalar, tracking: Scalar) -> TrackerGains:
    """Gains for a step ``dt`` and an averaging time [s]."""
    alpha = 1.4 * dt / (tracking + dt)
    beta = alpha**2 / (2.0 - alpha)
    settled = 1.4 / larger(alpha, SHORTEST)
    return TrackerGains(dt / (AVERAGES + dt), alpha, beta / larger(dt, SHORTEST), settled)


def start_track(like: Vector) -> Track:
    """Return a track without faults."""
    zeros = namespace(like).zeros_like(like)
    means = namespace(like).zeros((*like.shape, 2))
    return Track(zeros, zeros, zeros, zeros, zeros, zeros, zeros, means, zeros, zeros)


def track_fault(
    track: Track,
    residual: Vector,
    variances: Statistics,
    colour: Vector,
    alarm: Mask,
    abrupt: Mask,
    suspicion: Vector,
    valid: Mask,
    gains: TrackerGains,
    dt: Scalar,
) -> Track:
    """Follow the residual [rad] of the faulty axes, as far as they are measured in this sample (``valid``).

    The track starts where an axis is declared faulty (``alarm``), with the fault as old as the suspicion [s].
    """
    expected = track.fault + track.slope * dt
    error = residual - expected
    jump = alarm | (error**2 > JUMPS * variances[..., SAMPLE])
    # right after a jump the fault is the mean of the samples since, and the slope waits
    samples = (track.samples + valid) * ~jump
    mean = 1.0 / (samples + 1.0)
    alpha = larger(gains.alpha, mean) * valid
    average = gains.mean * (1.0 - column(colour) * SLOWER)
    average = larger(average, column(mean)) * column(valid)
    return track._replace(
        fault=expected + alpha * error,
        slope=(track.slope + gains.beta_dt * valid * error) * (samples > gains.settled),
        samples=samples,
        still=where(alarm, LONG_AGO * ~abrupt, (track.still + dt) * ~jump),
        means=track.means + average * (column(residual) - track.means),
        age=where(alarm, suspicion, track.age + dt),
    )


def clear_healthy(track: Track, faulty: Mask) -> Track:
    """Set the track of all axes that are not faulty to zero."""
    masks = (faulty if part.ndim == faulty.ndim else column(faulty) for part in track)
    return Track(*(where(mask, part, 0.0) for mask, part in zip(masks, track, strict=True)))


def track_variance(track: Track, variances: Statistics) -> Vector:
    """Variance [rad²] that the sensor's noise gives the tracked fault."""
    return variances[..., SHORT] + variances[..., SAMPLE] / (track.samples + 1.0)


class Recovery(NamedTuple):
    """What is judged of each axis."""

    track: Track
    trusted: Mask  # the axis is trusted again
    outlasted: Mask  # trusted although the fault is there: it outlasted our patience
    age: Vector  # of the fault [s], also of one that is over


def judge_recovery(
    track: Track,
    faulty: Mask,
    predicted: Vector,
    variances: Statistics,
    cautious: Vector,
    bias_variance: Column,
    valid: Mask,
    blur: Vector,
    recovery: Scalar,
    patience: Scalar,
    dt: Scalar,
) -> Recovery:
    """Judge which faulty axes are trusted again.

    They must look healthy for a share of the fault's age, at most for ``recovery`` [s], or have stood still
    at the age of ``patience`` [s]. Variances are of the dead-reckoned angle (``predicted`` [rad²]), of the
    sensor (``variances`` [rad²]), of an average over 0.15 s by the prior (``cautious`` [rad²]), and of the
    gyro bias, at which the angle drifts (``bias_variance`` [rad²/s²]). ``dt`` [s] is the step. ``valid`` axes
    are measured. What comes back must agree ``blur`` times better than at level, in variances.
    """
    spread = variances[..., MIDDLE]
    # Does it stand still? The two averages of a fault that moves differ.
    short, long = track.means[..., 0], track.means[..., 1]
    motion = short - long
    motion_variance = spread + bias_variance * (AVERAGES[1] - AVERAGES[0]) ** 2
    moves = motion**2 / motion_variance
    still = where(moves > JUMPS, 0.0, track.still)
    # Does it agree with zero, as far as dead reckoning knows?
    off = short**2 / (predicted + larger(spread, cautious))
    peak, top = larger(track.peak, off * valid), larger(track.top, short**2 * valid / blur)
    # A fault that was seen to leave zero is there until it is seen to come back.
    size, most, small = abs(short), sqrt(top), peak < AGREES
    near, less = blur * off < AGREES, size < BACK * most
    leaps = (track.samples * dt < SEEN) & (still < SEEN)
    leapt_back = small | ((blur * off < LEAPT) & less)
    come_back = near & less & (CERTAIN * predicted < (most - size) ** 2)
    left = where(still < SEEN, 1.0 - small, track.away)
    left = where(track.away < 0.0, track.away, where(come_back, 0.0, left))
    away = where(valid, where(leaps, 1.0 - 2.0 * leapt_back, left), track.away)
    limit = where(away < 0.0, LEAPT, where(still < LONG_AGO, AGREES, CLOSE))
    agrees = (away <= 0.0) & (off < smaller(limit, RETURNED * peak))
    outlasted = (track.age > patience) & (abs(motion) < ALMOST_STILL)
    calm = (track.calm + dt * valid) * (faulty & (((moves < STANDS) & agrees) | outlasted))
    enough = where(outlasted, recovery, clip(QUICK * track.age, SOONEST, recovery))
    trusted = faulty & valid & (calm > enough)
    return Recovery(
        track._replace(calm=calm, still=still, away=away, peak=peak, top=top),
        trusted,
        trusted & ~agrees,
        track.age,
    )
