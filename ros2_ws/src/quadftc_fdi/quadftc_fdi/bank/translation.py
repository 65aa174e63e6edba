"""Accelerometer and rotors, judged beside the bank: by thrust, by gravity, by the position.

The rotors come first, as one that loses thrust looks like a jump of gyro and accelerometer. What they give
then drives the bank's motion. While one is suspect, the unknown acceleration may be as large as its own. The
accelerometer comes last, by the attitude that is flown.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank import modes
from quadftc_fdi.bank.hypotheses import Bank
from quadftc_fdi.bank.inference import Posterior
from quadftc_fdi.bank.motion import LOUD
from quadftc_fdi.bank.noise import MEMORY
from quadftc_fdi.bank.trust import Trust
from quadftc_fdi.fault_observer import SHORTEST
from quadftc_fdi.isolation import accelerometer_monitor, free_flight, naming, reading_test, rotor_watch
from quadftc_fdi.isolation.accelerometer_monitor import LEAST, NOISE, AccelerometerMonitor
from quadftc_fdi.isolation.free_flight import FreeFlight
from quadftc_fdi.isolation.reading_test import ReadingTest
from quadftc_fdi.isolation.rotor_watch import RotorWatch
from quadftc_fdi.rotor_diagnosis.monitor import estimate_rotors
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects
from quadftc_model.arrays import (
    Flag,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    column,
    components,
    exp,
    larger,
    log,
    namespace,
    smaller,
    stacked,
    where,
)
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.samples import (
    FAULT_KINDS,
    FAULTY,
    STANDARD_GRAVITY,
    FaultObserverInputs,
    RotorEstimate,
    SensorEstimate,
)
from quadftc_model.vehicle import Vehicle

UNTESTED = 1e6  # m²/s⁴; mark: variance of a prediction that tests nothing
EVERY = slice(0, 3)
OFFSET = FAULT_KINDS.index("offset")
ACCELEROMETER = modes.KINDS[modes.FELT]  # how often it is faulty, and by what tilt
RIVAL = math.log(ACCELEROMETER.rate / 3600.0 * MEMORY)  # 1; derived: log of the odds of that in `MEMORY`


class Translation(NamedTuple):
    """What is known of accelerometer and rotors."""

    readings: ReadingTest  # of the accelerometer
    accelerometer: AccelerometerMonitor
    flight: FreeFlight | None  # None on the test stand
    rotors: RotorWatch | None  # None on the test stand
    pushing: Vector  # variance of the force by a suspect rotor [m²/s⁴]


def start_translation(
    vehicle: Vehicle, law: PositionEstimator, effects: Effects, inputs: FaultObserverInputs
) -> Translation:
    """Start at a sample."""
    imu, flight, rotors = inputs.imu, None, None
    if inputs.thrust is not None:
        flight = free_flight.start_flight(law, free_flight.motion_inputs(inputs), inputs.thrust)
    if inputs.rotors is not None:
        rotors = rotor_watch.start_watch(vehicle, effects, imu, inputs.rotors)
    force = imu.specific_force
    readings = reading_test.start_test(force, NOISE)
    none = namespace(force).zeros_like(force)
    return Translation(readings, accelerometer_monitor.start_accelerometer(force), flight, rotors, none)


def judge_rotors(
    state: Translation,
    vehicle: Vehicle,
    effects: Effects,
    inputs: FaultObserverInputs,
    rate: Vector,
    vague: Vector,
    known: Vector,
    dt: Scalar,
) -> tuple[Translation, FaultObserverInputs, Vector]:
    """Judge the rotors; return the torque and thrust that they give, and what they may give besides.

    ``rate`` is the gyro's [rad/s], or another one of a variance ``vague`` [rad²/s²]; ``known`` the
    acceleration by all but the rotors [rad/s²]. What they may give is a variance of it [rad²/s⁴].
    """
    xp = namespace(rate)
    none = xp.zeros_like(rate)
    if state.rotors is None or inputs.rotors is None:
        return state, inputs, none
    deaf = state.accelerometer.faulty[..., 2]
    rotors, acts = rotor_watch.step_watch(
        state.rotors, vehicle, effects, inputs, inputs.rotors, rate, vague, known, deaf, dt
    )
    # without a gyro nothing tells a rotor from the accelerometer
    unsure = where(inputs.imu.rate_valid, acts.pushing, STANDARD_GRAVITY**2)
    pushing = xp.concatenate([none[..., :2], column(unsure)], axis=-1)
    state = state._replace(rotors=rotors, pushing=pushing)
    return state, inputs._replace(torque=acts.torque, thrust=acts.thrust), acts.turning


def ask_position(state: Translation, bank: Bank, posterior: Posterior) -> tuple[Posterior, Mask]:
    """Weigh faults of the attitude by the tilt that the position shows; also return where it does (..., 3).

    That tilt follows a fault b + s t late (`free_flight`). An offset of the accelerometer shows as one, too,
    until it is learned: that is the rival of each. What it shows of a fault that is believed is taken
    off, and as large again is the doubt: a yaw that is off turns the force, too.
    """
    xp, flight = namespace(bank.age), state.flight
    if flight is None:
        return posterior, state.accelerometer.faulty & False
    tilt, own, counts = (part[..., None] for part in free_flight.tilt_of(flight, state.accelerometer))
    shown = flight.due[..., None]
    tilt, own = tilt - shown, own + (shown * shown).sum(axis=-2, keepdims=True)
    age = larger(bank.age[..., EVERY, :], 0.0)
    lag = column(column(larger(free_flight.lag_of(flight), SHORTEST)))
    of_size = 1.0 - exp(-age / lag)
    of_slope = age - lag * of_size
    either, usual = own + ACCELEROMETER.size**2, smaller(tilt * tilt / own, LOUD)
    rival = 0.5 * (usual - tilt * tilt / either - log(either / own)) + RIVAL
    weights = [posterior.log_weight[..., 3 * kind : 3 * kind + 3, :] for kind in range(len(modes.KINDS))]
    for kind in (modes.ATTITUDE, modes.CREEP):
        of_kind = slice(3 * kind, 3 * kind + 3)
        b, C = posterior.b[..., of_kind, :], posterior.covariance[..., of_kind, :]
        due = of_size * b[..., 0, :, :] + of_slope * b[..., 1, :, :]
        spread = of_size**2 * C[..., 0, :, :] + 2.0 * of_size * of_slope * C[..., 1, :, :]
        both = own + larger(spread + of_slope**2 * C[..., 2, :, :], 0.0)
        fits = smaller((tilt - due) ** 2 / both, LOUD) + log(both / own)
        said = where(counts, 0.5 * (usual - fits) - log(1.0 + exp(rival)), 0.0)
        weights[kind] = weights[kind] + said
    weight = xp.concatenate(weights, axis=-2)
    return posterior._replace(log_weight=weight), counts[..., 0]


def noise_of_force(state: Translation) -> Vector:
    """Return the variance of the accelerometer's noise [m²/s⁴]."""
    return larger(state.readings.variance, LEAST**2)


def follow_fault(
    state: Translation, off: Vector, attitude: Trust, before: Mask, stuck: Mask, dt: Scalar
) -> Translation:
    """Follow the tilt that the position shows of an attitude that is ``off`` [rad] where it is not believed.

    ``before``: it was not at the last sample, either.
    """
    if state.flight is None:
        return state
    size = where(attitude.faulty | stuck, off, 0.0)
    new = attitude.faulty & ~before
    return state._replace(flight=free_flight.follow_tilt(state.flight, size, attitude.age, new, dt))


def judge_accelerometer(
    state: Translation,
    vehicle: Vehicle,
    law: PositionEstimator,
    inputs: FaultObserverInputs,
    q_xyzw: Quaternion,
    doubtful: Mask,
    knows: bool,
    dt: float,
) -> Translation:
    """Judge the accelerometer at an attitude; ``doubtful``: that or the gyro is in doubt.

    Unless the observer ``knows`` what it should feel, only a stuck or absent one is faulty: drag is large.
    """
    imu, monitor, flight = inputs.imu, state.accelerometer, state.flight
    force, there = imu.specific_force, stacked([imu.force_valid] * 3)
    known = column(inputs.driven) & knows
    doubtful = doubtful | ~known
    if flight is not None:
        flight = flight._replace(unsure=larger(flight.unsure, state.pushing))
    flight, off, unsure = free_flight.force_deviation(flight, monitor, vehicle, inputs, q_xyzw, dt)
    noise, predicted = noise_of_force(state), unsure + UNTESTED * ~known
    readings = state.readings._replace(held=state.readings.held + state.pushing)
    readings, verdict = reading_test.test_reading(readings, force, there, off**2, predicted, noise, 0.0, dt)
    seen = off, noise, readings.suspicion, there, verdict, doubtful, dt
    if flight is None:
        monitor, learned = accelerometer_monitor.step_accelerometer(monitor, *seen)
    else:
        flight, monitor, learned = free_flight.step_flight(
            flight, law, monitor, free_flight.motion_inputs(inputs), *seen
        )
    learned = learned | (there & (not knows))  # time goes on
    readings = reading_test.learn_noise(readings, off**2, predicted, learned, LEAST**2, dt)
    return state._replace(readings=readings, accelerometer=monitor, flight=flight)


def say(state: Translation, felt: Trust, valid: Flag) -> tuple[SensorEstimate, RotorEstimate | None]:
    """Say what is known of accelerometer and rotors; ``valid``: there is a specific force.

    The accelerometer is faulty by its own test, or as the tilt that is ``felt`` is not that of the motion.
    """
    said = naming.name_accelerometer(state.accelerometer, state.readings, EVERY, valid)
    roll, pitch, yaw = components(where(felt.faulty, felt.size, 0.0) * STANDARD_GRAVITY)
    age, by_tilt = (
        part[..., np.array([1, 0, 2])] for part in (felt.age, felt.faulty & (said.onset_age < 0.0))
    )
    accelerometer = said._replace(
        state=where(by_tilt, FAULTY, said.state).astype(said.state.dtype),
        size=where(by_tilt, stacked([-pitch, roll, yaw]), said.size),
        onset_age=where(by_tilt, age, said.onset_age),
        probability=where(by_tilt, 1.0, said.probability),
        kind=where(by_tilt, OFFSET, said.kind).astype(said.kind.dtype),
    )
    return accelerometer, None if state.rotors is None else estimate_rotors(state.rotors.monitor)
