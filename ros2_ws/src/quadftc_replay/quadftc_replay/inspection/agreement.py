"""What attitude and gyro say of each other.

Between two attitude samples the vehicle turns by phi = log(q_k⁻¹ q_{k+1}), in body axes, and the gyro says
theta = integral of omega. Their difference

    phi - theta = S theta + tau (omega_{k+1} - omega_k) + b dt + e

has what healthy sensors do not agree on: scale and alignment S, a delay tau, a bias b. A robust least-squares
fit takes S and tau out, by what is faster than `SLOW`: so an offset that begins does not pass for a scale. A
jump of the attitude is in one e alone; an offset f of the gyro adds -f dt to each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from quadftc_model.rotations import rotation_between
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.whitening import GAP, TO_SIGMA, Floats, Mask

FASTEST = 400.0  # Hz; attitudes beyond are thinned out
ROUNDS = 6  # of the reweighted fit
HUBER = 2.0  # standard deviations
SCALE = 0.1  # 1; largest scale and alignment
SLOW = 2.0  # s
HALF = 0.7 * np.pi  # rad; of half a turn between two attitudes
ASIDE = 0.5  # s; before and after a step of the gyro, over which it parts from the attitude
CLEAR = 4.0  # standard deviations of what it parts by otherwise
SAME = 0.5  # 1; of the step


class Agreement(NamedTuple):
    """The difference of attitude and gyro, interval by interval."""

    time: Floats  # (n,) end of the interval [s]
    dt: Floats  # (n,) [s]
    rest: Floats  # (n, 3) e [rad], body axes
    scale: Floats  # (3,) of a rate, what was taken for a scale: an offset f adds -(1 + scale) f dt
    turn: Floats  # (n, 3) phi [rad]


def compare(attitude: Signal, gyro: Signal) -> Agreement | None:
    """Compare an attitude (n, 4) with a gyro (m, 3); None if they hardly overlap."""
    turning = gyro.whole()
    gyro_time = turning.time
    time, q = _thinned(attitude, max(float(gyro_time[0]), 0.0) if len(gyro_time) else 0.0, gyro_time)
    if len(time) < 50 or len(gyro_time) < 50:
        return None
    steps = np.diff(gyro_time)
    at, rate = turning.integral().at(time), turning.at(time)
    dt, theta, turn = np.diff(time), np.diff(at, axis=0), rotation_between(q[:-1], q[1:])
    usual = float(np.median(dt))
    jumps = np.concatenate([[0.0], (steps > max(5.0 * float(np.median(steps)), 0.05)) * 1.0]).cumsum()
    dark = np.diff(np.interp(time, gyro_time, jumps)) > 0.0
    good = (dt < GAP * usual) & ~dark & np.isfinite(turn).all(axis=1)
    good &= np.linalg.norm(theta, axis=1) < HALF  # else nobody knows how often it turned
    if good.sum() < 50:
        return None
    rest, scale = _fit(turn - theta, theta, np.diff(rate, axis=0), dt, good)
    return Agreement(time[1:], dt, np.where(good[:, None], rest, 0.0), scale, turn)


def parts_by(agreement: Agreement, axis: int, moment: float, size: float) -> bool:
    """Whether the gyro's rate parts from the attitude's by about ``size`` [rad/s] at a moment [s]."""
    time, rates = agreement.time, agreement.rest[:, axis] / agreement.dt
    count = max(3, round(ASIDE / float(np.median(agreement.dt))))
    row = int(np.searchsorted(time, moment))
    if row < count or row + count > len(time):
        return False
    total = np.concatenate([[0.0], np.cumsum(rates)])
    means = (total[count:] - total[:-count]) / count
    changes = means[:-count] - means[count:]  # of the gyro: before less after
    sigma = TO_SIGMA * float(np.median(np.abs(changes)))
    change = float(changes[row - count])
    return abs(change) > CLEAR * sigma and abs(change - size) < SAME * abs(size)


def _thinned(attitude: Signal, start: float, gyro_time: Floats) -> tuple[Floats, Floats]:
    """Attitudes while there is a gyro, no more than `FASTEST` and no more than there are gyro samples."""
    inside = np.isfinite(attitude.value).all(axis=1) & (attitude.time >= start)
    inside &= attitude.time <= (float(gyro_time[-1]) if len(gyro_time) else -1.0)
    time, q = attitude.time[inside], attitude.value[inside]
    rate = min(FASTEST, 1.0 / float(np.median(np.diff(gyro_time)))) if len(gyro_time) > 1 else FASTEST
    stride = max(1, round(attitude.rate / rate)) if rate > 0.0 else 1
    return time[::stride], q[::stride]


def _fit(difference: Floats, theta: Floats, change: Floats, dt: Floats, good: Mask) -> tuple[Floats, Floats]:
    """Take out scale and delay, axis by axis; return the rest (n, 3), bias included, and the scales (3,)."""
    rest, scale = np.zeros_like(difference), np.zeros(3)
    count = max(3, round(SLOW / float(np.median(dt))))
    for axis in range(3):
        columns = np.column_stack([theta, change[:, axis]])
        everything = np.where(good[:, None], np.column_stack([columns, difference[:, axis]]), 0.0)
        fast = everything - ndimage.uniform_filter1d(everything, count, axis=0)
        weight = good.astype(float)
        found = np.zeros(columns.shape[1])
        for _ in range(ROUNDS):
            scaled = fast[:, :-1] * weight[:, None]
            found = np.linalg.lstsq(scaled.T @ fast[:, :-1], scaled.T @ fast[:, -1], rcond=1e-10)[0]
            found[:3] = np.clip(found[:3], -SCALE, SCALE)
            left = np.abs(fast[:, -1] - fast[:, :-1] @ found)
            sigma = TO_SIGMA * float(np.median(left[good])) + 1e-12
            weight = good * np.minimum(1.0, HUBER * sigma / np.maximum(left, 1e-15))
        rest[:, axis] = difference[:, axis] - columns @ found
        scale[axis] = found[axis]
    return rest, scale
