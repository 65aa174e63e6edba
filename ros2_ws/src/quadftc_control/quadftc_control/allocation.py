"""Allocation: the rotor speeds for a thrust and a torque, and what is given up where both do not fit.

Free flight commands the speed of each rotor: its thrust is k speed², its reaction torque in proportion. With
the effectiveness E (4, n) of the rotor thrusts F, (thrust, torque) = E F. The pseudo-inverse of E gives the F
of least squares; for four rotors it is the only one.

Where that F leaves the range of a rotor, roll and pitch come before thrust, and thrust before yaw. A
multirotor that keeps its tilt can still be flown. Source: Faessler, Falanga and Scaramuzza (2017), Thrust
mixing, saturation, and body-rate control for accurate aggressive quadrotor flight, IEEE RA-L 2(2). Each stage
is a linear programme so small that it has a closed form:

1. Roll and pitch are scaled together, by the largest factor that some thrust allows.
2. Thrust is the nearest that some share of the wanted yaw torque, 0 to 1, allows.
3. Yaw keeps the largest share that then fits.

What fits is given exactly. More than four rotors could give a little more by forces that cancel each other;
these are never used.

Rotors that are weak, or off, are `quadftc_control.weak_allocation`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_control.weak_allocation import weak_thrusts
from quadftc_model.arrays import (
    Column,
    Components,
    Scalar,
    Vector,
    branch,
    clip,
    column,
    components,
    larger,
    namespace,
    smaller,
    sqrt,
    stacked,
    where,
)
from quadftc_model.samples import ControllerOutput
from quadftc_model.vehicle import Vehicle

_ROUNDING = 1e-12  # 1; of the largest thrust of a rotor: what exceeds a room by less fits
NOTHING = 0.05  # 1; a rotor that is less effective counts as off
PROBE = 0.05  # 1; of hover thrust: what a rotor that is off is asked for, so that it shows when it is back
_TINY = 1e-30  # N; divides nothing by zero where no force is wanted


class Allocated(NamedTuple):
    """Rotor speeds, and what they give once the rotors have them."""

    speeds: Components  # (..., n) [rad/s]
    torque: Vector  # [N m]
    thrust: Scalar  # [N]


def allocate(
    vehicle: Vehicle, thrust: Scalar, torque: Vector, effectiveness: Components | None = None
) -> Allocated:
    """Rotor speeds for a thrust [N] (...) along body z and a torque [N m] (..., 3).

    ``effectiveness`` (..., n) is the thrust of each rotor over that of a healthy one at the same speed.
    """
    wanted = stacked([thrust, *components(torque)])
    if effectiveness is None:
        forces, given = _healthy_forces(vehicle, wanted)
    else:
        forces, given = branch(
            (effectiveness < 1.0).any(axis=-1),
            lambda: _weak_forces(vehicle, wanted, effectiveness),
            lambda: _healthy_forces(vehicle, wanted),
        )
    speeds = sqrt(forces / vehicle.rotors.thrust_coefficient)
    return Allocated(speeds, given[..., 1:], given[..., 0])


def actuated(
    vehicle: Vehicle, thrust: Scalar, output: ControllerOutput, effectiveness: Components | None = None
) -> tuple[Allocated, ControllerOutput]:
    """Allocate thrust [N] and the torque of a controller; its output says then what the rotors give."""
    allocated = allocate(vehicle, thrust, output.torque, effectiveness)
    cut = output.saturated | (allocated.torque != output.torque)
    return allocated, output._replace(torque=allocated.torque, saturated=cut)


def _healthy_forces(vehicle: Vehicle, wanted: Components) -> tuple[Components, Components]:
    """Thrusts of healthy rotors (..., n) [N], and the wrench (..., 4) that they give."""
    low, high = vehicle.rotors.thrust_range
    forces = wanted @ vehicle.force_allocation.T
    outside = ((forces < low) | (forces > high)).any(axis=-1)
    given = branch(outside, lambda: _prioritised(vehicle, wanted), lambda: wanted)
    return clip(given @ vehicle.force_allocation.T, low, high), given  # rounding may leave the range


def _weak_forces(
    vehicle: Vehicle, wanted: Components, effectiveness: Components
) -> tuple[Components, Components]:
    """The same of rotors that are weak: what healthy ones would give at the same speed, and the wrench."""
    thrusts, given = weak_thrusts(vehicle, wanted, effectiveness)
    forces = clip(thrusts / larger(effectiveness, NOTHING), *vehicle.rotors.thrust_range)
    asked = PROBE * vehicle.weight / effectiveness.shape[-1]
    return where(effectiveness < NOTHING, larger(forces, asked), forces), given


def _prioritised(vehicle: Vehicle, wanted: Components) -> Components:
    """Thrust and torque (..., 4) nearest to those wanted by which no rotor leaves its range."""
    low, high = vehicle.rotors.thrust_range
    slack = _ROUNDING * high
    thrust, tilt, yaw = wanted[..., :1], wanted[..., 1:3], wanted[..., 3:]
    share, by_tilt, by_yaw = (vehicle.force_allocation[:, each] for each in (0, slice(1, 3), 3))
    tilts, yaws = tilt @ by_tilt.T, yaw * by_yaw  # (..., n) thrusts of the rotors for all of them

    # 1. that some thrust fits, no rotor may need a higher one than another one allows
    room = high / share[:, None] - low / share
    scale = column(_least_of_pairs(_fit(room, _differences(tilts / share), 0.0)))

    # 2. the limits of the thrust fall by `slope` times the share of the yaw torque, until they meet
    slope = yaws / share
    above, below = (high - scale * tilts) / share, (low - scale * tilts) / share
    room = above[..., :, None] - below[..., None, :]
    slope = slope * column(_least_of_pairs(_fit(room, _differences(slope), slack)))
    thrust = smaller(larger(thrust, -_highest(-below, -slope)), _highest(above, slope))

    # 3. what room the others leave, at either limit
    forces = scale * tilts + thrust * share
    kept = smaller(_fit(high - forces, yaws, slack), _fit(forces - low, -yaws, slack))
    kept = kept.min(axis=-1, keepdims=True)
    return namespace(wanted).concatenate([thrust, scale * tilt, kept * yaw], axis=-1)


def _fit(room: Components, wanted: Components, slack: float) -> Components:
    """Factor within [0, 1] that brings what is wanted into a room; 1 where it fits.

    A room below zero, which rounding leaves, is zero; ``slack`` [N] is how much does not count.
    """
    room = larger(room, 0.0) + slack
    return where(wanted > room, room / larger(wanted, _TINY), 1.0)


def _highest(start: Components, slope: Components) -> Column:
    """Largest x (..., 1) with x <= start - slope y for a y within [0, 1]: a linear programme in the plane.

    By duality the least of what each line (..., n) allows at its best y, and of where a falling and a rising
    one meet.
    """
    alone = (start + larger(-slope, 0.0)).min(axis=-1)
    a, x, b, y = start[..., :, None], slope[..., :, None], start[..., None, :], slope[..., None, :]
    opposite = x * y < 0.0
    meeting = where(opposite, (b * x - a * y) / where(opposite, x - y, 1.0), math.inf)
    return column(smaller(alone, _least_of_pairs(meeting)))


def _differences(x: Components) -> Components:
    """Difference of each component and each other, (..., n) -> (..., n, n)."""
    return x[..., :, None] - x[..., None, :]


def _least_of_pairs(x: Components) -> Scalar:
    """Least number of a matrix, (..., n, n) -> (...)."""
    return x.min(axis=(-2, -1))
