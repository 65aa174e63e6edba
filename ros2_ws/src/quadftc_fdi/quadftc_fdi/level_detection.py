"""Detection of a fault from the size of its estimate: a level with hysteresis, and a time to recover."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import Mask, States, Vector, namespace
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, SUSPECT


class Detection(NamedTuple):
    """What detection remembers of the level."""

    detected: Mask  # the level has been high and not low again for long enough
    low: Mask  # the level is low now
    calm: Vector  # how long it has been low while detected [s]
    age: Vector  # time since it was last low without a fault [s]


def start_detection(like: Vector) -> Detection:
    """Start with nothing detected on the axes of an array (..., 3)."""
    xp = namespace(like)
    zeros = xp.zeros_like(like)
    return Detection(zeros > 0.0, zeros == 0.0, zeros, zeros)


def detect(
    state: Detection, level: Vector, high: float, low: float, recovery_time: float, dt: float
) -> Detection:
    """Advance by ``dt`` [s] to a level (..., 3).

    A fault is there from the first level of ``high`` or more, until the level has been below ``low`` for
    ``recovery_time`` [s].
    """
    xp = namespace(level)
    is_low = level < low
    detected = state.detected | (level >= high)
    calm = xp.where(detected & is_low, state.calm + dt, 0.0)
    detected = detected & (calm < recovery_time)
    age = xp.where(is_low & ~detected, 0.0, state.age + dt)
    return Detection(detected, is_low, calm, age)


def fault_state(state: Detection, suspect: Mask) -> States:
    """Fault states (..., 3) of quadftc_msgs/FaultStatus; ``suspect`` tells SUSPECT from HEALTHY."""
    xp = namespace(state.age)
    healthy = xp.where(suspect, SUSPECT, HEALTHY)
    faulty = xp.where(state.low, RECOVERING, FAULTY)
    return xp.where(state.detected, faulty, healthy).astype(xp.uint8)


def onset_age(state: Detection) -> Vector:
    """Age of the present fault (..., 3) [s]; -1 without one."""
    return namespace(state.age).where(state.detected, state.age, -1.0)
