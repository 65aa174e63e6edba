"""What a rotor does to gyro and accelerometer: the model on which rotors are judged."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import AnyArray, Array, Components, Float, Scalar, exp, larger, namespace
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import Vehicle

Matrix = Float[AnyArray, "3 n"]


class RotorModel(NamedTuple):
    """Acceleration by each of n rotors, over its thrust in any one unit: newton, share of hover, speed²."""

    angular: Matrix  # about body x, y, z [rad/s² per unit of thrust]
    force: Components  # specific force along body z (n,) [m/s² per unit of thrust]


class Effects(NamedTuple):
    """A `RotorModel` as the law needs it: four channels, three angular ones and the specific force."""

    rows: Array  # (4, n)
    columns: Array  # the same, (n, 4)
    square: Array  # of the rows, element by element
    size: Array  # (4,) the largest effect of a rotor in hover on each channel [rad/s², m/s²]
    hover: Scalar  # thrust of a rotor when all alike carry the weight


def effects_of(model: RotorModel) -> Effects:
    """Return the effects of a model."""
    xp = namespace(model.force)
    rows = xp.concatenate([model.angular, model.force[..., None, :]], axis=-2)
    hover = STANDARD_GRAVITY / model.force.sum(axis=-1)
    size = abs(rows).max(axis=-1) * hover[..., None]
    return Effects(rows, rows.swapaxes(-1, -2), rows * rows, size, hover)


def model_of(vehicle: Vehicle) -> RotorModel:
    """Return the model of a vehicle file; thrust in newton."""
    effect, inertia = vehicle.effectiveness, vehicle.inertia
    return RotorModel(effect[1:] / inertia[..., None], effect[0] / vehicle.mass)


def thrusts_of(vehicle: Vehicle, speeds: Components) -> Components:
    """Thrust [N] (..., n) of healthy rotors at their speeds [rad/s]."""
    return vehicle.rotors.thrust_coefficient * speeds * speeds


def lagged(last: Components, command: Components, lag: Scalar, dt: Scalar) -> Components:
    """Return what follows a command, held for ``dt`` [s], by a first-order lag [s]."""
    return last + (1.0 - exp(-dt / larger(lag, 1e-9))) * (command - last)
