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

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Array,
    Components,
    Vector,
    changed_where,
    clip,
    components,
    namespace,
    stacked,
)
from quadftc_model.vehicle import Vehicle
from quadftc_model.wrench_set import Floats, WrenchSet, extremes, limits, wrench_set

CARRIED = 1.3  # 1; of the weight: up to this thrust, yaw is reversed if need be; 1.3 carries 40 deg of tilt
GIVES_WAY = 2.0  # 1; thrust that yaw is reversed for, over what a yaw torque of zero lacks
LEAST_WEIGHT = 1e-6  # 1; of a rotor in the least squares, so that rotors that are off leave them solvable


class _Polygon(NamedTuple):
    """The set of (roll, pitch), prepared for `_nearest`; m edges."""

    normals: Floats  # (m, 2) of length 1
    sides: Floats  # (2 n, m)
    cosine: Floats  # (m, m) of edge j (rows) with edge k
    ahead: Floats  # (m, m) 1 over how fast a step along edge k comes to edge j; 0 where it does not


class _Sharing(NamedTuple):
    """Least squares of more than four rotors."""

    products: Floats  # (n, 10) entries of E W E' (upper triangle) over the weights W
    effect: Floats  # (4, n) with rows of size 1
    size: Floats  # (4,) of the rows


def weak_thrusts(
    vehicle: Vehicle, wanted: Components, effectiveness: Components
) -> tuple[Components, Components]:
    """Thrusts [N] (..., n) that rotors really give, and the wrench (..., 4), for the one wanted (..., 4)."""
    effectiveness = clip(effectiveness, 0.0, 1.0)
    whole, bounds = wrench_set(vehicle), limits(vehicle, effectiveness)
    count = effectiveness.shape[-1]
    low, high = bounds[..., :count], bounds[..., count:]
    thrusts = _shared(vehicle, whole, wanted, effectiveness)

    def cut() -> tuple[Components, Components]:
        given = _reachable(vehicle, whole, bounds, wanted)
        asked = _shared(vehicle, whole, given, effectiveness)
        return clip(_placed(vehicle, whole, bounds, given, asked), low, high), given

    return changed_where((thrusts < low) | (thrusts > high), cut, (thrusts, wanted))


def reachable_in_hover(vehicle: Vehicle, torque: Vector, effectiveness: Components) -> Vector:
    """Torque [N m] (..., 3) nearest to the wanted one that weak rotors have beside the weight."""
    xp = namespace(torque)
    weight = vehicle.weight + 0.0 * torque[..., :1]
    wanted = xp.concatenate([weight, torque], axis=-1)
    return weak_thrusts(vehicle, wanted, effectiveness)[1][..., 1:]


def _reachable(vehicle: Vehicle, whole: WrenchSet, bounds: Components, wanted: Components) -> Components:
    """Wrench (..., 4) nearest to the wanted one, in the order of the stages."""
    xp = namespace(bounds)
    tilt = _nearest(vehicle, bounds, wanted[..., 1:3])
    held = xp.concatenate([tilt, xp.zeros_like(tilt[..., :1])], axis=-1)
    thrust = wanted[..., 0]
    least, most = extremes(whole.thrust, bounds, tilt)
    free = _within(thrust, least, most)
    lowest, highest = extremes(whole.thrust_held, bounds, held)
    carried = CARRIED * vehicle.weight
    carried = carried + GIVES_WAY * xp.maximum(carried - highest, 0.0)
    upright = xp.maximum(_within(thrust, lowest, highest), xp.minimum(free, carried))
    thrust = xp.where(free > carried, _within(upright, least, most), free)
    known = xp.concatenate([thrust[..., None], tilt], axis=-1)
    yaw = _within(wanted[..., 3], *extremes(whole.yaw, bounds, known))
    return xp.concatenate([known, yaw[..., None]], axis=-1)


def _within(x: Array, low: Array, high: Array) -> Array:
    """Nearest to ``x`` in a range; in its middle if it is empty, which rounding may leave."""
    xp = namespace(low)
    middle = 0.5 * (low + high)
    return xp.minimum(xp.maximum(x, xp.minimum(low, middle)), xp.maximum(high, middle))


def _nearest(vehicle: Vehicle, bounds: Components, tilt: Components) -> Components:
    """Roll and pitch torque (..., 2) [N m] nearest to those wanted, in the polygon of attainable ones."""
    shape = _polygon(vehicle)
    xp = namespace(bounds)
    beyond = tilt @ shape.normals.T - bounds @ shape.sides  # (..., m) how far outside each edge

    def moved() -> Components:
        # from the foot on each edge k, along it as far as all other edges j allow: (..., j, k)
        room = beyond[..., None, :] * shape.cosine - beyond[..., :, None]
        step = room * shape.ahead
        most = xp.where(shape.ahead > 0.0, step, math.inf).min(axis=-2)
        least = xp.where(shape.ahead < 0.0, step, -math.inf).max(axis=-2)
        along = xp.minimum(xp.maximum(0.0, least), most)
        gap = xp.maximum(least - most, 0.0)  # no part of this edge is within the others
        cost = xp.where(beyond > 0.0, beyond**2 + along**2 + 1e6 * gap**2, math.inf)
        best = xp.where(cost <= cost.min(axis=-1, keepdims=True), 1.0, 0.0)
        share = best / best.sum(axis=-1, keepdims=True)  # several only where they meet in a corner
        x, y = shape.normals.T
        across = np.stack([-y, x], axis=-1)
        return tilt - (share * beyond) @ shape.normals + (share * along) @ across

    outside = beyond > 0.0
    new = changed_where(outside, moved, tilt)
    return xp.where(outside.any(axis=-1, keepdims=True), new, tilt)


@functools.lru_cache(maxsize=64)
def _polygon(vehicle: Vehicle) -> _Polygon:
    normals, sides = wrench_set(vehicle).tilt
    length = np.linalg.norm(normals, axis=1)
    normals, sides = normals / length[:, None], sides / length
    x, y = normals.T
    along = np.outer(x, -y) + np.outer(y, x)  # of edge j's normal with the direction of edge k
    ahead = np.where(np.abs(along) > 1e-9, 1.0 / np.where(along == 0.0, 1.0, along), 0.0)
    return _Polygon(normals, sides, normals @ normals.T, ahead)


def _shared(vehicle: Vehicle, whole: WrenchSet, wrench: Components, effectiveness: Components) -> Components:
    """Thrusts (..., n) [N] of least squares, whatever the limits."""
    if not whole.single:
        return wrench @ vehicle.force_allocation.T
    sharing = _sharing(vehicle)
    weights = namespace(wrench).maximum(effectiveness**2, LEAST_WEIGHT)
    entries = components(weights @ sharing.products)
    solved = _solve(entries, components(wrench / sharing.size))
    return weights * (stacked(solved) @ sharing.effect)


@functools.lru_cache(maxsize=64)
def _sharing(vehicle: Vehicle) -> _Sharing:
    effect = vehicle.effectiveness
    size = np.max(np.abs(effect), axis=1)
    scaled = effect / size[:, None]
    pairs = itertools.combinations_with_replacement(range(4), 2)
    return _Sharing(np.stack([scaled[a] * scaled[b] for a, b in pairs], axis=1), scaled, size)


def _solve(entries: Sequence[Any], right: Sequence[Any]) -> list[Any]:
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


def _placed(
    vehicle: Vehicle, whole: WrenchSet, bounds: Components, wrench: Components, asked: Components
) -> Components:
    """Thrusts (..., n) [N] within their limits that give a wrench which is possible, near those asked for."""
    if not whole.single:
        return asked
    xp, effect, count = namespace(bounds), vehicle.effectiveness, asked.shape[-1]
    found: list[Any] = [None] * count
    for rotor, over in whole.single:
        own = xp.minimum(xp.maximum(asked[..., rotor], bounds[..., rotor]), bounds[..., rotor + count])
        found[rotor] = thrust = _within(own, *extremes(over, bounds, wrench))
        wrench = wrench - thrust[..., None] * effect[:, rotor]
    rest = wrench @ whole.inverse.T
    for index, rotor in enumerate(whole.last):
        found[rotor] = rest[..., index]
    return xp.stack(found, axis=-1)
