"""Allocation to rotors that are weak or off: tilt before thrust, thrust before yaw, on the attainable set.

A rotor of effectiveness e_i gives g_i = e_i F_i where a healthy one gave F_i. Its limits shrink by e_i, and
the directions in which rotors push stay. So the facets of the attainable set are known ahead, and each
stage is a few products (`quadftc_model.wrench_set`). Nothing is divided by e_i before the last line.

1. Roll and pitch: the pair nearest to the wanted one that some thrust and some yaw allow.
2. Thrust: the nearest one. Where a yaw torque of zero allows `CARRIED` times the weight, more than that may
   take yaw's share, but not reverse it. The less it allows, the further yaw gives way.
3. Yaw: the nearest torque that then fits. With one rotor of four off, nothing is left to choose.

Where four rotors fit exactly, there is one solution. More than four share it by least squares, weighted with
e_i squared. Where that leaves a limit, one rotor after the other takes the nearest thrust with which those
after it can still give the rest; the last four then have one solution.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from quadftc_model.arrays import (
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
    stacked,
    where,
)
from quadftc_model.vehicle import Vehicle
from quadftc_model.wrench_set import extremes, limits

CARRIED = 1.3  # 1; of the weight: up to this thrust, yaw is reversed if need be; 1.3 carries 40 deg of tilt
GIVES_WAY = 2.0  # 1; thrust that yaw is reversed for, over what a yaw torque of zero lacks
LEAST_WEIGHT = 1e-6  # 1; of a rotor in the least squares, so that rotors that are off leave them solvable


def weak_thrusts(
    vehicle: Vehicle, wanted: Components, effectiveness: Components
) -> tuple[Components, Components]:
    """Thrusts [N] (..., n) that rotors really give, and the wrench (..., 4), for the one wanted (..., 4)."""
    effectiveness = clip(effectiveness, 0.0, 1.0)
    bounds, count = limits(vehicle, effectiveness), effectiveness.shape[-1]
    low, high = bounds[..., :count], bounds[..., count:]
    thrusts = _shared(vehicle, wanted, effectiveness)

    def cut() -> tuple[Components, Components]:
        given = _reachable(vehicle, bounds, wanted)
        asked = _shared(vehicle, given, effectiveness)
        return clip(_placed(vehicle, bounds, given, asked), low, high), given

    outside = ((thrusts < low) | (thrusts > high)).any(axis=-1)
    return branch(outside, cut, lambda: (thrusts, wanted))


def reachable_in_hover(vehicle: Vehicle, torque: Vector, effectiveness: Components) -> Vector:
    """Torque [N m] (..., 3) nearest to the wanted one that weak rotors have beside the weight."""
    xp = namespace(torque)
    weight = vehicle.weight * xp.ones_like(torque[..., :1])
    wanted = xp.concatenate([weight, torque], axis=-1)
    return weak_thrusts(vehicle, wanted, effectiveness)[1][..., 1:]


def _reachable(vehicle: Vehicle, bounds: Components, wanted: Components) -> Components:
    """Wrench (..., 4) nearest to the wanted one, in the order of the stages."""
    xp, whole = namespace(bounds), vehicle.wrench_set
    # 1
    tilt = _nearest(vehicle, bounds, wanted[..., 1:3])
    # 2: the nearest thrust that some yaw torque allows, and that one of zero does
    thrust = wanted[..., 0]
    least, most = extremes(whole.thrust, bounds, tilt)
    free = _within(thrust, least, most)
    still = xp.concatenate([tilt, xp.zeros_like(tilt[..., :1])], axis=-1)
    lowest, highest = extremes(whole.thrust_held, bounds, still)
    carried = CARRIED * vehicle.weight
    carried = carried + GIVES_WAY * larger(carried - highest, 0.0)
    upright = larger(_within(thrust, lowest, highest), smaller(free, carried))
    thrust = where(free > carried, _within(upright, least, most), free)
    # 3
    known = xp.concatenate([column(thrust), tilt], axis=-1)
    yaw = _within(wanted[..., 3], *extremes(whole.yaw, bounds, known))
    return xp.concatenate([known, column(yaw)], axis=-1)


def _within(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """Nearest to ``x`` in a range; in its middle if it is empty, which rounding may leave."""
    middle = 0.5 * (low + high)
    return clip(x, smaller(low, middle), larger(high, middle))


def _nearest(vehicle: Vehicle, bounds: Components, tilt: Components) -> Components:
    """Roll and pitch torque (..., 2) [N m] nearest to those wanted, in the polygon of attainable ones."""
    normals, sides, cosine, ahead = vehicle.wrench_set.tilt
    beyond = tilt @ normals.T - bounds @ sides  # (..., m) how far outside each edge
    # from the foot on each edge k, along it as far as all other edges j allow: (..., j, k)
    step = (beyond[..., None, :] * cosine - beyond[..., :, None]) * ahead
    most = where(ahead > 0.0, step, math.inf).min(axis=-2)
    least = where(ahead < 0.0, step, -math.inf).max(axis=-2)
    along = smaller(larger(0.0, least), most)
    gap = larger(least - most, 0.0)  # no part of this edge is within the others
    cost = where(beyond > 0.0, beyond**2 + along**2 + 1e6 * gap**2, math.inf)
    best = where(cost <= cost.min(axis=-1, keepdims=True), 1.0, 0.0)
    share = best / best.sum(axis=-1, keepdims=True)  # several only where they meet in a corner
    across = normals[:, ::-1] * np.array([-1.0, 1.0])
    moved = tilt - (share * beyond) @ normals + (share * along) @ across
    return where((beyond > 0.0).any(axis=-1, keepdims=True), moved, tilt)


def _shared(vehicle: Vehicle, wrench: Components, effectiveness: Components) -> Components:
    """Thrusts (..., n) [N] of least squares, whatever the limits."""
    if effectiveness.shape[-1] == 4:
        return wrench @ vehicle.force_allocation.T
    products, effect, size = vehicle.wrench_set.sharing
    weights = larger(effectiveness**2, LEAST_WEIGHT)
    solved = _solve(components(weights @ products), components(wrench / size))
    return weights * (stacked(solved) @ effect)


def _solve(entries: Sequence[Scalar], right: Sequence[Scalar]) -> list[Scalar]:
    """Solve M z = right, M positive definite with these entries (upper triangle by rows), by elimination."""
    pairs = itertools.combinations_with_replacement(range(4), 2)
    matrix = dict(zip(pairs, entries, strict=True))
    found = list(right)
    for k in range(4):
        for i in range(k + 1, 4):
            factor = matrix[k, i] / matrix[k, k]
            found[i] = found[i] - factor * found[k]
            for j in range(i, 4):
                matrix[i, j] = matrix[i, j] - factor * matrix[k, j]
    for i in reversed(range(4)):
        for j in range(i + 1, 4):
            found[i] = found[i] - matrix[i, j] * found[j]
        found[i] = found[i] / matrix[i, i]
    return found


def _placed(vehicle: Vehicle, bounds: Components, wrench: Components, asked: Components) -> Components:
    """Thrusts (..., n) [N] within their limits that give a wrench which is possible, near those asked for."""
    whole, count = vehicle.wrench_set, asked.shape[-1]
    if count == 4:
        return asked
    found: dict[int, Scalar] = {}
    for rotor, over in whole.single:
        own = clip(asked[..., rotor], bounds[..., rotor], bounds[..., rotor + count])
        found[rotor] = thrust = _within(own, *extremes(over, bounds, wrench))
        wrench = wrench - column(thrust) * vehicle.effectiveness[:, rotor]
    found |= zip(whole.last, components(wrench @ whole.inverse.T), strict=True)
    return stacked([found[rotor] for rotor in range(count)])
