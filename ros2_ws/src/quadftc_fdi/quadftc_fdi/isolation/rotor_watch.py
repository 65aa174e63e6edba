r"""The rotors among the other suspects of `isolating`: what they may do to gyro and accelerometer.

`rotor_diagnosis` judges the rotors by gyro and accelerometer, before these are judged. It is asked first, as
a rotor that loses thrust looks like a jump of both. While a rotor is suspect, the unknown acceleration may be
as large as what it gives: the sample is then no evidence against a sensor. Once it is named, torque and
thrust are those that the rotors really give. While gyro or accelerometer are faulty, no rotor is judged.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.rotor_diagnosis.monitor import (
    RotorInputs,
    RotorMonitor,
    estimate_rotors,
    start_rotors,
    step_rotors,
)
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects, lagged, thrusts_of
from quadftc_model.arrays import Array, Components, Flag, Scalar, Vector, changed_where, namespace
from quadftc_model.samples import FaultObserverInputs, RotorEstimate
from quadftc_model.vehicle import Vehicle


class RotorWatch(NamedTuple):
    """What is known of the rotors, and what they are told."""

    monitor: RotorMonitor
    speeds: Components  # commanded, behind their lag (..., n) [rad/s]


class Acts(NamedTuple):
    """What the rotors give, as far as known."""

    torque: Vector  # [N m]
    thrust: Scalar | None  # [N]
    turning: Vector  # variance of the acceleration that they may give besides [rad²/s⁴]
    pushing: Scalar  # the same of the specific force along z [m²/s⁴]


def start_watch(vehicle: Vehicle, effects: Effects, inputs: FaultObserverInputs) -> RotorWatch | None:
    """Start at a sample; None where nothing is known of the rotors."""
    if inputs.rotors is None:
        return None
    speeds = inputs.rotors.command
    return RotorWatch(
        start_rotors(effects, _inputs(vehicle, inputs, speeds, 0.0 * inputs.torque, True)), speeds
    )


def step_watch(
    state: RotorWatch,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    rate: Vector,
    known: Vector,
    healthy: Flag,
    dt: float,
) -> RotorWatch:
    """Advance by ``dt`` [s] to a sample.

    ``rate`` is the gyro's, less its known errors [rad/s]; ``known`` the angular acceleration by all but the
    rotors [rad/s²]; ``healthy``: neither gyro nor accelerometer were faulty.
    """
    assert inputs.rotors is not None
    speeds = lagged(state.speeds, inputs.rotors.command, vehicle.rotors.time_constant, dt)
    seen = _inputs(vehicle, inputs._replace(imu=inputs.imu._replace(body_rate=rate)), speeds, known, healthy)
    return RotorWatch(step_rotors(state.monitor, effects, seen, dt), speeds)


def acting(state: RotorWatch, vehicle: Vehicle, effects: Effects, inputs: FaultObserverInputs) -> Acts:
    """Return what the rotors give, commanded a torque and a thrust."""
    assert inputs.rotors is not None
    monitor, said = state.monitor, estimate_rotors(state.monitor)
    commanded = thrusts_of(vehicle, inputs.rotors.command)
    zeros = 0.0 * inputs.torque
    as_told = inputs.torque, inputs.thrust, zeros, zeros[..., 2]
    lost = commanded * (1.0 - said.effectiveness)

    def weakened() -> tuple[Vector, Scalar | None, Vector, Scalar]:
        wrench = (vehicle.effectiveness * lost[..., None, :]).sum(axis=-1)
        thrust = None if inputs.thrust is None else inputs.thrust - wrench[..., 0]
        variance = _variance(effects, commanded * monitor.unsure)
        return inputs.torque - wrench[..., 1:], thrust, variance[..., :3], variance[..., 3]

    return Acts(*changed_where((lost != 0.0) | monitor.unsure, weakened, as_told))


def say_rotors(state: RotorWatch | None) -> RotorEstimate | None:
    """Say what is known of each rotor."""
    return None if state is None else estimate_rotors(state.monitor)


def _inputs(
    vehicle: Vehicle, inputs: FaultObserverInputs, speeds: Components, known: Vector, healthy: Flag | bool
) -> RotorInputs:
    imu, rotors = inputs.imu, inputs.rotors
    assert rotors is not None
    usable = imu.rate_valid & imu.force_valid & healthy
    wanted, measured = thrusts_of(vehicle, speeds), rotors.speeds
    force = imu.specific_force[..., 2]
    if measured is None:
        return RotorInputs(wanted, imu.body_rate, force, known, usable)
    return RotorInputs(thrusts_of(vehicle, measured), imu.body_rate, force, known, usable, wanted)


def _variance(effects: Effects, thrusts: Array) -> Array:
    """Square of what some thrusts do to each channel (..., 4)."""
    return namespace(thrusts).sum(effects.square * (thrusts * thrusts)[..., None, :], axis=-1)
