"""When a faulty axis is trusted again: its fault agrees with zero, stands still, and has done so long enough.

A fault found early may be a slow ramp, which looks healthy for a while. So a fault that never visibly moved
must look healthy for longer. A fault that stands still for ``patience`` seconds is taken for an error of the
observer: otherwise a wrong start or a false alarm would never end.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.supervision.fault_track import AVERAGES, JUMPS, Track
from quadftc_model.arrays import Column, Mask, Vector, namespace

AGREES, STANDS = 16.0, 9.0  # 1; squared standard deviations
GRADUAL = 6.0  # 1; how many times as long a fault that never visibly moved must look healthy
ALMOST_STILL = 0.0087  # rad, 0.5 deg; an error of the observer moves a little, as the vehicle does


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

    Parameters
    ----------
    predicted, spread : array (..., 3)
        Variance of the dead-reckoned angle, and `healthy_spread` [rad²].
    bias_variance : array (..., 1)
        Of the gyro bias, at which the dead-reckoned angle drifts [rad²/s²].
    recovery, patience, dt : float
        How long an axis must look healthy; after which a fault that stands still ends; step [s].
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
