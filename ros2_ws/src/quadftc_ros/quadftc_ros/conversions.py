# pyright: basic
"""Between messages and arrays, without loss: float64 stays float64, stamps stay whole nanoseconds."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from numpy.typing import NDArray

from quadftc_bags.cdr.message import NANOSECONDS
from quadftc_model.samples import ALARMS, FAULTY
from quadftc_msgs.msg import FaultStatus

END_NS = 2**31 * NANOSECONDS  # ns; where the stamps end that a message can have
_EPOCH_NS = time.time_ns() - time.monotonic_ns()

Floats = NDArray[np.float64]


def wall_ns() -> int:
    """Time of the machine [ns], by its clock as it was when this process began: setting it moves nothing."""
    return _EPOCH_NS + time.monotonic_ns()


def stamp_of(message: Any) -> int:
    """Stamp [ns] of a message with a header, or of a header itself."""
    stamp = getattr(message, "header", message).stamp
    return stamp.sec * NANOSECONDS + stamp.nanosec


def time_message(stamp_ns: int) -> Time:
    """Message of a time [ns]."""
    sec, nanosec = divmod(stamp_ns, NANOSECONDS)
    return Time(sec=sec, nanosec=nanosec)


def array_of(vector: Vector3) -> Floats:
    """Array (3,) of a vector message."""
    return np.array((vector.x, vector.y, vector.z))


def fill_vector(vector: Vector3, array: Floats) -> None:
    """Write an array (3,) into a vector message."""
    vector.x, vector.y, vector.z = array.tolist()


def revise_status(message: FaultStatus, stamp_ns: int, fault: Floats, certain: float) -> None:
    """Put another fault (3,) [rad] into a status whose observer is gone, keeping the header.

    An axis that is off by more than ``certain`` [rad] counts as faulty, if it did not, since ``stamp_ns``.
    """
    fill_vector(message.estimate, fault)
    for axis in np.flatnonzero((np.abs(fault) > certain) & ~np.isin(message.state, ALARMS)).tolist():
        states: Any = message.state
        onsets: Any = message.onset
        states[axis], onsets[axis] = FAULTY, time_message(stamp_ns)
