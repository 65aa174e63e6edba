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
from quadftc_model.arrays import (
    Components,
    Flag,
    Scalar,
    Vector,
    any_of,
    changed_where,
    components,
    larger,
    largest,
    stacked,
)
from quadftc_model.samples import FaultObserverInputs, RotorEstimate
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


def start_watch(vehicle: Vehicle, effects: Effects, inputs: FaultObserverInputs) -> RotorWatch | None:
    """Start at a sample; None where nothing is known of the rotors."""
    if inputs.rotors is None:
        return None
    commanded, measured = inputs.rotors
    speeds = commanded if measured is None else measured
    seen = _inputs(vehicle, inputs, speeds, commanded, 0.0 * inputs.torque, True)
    return RotorWatch(start_rotors(effects, seen), commanded, speeds)


def step_watch(
    state: RotorWatch,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    rate: Vector,
    known: Vector,
    healthy: Flag,
    dt: float,
) -> tuple[RotorWatch, Acts]:
    """Advance by ``dt`` [s] to a sample; also return what the rotors give.

    ``rate`` is the gyro's, less its known errors [rad/s]; ``known`` the angular acceleration by all but the
    rotors [rad/s²]; ``healthy``: neither gyro nor accelerometer were faulty.
    """
    assert inputs.rotors is not None
    command, measured = inputs.rotors
    commanded = lagged(state.commanded, command, vehicle.rotors.time_constant, dt)
    speeds = commanded if measured is None else measured
    swirl = _swirl(vehicle, state.speeds, speeds, rate, dt)
    cleared = inputs._replace(imu=inputs.imu._replace(body_rate=rate))
    seen = _inputs(vehicle, cleared, speeds, commanded, known + swirl / vehicle.inertia, healthy)
    monitor = step_rotors(state.monitor, effects, seen, dt)
    acts = _acting(monitor, state.monitor.thrusts, vehicle, effects, inputs, swirl)
    return RotorWatch(monitor, commanded, speeds), acts


def _swirl(vehicle: Vehicle, last: Components, speeds: Components, rate: Vector, dt: float) -> Vector:
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
    return stacked([0.0 * yaw, 0.0 * yaw, yaw])


def _acting(
    monitor: RotorMonitor,
    before: Components,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    swirl: Vector,
) -> Acts:
    """Return what the rotors give, after thrusts of ``before`` [N].

    Measured speeds say it. Else it is what is commanded, less the losses.
    """
    assert inputs.rotors is not None
    command, measured = inputs.rotors
    torque, thrust = inputs.torque, inputs.thrust
    if measured is not None:
        wrench = _wrench(vehicle, 0.5 * (before + monitor.thrusts))
        torque, thrust = wrench[..., 1:] + swirl, monitor.thrusts.sum(axis=-1)
    zeros = 0.0 * torque

    def weakened() -> tuple[Vector, Scalar | None, Vector, Scalar]:
        commanded, lost = thrusts_of(vehicle, command), monitor.losses.mean
        mean, now = commanded, commanded
        if measured is not None:
            mean, now = 0.5 * (before + monitor.thrusts), monitor.thrusts
        variance = (effects.square * ((commanded * monitor.unsure) ** 2)[..., None, :]).sum(axis=-1)
        # nor is the inertia of a rotor known well that is sped up by much
        kick = swirl if measured is not None else _kick(vehicle, command)
        turning = variance[..., :3] + any_of(monitor.unsure) * (kick / vehicle.inertia) ** 2
        left = None if thrust is None else thrust - (now * lost).sum(axis=-1)
        return torque - _wrench(vehicle, mean * lost)[..., 1:], left, turning, variance[..., 3]

    given = torque, thrust, zeros, zeros[..., 2]
    return Acts(*changed_where(monitor.named | monitor.unsure, weakened, given))


def say_rotors(state: RotorWatch | None) -> RotorEstimate | None:
    """Say what is known of each rotor."""
    return None if state is None else estimate_rotors(state.monitor)


def _inputs(
    vehicle: Vehicle,
    inputs: FaultObserverInputs,
    speeds: Components,
    commanded: Components,
    known: Vector,
    healthy: Flag | bool,
) -> RotorInputs:
    imu, rotors = inputs.imu, inputs.rotors
    assert rotors is not None
    usable = imu.rate_valid & imu.force_valid & healthy
    thrusts, force = thrusts_of(vehicle, speeds), imu.specific_force[..., 2]
    wanted = None if rotors.speeds is None else thrusts_of(vehicle, commanded)
    return RotorInputs(thrusts, imu.body_rate, force, known, usable, wanted)


def _wrench(vehicle: Vehicle, thrusts: Components) -> Components:
    """Thrust [N] and torque [N m] of the rotors' thrusts [N], (..., 4)."""
    return (vehicle.effectiveness * thrusts[..., None, :]).sum(axis=-1)
