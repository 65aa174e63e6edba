r"""Which rotors that lose thrust look alike to gyro and accelerometer, whatever the algorithm.

A loss s_i >= 0 of rotor i moves the angular acceleration and the specific force by -b_i s_i, in hover, where
all rotors give the same thrust. Two sets of rotors A and B look alike if there are losses, all positive, with

    sum_{i in A} b_i s_i = sum_{j in B} b_j s_j

A and B have no rotor in common, as its loss would cancel. It is a linear programme for each pair of sets.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from quadftc_model.vehicle import Vehicle

Sets = tuple[tuple[int, ...], tuple[int, ...]]

TOLERANCE = 1e-9  # 1; a share of a loss, and a residual over the largest effect, that are none


def effects_in_hover(vehicle: Vehicle, accelerometer: bool = True) -> NDArray[np.float64]:
    """Angular acceleration and, with an accelerometer, specific force of each rotor, (4 or 3, n)."""
    thrust, torque = vehicle.effectiveness[:1], vehicle.effectiveness[1:]
    turning = torque / np.asarray(vehicle.inertia)[:, None]
    return np.concatenate([turning, thrust / vehicle.mass]) if accelerometer else turning


def alike(effects: NDArray[np.float64], most: int = 2) -> list[Sets]:
    """Return the pairs of sets of up to ``most`` rotors, numbered from 1, that look alike."""
    unit = effects / np.max(np.abs(effects), axis=1, keepdims=True)
    numbers = range(1, unit.shape[1] + 1)
    return [pair for pair in _disjoint_pairs(numbers, most) if _look_alike(unit, *pair)]


def largest_cosine(effects: NDArray[np.float64]) -> float:
    """Return the cosine of the smallest angle between what two rotors do, each channel over its largest."""
    unit = effects / np.max(np.abs(effects), axis=1, keepdims=True)
    unit = unit / np.linalg.norm(unit, axis=0)
    return float(np.max((unit.T @ unit)[~np.eye(unit.shape[1], dtype=bool)]))


def _disjoint_pairs(numbers: Sequence[int], most: int) -> Iterator[Sets]:
    sets = [each for size in range(1, most + 1) for each in itertools.combinations(numbers, size)]
    for one, other in itertools.combinations(sets, 2):
        if not set(one) & set(other):
            yield one, other


def _look_alike(unit: NDArray[np.float64], one: Sequence[int], other: Sequence[int]) -> bool:
    """Whether some positive losses of both sets have the same effect: maximise the smallest of them."""
    columns = np.array([*one, *other]) - 1
    signs = np.repeat([1.0, -1.0], [len(one), len(other)])
    effect = np.column_stack([unit[:, columns] * signs, np.zeros(len(unit))])
    total = np.append(np.ones(len(columns)), 0.0)
    smallest = np.column_stack([-np.eye(len(columns)), np.ones(len(columns))])
    found: Any = linprog(
        np.append(np.zeros(len(columns)), -1.0),
        A_ub=smallest,
        b_ub=np.zeros(len(columns)),
        A_eq=np.vstack([effect, total]),
        b_eq=np.append(np.zeros(len(unit)), 1.0),
    )
    return bool(found.success and -found.fun > TOLERANCE)
