r"""The rotors among the other suspects of `isolating`: what they may do to gyro and accelerometer.

`rotor_diagnosis` judges the rotors by gyro and accelerometer, before these are judged. It is asked first, as
a rotor that loses thrust looks like a jump of both. While a rotor is suspect, the unknown acceleration may be
as large as what it gives: the sample is then no evidence against a sensor. Once it is named, torque and
thrust are those that the rotors really give. Where the gyro is not believed, a rate by attitude and torque
stands in.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_fdi.rotor_diagnosis.monitor import RotorInputs, RotorMonitor, start_rotors, step_rotors
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects, lagged, thrusts_of
from quadftc_model.arrays import (
    Array,
    Components,
    Flag,
    Scalar,
    Vector,
    any_of,
    column,
    components,
    larger,
    largest,
    namespace,
    stacked,
    where,
)
from quadftc_model.samples import FaultObserverInputs, ImuSample, RotorReading
from quadftc_model.vehicle import Vehicle


class RotorWatch(NamedTuple):
    """What is known of the rotors, and what they are told."""

    monitor: RotorMonitor
    commanded: Components  # speeds, behind their lag (..., n) [rad/s]
    speeds: Components  # measured; or else those (..., n) [rad/s]


class Acts(NamedTuple):
    """What the rotors give, as far as known."""

    torque: Vector  # [N m]
    thrust: Scalar | None  # [N]
    turning: Vector  # variance of the acceleration that they may give besides [rad²/s⁴]
    pushing: Scalar  # the same of the specific force along z [m²/s⁴]


def start_watch(vehicle: Vehicle, effects: Effects, imu: ImuSample, rotors: RotorReading) -> RotorWatch:
    """Start at a sample."""
    speeds = where(column(rotors.measured), rotors.speeds, rotors.command)
    none = namespace(imu.body_rate).zeros_like(imu.body_rate)
    seen = _inputs(vehicle, imu, rotors, speeds, rotors.command, none, none, ~imu.force_valid)
    return RotorWatch(start_rotors(effects, seen), rotors.command, speeds)


def step_watch(
    state: RotorWatch,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    rotors: RotorReading,
    rate: Vector,
    vague: Vector,
    known: Vector,
    faulty: Flag,
    dt: Scalar,
) -> tuple[RotorWatch, Acts]:
    """Advance by ``dt`` [s] to a sample; also return what the rotors give.

    ``rate`` is the gyro's, less its known errors [rad/s]; where it is not believed, another one of a variance
    ``vague`` [rad²/s²], which is 0 elsewhere. ``known`` is the angular acceleration by all but the rotors
    [rad/s²]; ``faulty``: z of the accelerometer was.
    """
    commanded = lagged(state.commanded, rotors.command, vehicle.rotors.time_constant, dt)
    speeds = where(column(rotors.measured), rotors.speeds, commanded)
    swirl = _swirl(vehicle, state.speeds, speeds, rate, dt)
    known = known + swirl / vehicle.inertia
    imu = inputs.imu._replace(body_rate=rate)
    monitor = step_rotors(
        state.monitor, effects, _inputs(vehicle, imu, rotors, speeds, commanded, vague, known, faulty), dt
    )
    acts = _acting(monitor, state.monitor.thrusts, vehicle, effects, inputs, rotors, swirl)
    return RotorWatch(monitor, commanded, speeds), acts


def _swirl(vehicle: Vehicle, last: Components, speeds: Components, rate: Vector, dt: Scalar) -> Vector:
    """Torque [N m] of rotors that are sped up, and that are turned with their angular momentum."""
    rotors = vehicle.rotors
    spun, earlier = (rotors.spin_sign * speeds).sum(axis=-1), (rotors.spin_sign * last).sum(axis=-1)
    momentum = rotors.rotor_inertia * spun
    faster = rotors.rotor_inertia * (spun - earlier) / larger(dt, 1e-6)
    p, q, _ = components(rate)
    return stacked([-q * momentum, p * momentum, -faster])


def _kick(vehicle: Vehicle, speeds: Components) -> Vector:
    """Torque [N m] of the fastest rotor, if it is switched off."""
    yaw = vehicle.rotors.rotor_inertia * largest(speeds) / larger(vehicle.rotors.time_constant, 1e-3)
    none = namespace(yaw).zeros_like(yaw)
    return stacked([none, none, yaw])


def _acting(
    monitor: RotorMonitor,
    before: Components,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    rotors: RotorReading,
    swirl: Vector,
) -> Acts:
    """Return what the rotors give, after thrusts of ``before`` [N].

    Measured speeds say it. Else it is what is commanded, less the losses.
    """
    measured, told, lost = column(rotors.measured), thrusts_of(vehicle, rotors.command), monitor.losses.mean
    mean = where(measured, 0.5 * (before + monitor.thrusts), told)
    now = where(measured, monitor.thrusts, told)
    torque = where(measured, _wrench(vehicle, mean)[..., 1:] + swirl, inputs.torque)
    thrust = inputs.thrust
    if thrust is not None:
        thrust = where(rotors.measured, now.sum(axis=-1), thrust) - (now * lost).sum(axis=-1)
    variance = (told * monitor.unsure) ** 2 @ effects.square.T
    # nor is the inertia of a rotor known well that is sped up by much
    kick = where(measured, swirl, _kick(vehicle, rotors.command))
    turning = variance[..., :3] + any_of(monitor.unsure) * (kick / vehicle.inertia) ** 2
    return Acts(torque - _wrench(vehicle, mean * lost)[..., 1:], thrust, turning, variance[..., 3])


def _inputs(
    vehicle: Vehicle,
    imu: ImuSample,
    rotors: RotorReading,
    speeds: Components,
    commanded: Components,
    vague: Vector,
    known: Vector,
    faulty: Flag,
) -> RotorInputs:
    thrusts, wanted = thrusts_of(vehicle, speeds), thrusts_of(vehicle, commanded)
    force = imu.specific_force[..., 2]
    deaf = faulty | ~imu.force_valid
    return RotorInputs(thrusts, imu.body_rate, vague, force, known, deaf, wanted, rotors.measured)


def _wrench(vehicle: Vehicle, thrusts: Components) -> Array:
    """Thrust [N] and torque [N m] of the rotors' thrusts [N], (..., 4)."""
    return thrusts @ vehicle.effectiveness.T
