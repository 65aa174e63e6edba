"""What can fail, and what else happens: one table, a row for each kind, three modes a row, one an axis.

A mode adds b + s t to a reading, t after its onset, or b to the unknown acceleration at its onset; a return
ends what an earlier onset has added. What is known of size b and slope s beforehand is normal about zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# rows of the kinds; the first four have an effect of their own
ATTITUDE, GYRO, PUSH, RETURN, JUMP, WILD = range(6)


class Kind(NamedTuple):
    """A kind of fault, or of what is none."""

    component: str
    is_fault: bool
    size: float  # standard deviation of b [rad, rad/s, rad/s²]
    slope: float  # of s, per second; a push has none
    rate: float  # per flight hour and axis


# what one would bet on before a flight
FAULTS = 0.1  # 1/h; chosen: of a sensor, on each axis
EVENTS = 100.0  # 1/h; chosen: on each axis, what is no fault
ATTITUDE_SIZE = math.radians(5.0)  # rad; chosen: what a sensor jumps
ATTITUDE_SLOPE = 0.03  # rad/s; chosen: seldom creeps; decides who is blamed for a slow discrepancy
GYRO_SIZE = 0.3  # rad/s; chosen: what a sensor jumps, and what a fast one drifts in a second
GYRO_WILD = 10.0  # rad/s²; chosen: of a reading that oscillates or lags
PUSH_SIZE = 10.0  # rad/s²; chosen: collision, gust
JUMP_SIZE = math.radians(0.1)  # rad; chosen: what an attitude jumps as a marker hides or a filter resets
NONE = 1e-6  # 1/s; rounding: the slope of what has none
KINDS = (
    Kind("attitude", True, ATTITUDE_SIZE, ATTITUDE_SLOPE, FAULTS),
    Kind("gyro", True, GYRO_SIZE, GYRO_SIZE, FAULTS),
    Kind("push", False, PUSH_SIZE, NONE, EVENTS),
    Kind("attitude", False, ATTITUDE_SIZE, ATTITUDE_SLOPE, EVENTS),  # of a fault before it, which is over
    Kind("attitude", False, JUMP_SIZE, NONE, EVENTS),
    Kind("gyro", True, GYRO_SIZE, GYRO_WILD, FAULTS),
)
CHANGES = (ATTITUDE, GYRO, PUSH, RETURN, ATTITUDE, GYRO)  # what each kind changes
MODES = 3 * len(KINDS)
EFFECTS = 12  # modes with an effect of their own; the other kinds share one
AXIS = np.tile(np.arange(3), len(KINDS))
KIND = np.repeat(np.arange(len(KINDS)), 3)
CHANGED = np.array(CHANGES)[KIND]
EFFECT = 3 * CHANGED + AXIS
PRIOR = np.array([[kind.size, kind.slope] for kind in KINDS])[KIND] ** 2  # (modes, 2) variances
RATE = np.array([kind.rate for kind in KINDS])[KIND] / 3600.0  # (modes,) per second
MORE = np.log(EVENTS / FAULTS)  # added to the log of a rate where another axis of the sensor is faulty
IS_FAULT = np.array([kind.is_fault for kind in KINDS])[KIND]
SAME = 1.0 * np.equal(EFFECT[:, None], EFFECT) * np.equal(IS_FAULT[:, None], IS_FAULT)  # one name: added up


def pattern(kind: int) -> NDArray[np.float64]:
    """Return which body axes (3, effects) the modes of a kind change; zeros for all others."""
    return (1.0 * ((np.arange(3)[:, None] == AXIS) & (kind == KIND)))[:, :EFFECTS]
