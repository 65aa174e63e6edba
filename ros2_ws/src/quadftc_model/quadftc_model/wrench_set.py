"""What thrusts and torques rotors can give together: half-spaces of the attainable set, in closed form.

Rotor i gives a thrust g_i within [low_i, high_i], and with it the wrench (thrust, roll, pitch, yaw) c_i g_i.
All of them together give a zonotope: a sum of segments. Its facets are known from the directions c_i alone.
The limits only move them, n . w <= sum_i max(n . c_i low_i, n . c_i high_i). So a rotor that is weak, or off,
costs no new geometry. A facet of a zonotope of dimension d is spanned by d - 1 of the c_i (McMullen (1971),
On zonotopes, Trans. Amer. Math. Soc. 159).

Where a component is left free, the set is the zonotope of the directions without it.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.arrays import Components, Scalar, namespace

if TYPE_CHECKING:
    from quadftc_model.vehicle import Vehicle

THRUST, ROLL, PITCH, YAW = range(4)  # components of a wrench
_PARALLEL = 1e-9  # 1; sine of an angle below which directions count as parallel

Floats = NDArray[np.float64]


class Facets(NamedTuple):
    """Half-spaces n . w <= bounds . sides of an attainable set, (m) of them."""

    normals: Floats  # (m, d) of length 1 in scaled components
    sides: Floats  # (2 n, m) by which the limits (low..., high...) [N] of the rotors move them


class Range(NamedTuple):
    """Least and largest value of one component where others are given: (bounds, others) . matrix, minima."""

    matrix: Floats  # (2 n + others, m)
    above: int  # so many of the m bound from above, the others, negated, from below


class Polygon(NamedTuple):
    """The attainable (roll, pitch), prepared for the nearest point of it; m edges."""

    normals: Floats  # (m, 2) of length 1
    sides: Floats  # (2 n, m)
    cosine: Floats  # (m, m) of edge j (rows) with edge k
    ahead: Floats  # (m, m) 1 over how fast a step along edge k comes to edge j; 0 where it does not


class Sharing(NamedTuple):
    """Least squares of more than four rotors."""

    products: Floats  # (n, 10) entries of E W E' (upper triangle) over the weights W
    effect: Floats  # (4, n) with rows of size 1
    size: Floats  # (4,) of the rows


class WrenchSet(NamedTuple):
    """The attainable sets of a vehicle, for any limits of its rotors."""

    tilt: Polygon  # of (roll, pitch), thrust and yaw left free
    thrust: Range  # over (roll, pitch), yaw left free
    thrust_held: Range  # over (roll, pitch, yaw)
    yaw: Range  # over (thrust, roll, pitch)
    single: tuple[
        tuple[int, Range], ...
    ]  # each of n - 4 rotors, over a wrench and the limits of those after it
    last: tuple[int, ...]  # the other four
    inverse: Floats  # (4, 4) their thrusts from the wrench that remains
    sharing: Sharing


def wrench_set(effect: Floats) -> WrenchSet:
    """Return the attainable sets of rotors with an effectiveness (4, n), as `Vehicle.effectiveness`."""
    whole, lift = _facets(effect), _facets(effect[:3])
    order = _order(effect)
    spare, last = order[:-4], order[-4:]
    single = tuple((rotor, _rest(whole, effect, order[: k + 1])) for k, rotor in enumerate(spare))
    return WrenchSet(
        tilt=_polygon(_facets(effect[1:3])),
        thrust=_range(lift, THRUST),
        thrust_held=_range(whole, THRUST),
        yaw=_range(whole, YAW),
        single=single,
        last=last,
        inverse=np.asarray(np.linalg.inv(effect[:, last]), dtype=np.float64),
        sharing=_sharing(effect),
    )


def limits(vehicle: Vehicle, effectiveness: Components | None = None) -> Components:
    """Limits (..., 2 n) [N] of the thrusts of rotors, all the least ones first."""
    least, most = vehicle.rotors.thrust_range
    if effectiveness is None:
        effectiveness = np.ones(len(vehicle.rotors.positions))
    xp = namespace(effectiveness)
    return xp.concatenate([least * effectiveness, most * effectiveness], axis=-1)


def extremes(over: Range, bounds: Components, others: Components) -> tuple[Scalar, Scalar]:
    """Least and largest value (...) of a component over limits (..., 2 n) and the other components.

    Where the others cannot be had at all, the least may exceed the largest.
    """
    xp = namespace(bounds)
    found = xp.concatenate([bounds, others], axis=-1) @ over.matrix
    return -found[..., over.above :].min(axis=-1), found[..., : over.above].min(axis=-1)


def _facets(directions: Floats) -> Facets:
    """Facets of the zonotope of directions (d, n); opposite ones are both there."""
    size: Floats = np.max(np.abs(directions), axis=1, keepdims=True)
    scaled: Floats = directions / size
    dimension, count = scaled.shape
    found: dict[tuple[float, ...], Floats] = {}
    spans: list[tuple[int, ...]] = [*itertools.combinations([*range(count)], dimension - 1)]
    for span in spans:
        _, values, rows = np.linalg.svd(scaled[:, list(span)].T)
        if values[-1] > _PARALLEL * values[0]:
            normal: Floats = np.where(np.abs(rows[-1]) > _PARALLEL, rows[-1], 0.0)
            normal = normal * np.sign(normal[np.flatnonzero(normal)[0]])
            found.setdefault(tuple((np.round(normal, 9) + 0.0).tolist()), normal)
    half = np.array(list(found.values()))
    normals = np.concatenate([half, -half])
    reach = normals @ scaled
    reach[np.abs(reach) < _PARALLEL] = 0.0
    normals = normals / size.T
    sides = np.concatenate([np.minimum(reach, 0.0), np.maximum(reach, 0.0)], axis=1).T
    return Facets(normals, sides)


def _polygon(facets: Facets) -> Polygon:
    length = np.linalg.norm(facets.normals, axis=1)
    normals, sides = facets.normals / length[:, None], facets.sides / length
    x, y = normals.T
    along = np.outer(x, -y) + np.outer(y, x)  # of edge j's normal with the direction of edge k
    ahead = np.where(np.abs(along) > _PARALLEL, 1.0 / np.where(along == 0.0, 1.0, along), 0.0)
    return Polygon(normals, sides, normals @ normals.T, ahead)


def _sharing(effect: Floats) -> Sharing:
    size: Floats = np.max(np.abs(effect), axis=1)
    scaled = effect / size[:, None]
    pairs = itertools.combinations_with_replacement(range(4), 2)
    return Sharing(np.stack([scaled[a] * scaled[b] for a, b in pairs], axis=1), scaled, size)


def _range(facets: Facets, component: int) -> Range:
    """Range of one component over all others of the facets' space."""
    normals, sides = facets
    return _ranged(normals[:, component], np.delete(normals, component, axis=1), sides)


def _rest(whole: Facets, effect: Floats, taken: tuple[int, ...]) -> Range:
    """Range of the thrust of the last rotor taken, so that those not taken can give the rest of a wrench."""
    count = effect.shape[1]
    sides = whole.sides.copy()
    gone = np.array(taken)
    sides[np.concatenate([gone, gone + count])] = 0.0
    # n . (w - c g) <= what the others reach: g enters like a component, the wrench like the others
    along = -(whole.normals @ effect[:, taken[-1]])
    along[np.abs(along) < _PARALLEL * np.max(np.abs(along))] = 0.0
    return _ranged(along, whole.normals, sides)


def _ranged(along: Floats, others: Floats, sides: Floats) -> Range:
    up, down = np.flatnonzero(along > 0.0), np.flatnonzero(along < 0.0)
    columns = [np.concatenate([sides, -others.T])[:, rows] / np.abs(along[rows]) for rows in (up, down)]
    return Range(np.ascontiguousarray(np.concatenate(columns, axis=1)), len(up))


def _order(effect: Floats) -> tuple[int, ...]:
    """Rotors in an order whose last four are as far from depending on each other as any four are."""
    scaled = effect / np.max(np.abs(effect), axis=1, keepdims=True)
    count = effect.shape[1]
    last = max(
        itertools.combinations(range(count), 4), key=lambda four: abs(np.linalg.det(scaled[:, list(four)]))
    )
    return (*(each for each in range(count) if each not in last), *last)
