"""Allocation: the rotor speeds for a thrust and a torque, and what is given up where both do not fit.

Free flight commands the speed of each rotor: its thrust is k speed², its reaction torque in proportion. With
the effectiveness E (4, n) of the rotor thrusts F, (thrust, torque) = E F. The pseudo-inverse of E gives the F
of least squares; for four rotors it is the only one.

Where that F leaves the range of a rotor, roll and pitch come before thrust, and thrust before yaw, as a
multirotor that keeps its tilt can still be flown (Faessler, Falanga and Scaramuzza (2017), Thrust mixing,
saturation, and body-rate control for accurate aggressive quadrotor flight, IEEE RA-L 2(2)). Each stage is a
linear programme so small that it has a closed form:

1. roll and pitch are scaled together, by the largest factor that some thrust allows;
2. thrust is the nearest that some share of the wanted yaw torque, 0 to 1, allows;
3. yaw keeps the largest share that then fits.

What fits is given exactly. More than four rotors could give a little more by forces that cancel each other;
these are never used.

Rotors that are weak, or off, are `quadftc_control.weak_allocation`.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from quadftc_control.weak_allocation import weak_thrusts
from quadftc_model.arrays import (
    Components,
    Scalar,
    Vector,
    any_of,
    changed_where,
    chosen,
    clip,
    components,
    is_single,
    larger,
    namespace,
    pick,
    smaller,
    stacked,
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
    rotors, wanted = vehicle.rotors, stacked([thrust, *components(torque)])
    if effectiveness is None:
        forces, given = _healthy_forces(vehicle, wanted)
    else:
        forces, given = _forces(vehicle, wanted, effectiveness)
    speeds = namespace(torque).sqrt(forces / rotors.thrust_coefficient)
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
    allocation = vehicle.force_allocation
    low, high = _range_of(vehicle)
    forces = wanted @ allocation.T

    def cut() -> tuple[Components, Components]:
        given = _prioritised(allocation, wanted, low, high)
        return given @ allocation.T, given

    forces, given = changed_where((forces < low) | (forces > high), cut, (forces, wanted))
    return clip(forces, low, high), given  # rounding may leave the range


def _forces(vehicle: Vehicle, wanted: Components, effectiveness: Components) -> tuple[Components, Components]:
    """The same of rotors of which some may be weak; bit for bit as without where none is."""
    weak = any_of(effectiveness < 1.0)
    if is_single(weak):
        return _weak_forces(vehicle, wanted, effectiveness) if weak[0] else _healthy_forces(vehicle, wanted)
    healthy = _healthy_forces(vehicle, wanted)

    def mixed() -> tuple[Components, Components]:
        return chosen(weak[..., 0], _weak_forces(vehicle, wanted, effectiveness), healthy)

    return changed_where(weak, mixed, healthy)


def _weak_forces(
    vehicle: Vehicle, wanted: Components, effectiveness: Components
) -> tuple[Components, Components]:
    """The same of rotors that are weak: what healthy ones would give at the same speed, and the wrench."""
    xp = namespace(wanted)
    thrusts, given = weak_thrusts(vehicle, wanted, effectiveness)
    forces = clip(thrusts / xp.maximum(effectiveness, NOTHING), *_range_of(vehicle))
    asked = PROBE * vehicle.weight / effectiveness.shape[-1]
    return xp.where(effectiveness < NOTHING, xp.maximum(forces, asked), forces), given


def _range_of(vehicle: Vehicle) -> tuple[float, float]:
    """Least and largest thrust of a healthy rotor [N]."""
    rotors = vehicle.rotors
    return rotors.thrust_coefficient * rotors.speed_min**2, rotors.thrust_coefficient * rotors.speed_max**2


def _prioritised(allocation: Components, wanted: Components, low: float, high: float) -> Components:
    """Thrust and torque (..., 4) nearest to those wanted by which no rotor leaves [low, high] [N]."""
    thrust, roll, pitch, yaw = components(wanted)
    slack = _ROUNDING * high
    share = components(allocation[:, 0])  # of each rotor in the thrust
    by_roll, by_pitch, by_yaw = (components(allocation[:, index]) for index in (1, 2, 3))
    tilts = [roll * x + pitch * y for x, y in zip(by_roll, by_pitch, strict=True)]
    yaws = [yaw * z for z in by_yaw]

    def reachable() -> tuple[Scalar, Scalar]:
        return _tilt_and_thrust(thrust, tilts, yaws, share, low, high)

    # 1 and 2, which mostly ask for nothing
    rest = [x + thrust * a for x, a in zip(tilts, share, strict=True)]
    outside = (_least(rest) < low) | (-_least([-x for x in rest]) > high)
    scale, thrust = changed_where(outside, reachable, (1.0 + 0.0 * thrust, thrust))
    # 3
    rest = [scale * x + thrust * a for x, a in zip(tilts, share, strict=True)]
    fits = [_fit(high - x, z, slack) for x, z in zip(rest, yaws, strict=True)]
    fits += [_fit(x - low, -z, slack) for x, z in zip(rest, yaws, strict=True)]
    return stacked([thrust, scale * roll, scale * pitch, _least(fits) * yaw])


def _tilt_and_thrust(
    thrust: Scalar, tilts: Sequence[Any], yaws: Sequence[Any], share: Sequence[Any], low: float, high: float
) -> tuple[Scalar, Scalar]:
    """Stages 1 and 2: by what roll and pitch are scaled, and the thrust [N].

    ``tilts`` and ``yaws`` are the thrusts of the rotors [N] for all of roll and pitch, and of yaw.
    """
    slack = _ROUNDING * high
    # 1: that some thrust fits, no rotor may need a higher one than another one allows
    pairs = itertools.permutations(zip(tilts, share, strict=True), 2)
    scale = _least([_fit(high / a - low / b, x / a - y / b, 0.0) for (x, a), (y, b) in pairs])
    kept = [scale * x for x in tilts]
    # 2: the limits of the thrust fall by `slope` times the share of the yaw torque, until they meet
    slope = [z / a for z, a in zip(yaws, share, strict=True)]
    above = [(high - x) / a for x, a in zip(kept, share, strict=True)]
    below = [(low - x) / a for x, a in zip(kept, share, strict=True)]
    sides = itertools.product(zip(above, slope, strict=True), zip(below, slope, strict=True))
    most = _least([_fit(x - y, a - b, slack) for (x, a), (y, b) in sides])
    slope = [most * z for z in slope]
    top, bottom = _highest(above, slope), -_highest([-y for y in below], [-z for z in slope])
    return scale, smaller(larger(thrust, bottom), top)


def _fit(room: Scalar, wanted: Scalar, slack: float) -> Scalar:
    """Factor within [0, 1] that brings what is wanted into a room; 1 where it fits.

    A room below zero, which rounding leaves, is zero; ``slack`` [N] is how much does not count.
    """
    room = larger(room, 0.0) + slack
    if isinstance(wanted, float):
        return room / wanted if wanted > room else 1.0
    return pick(wanted > room, room / larger(wanted, _TINY), 1.0)


def _least(parts: Sequence[Any]) -> Any:
    return min(parts) if isinstance(parts[0], float) else functools.reduce(smaller, parts)


def _highest(start: Sequence[Scalar], slope: Sequence[Scalar]) -> Scalar:
    """Largest x (...) with x <= start - slope y for a y within [0, 1]: a linear programme in the plane.

    By duality the least of what each line allows at its best y, and of where a falling and a rising one meet.
    """
    lines = list(zip(start, slope, strict=True))
    alone = [a + larger(-x, 0.0) for a, x in lines]
    return _least(alone + [_meeting(*one, *other) for one, other in itertools.combinations(lines, 2)])


def _meeting(a: Scalar, x: Scalar, b: Scalar, y: Scalar) -> Scalar:
    """Height where the lines a - x t and b - y t meet, if one falls and one rises; else infinite."""
    opposite = x * y < 0.0
    if isinstance(opposite, bool):
        return (b * x - a * y) / (x - y) if opposite else math.inf
    return pick(opposite, (b * x - a * y) / pick(opposite, x - y, 1.0), math.inf)
