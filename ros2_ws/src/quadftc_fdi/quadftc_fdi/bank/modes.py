"""What can fail, and what else happens: one table, a row for each kind, three modes a row, one an axis.

A mode adds b + s t to a reading, t after its onset, or b to the unknown acceleration at its onset; a return
ends what an earlier onset has added. What is known of size b and slope s beforehand is normal about zero.

A gyro that jumps and stays is a row beside one that drifts: with a slope that may be anything, a constant
offset is unlikely, and a slow discrepancy would be the attitude's. So are an attitude and a gyro that creep,
of no size: the freedom to jump, too, costs them more than a rival of one number pays.

An attitude that is late by b reads b (A - 1) / T of the angle too much, where A delays by T, `noise.LONGER`:
Padé's all-pass (1 - s T/2) / (1 + s T/2). No attitude is early.

A gyro of a wrong scale reads b times what it should read too much. What that is, attitude and torque tell
without the gyro: a dead one shows no rate. An attitude of a wrong scale reads b times the angle too much. The
angle is reckoned by predicted turns: a corrected one follows the attitude.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.bank.noise import LONGER
from quadftc_model.arrays import Scalar, Vector, column, exp

# rows of the kinds; the first nine have an effect of their own, five of these a slope
ATTITUDE, GYRO, RETURN, FELT, GYRO_RETURN, PUSH, LATE, SCALED, STRETCHED = range(9)
JUMP, LAG, STEADY, CREEP, RAMP, WILD = range(9, 15)


class Kind(NamedTuple):
    """A kind of fault, or of what is none."""

    effect: int  # the kind that adds what it adds
    name: int  # the kind that it is said to be
    is_fault: bool
    size: float  # standard deviation of b [rad, rad/s, rad/s², s, 1]; `NONE` where there is none
    slope: float  # of s, per second; the same
    rate: float  # per flight hour and axis


# what one would bet on before a flight
FAULTS = 0.1  # 1/h; chosen: of a sensor, on each axis
EVENTS = 100.0  # 1/h; chosen: on each axis, what is no fault
ATTITUDE_SIZE = math.radians(5.0)  # rad; chosen: what a sensor jumps
ATTITUDE_SLOPE = 0.03  # rad/s; chosen: seldom creeps; decides who is blamed for a slow discrepancy
GYRO_SIZE = 0.3  # rad/s; chosen: what a sensor jumps, and what a fast one drifts in a second
WRONG_SCALE = 0.5  # 1; chosen: of a gyro or an attitude
PUSH_SIZE = 10.0  # rad/s²; chosen: collision, gust
GYRO_WILD = PUSH_SIZE  # rad/s²; of a reading that oscillates or lags: as fast as a push
JUMP_SIZE = math.radians(0.1)  # rad; chosen: what an attitude jumps as a marker hides or a filter resets
LAGS = 0.03  # s; chosen: lag of an attitude
NONE = 1e-6  # 1; rounding: size or slope of what has none
KINDS = (
    Kind(ATTITUDE, ATTITUDE, True, ATTITUDE_SIZE, ATTITUDE_SLOPE, FAULTS),
    Kind(GYRO, GYRO, True, GYRO_SIZE, GYRO_SIZE, FAULTS),
    Kind(RETURN, RETURN, False, ATTITUDE_SIZE, ATTITUDE_SLOPE, EVENTS),  # of an attitude that was off before
    Kind(FELT, FELT, True, ATTITUDE_SIZE, ATTITUDE_SLOPE, FAULTS),  # of the accelerometer, as a tilt
    Kind(GYRO_RETURN, GYRO_RETURN, False, GYRO_SIZE, GYRO_SIZE, EVENTS),  # of a gyro that was off before
    Kind(PUSH, PUSH, False, PUSH_SIZE, NONE, EVENTS),
    Kind(LATE, ATTITUDE, True, LONGER, NONE, FAULTS),
    Kind(SCALED, GYRO, True, WRONG_SCALE, NONE, FAULTS),
    Kind(STRETCHED, ATTITUDE, True, WRONG_SCALE, NONE, FAULTS),
    Kind(ATTITUDE, JUMP, False, JUMP_SIZE, NONE, EVENTS),
    Kind(LATE, LAG, False, LAGS, NONE, EVENTS),
    Kind(GYRO, GYRO, True, GYRO_SIZE, NONE, FAULTS),
    Kind(ATTITUDE, ATTITUDE, True, NONE, ATTITUDE_SLOPE, FAULTS),
    Kind(GYRO, GYRO, True, NONE, GYRO_SIZE, FAULTS),
    Kind(GYRO, GYRO, True, GYRO_SIZE, GYRO_WILD, FAULTS),
)
MODES = 3 * len(KINDS)
EFFECTS = 27  # modes with an effect of their own; the other kinds have that of another, `Kind.effect`
SLOPES = 15  # of these, modes with a slope
# effects of sizes, then slopes; and of products: squares of sizes, sizes by slopes, squares of slopes
COLUMN = np.concatenate([np.arange(EFFECTS), np.arange(SLOPES)])
PRODUCT = np.concatenate([COLUMN, np.arange(SLOPES)])
AXIS = np.tile(np.arange(3), len(KINDS))
KIND = np.repeat(np.arange(len(KINDS)), 3)
NAME = np.array([kind.name for kind in KINDS])[KIND]
EFFECT = 3 * np.array([kind.effect for kind in KINDS])[KIND] + AXIS
PRIOR = np.array([[kind.size, kind.slope] for kind in KINDS])[KIND] ** 2  # (modes, 2) variances
RATE = np.array([kind.rate for kind in KINDS])[KIND] / 3600.0  # (modes,) per second
MORE = np.log(EVENTS / FAULTS)  # added to the log of a rate where another axis of the sensor is faulty
SENSOR = np.select([NAME == ATTITUDE, NAME == FELT], [1, 2], 0)  # gyro, attitude, accelerometer
IS_FAULT = np.array([kind.is_fault for kind in KINDS])[KIND]
SAME = 1.0 * np.equal(NAME[:, None], NAME) * np.equal(AXIS[:, None], AXIS)  # one name: added up


def pattern(kind: int) -> NDArray[np.float64]:
    """Return which body axes (3, effects) the modes of a kind change; zeros for all others."""
    return (1.0 * ((np.arange(3)[:, None] == AXIS) & (kind == KIND)))[:, :EFFECTS]


def ahead(lead: Vector, turned: Vector, dt: Scalar) -> Vector:
    """Return by how much angles lead those that follow them with a time constant of T/2 [rad].

    They have ``turned`` [rad] in ``dt`` [s], as was predicted: what corrects an angle is no motion.
    """
    half = exp(-column(dt) / LONGER)
    return half * (half * lead + turned)


def late_by(lead: Vector) -> Vector:
    """Return what an attitude reads too much [rad] for each second by which it is late."""
    return -2.0 * lead / LONGER
