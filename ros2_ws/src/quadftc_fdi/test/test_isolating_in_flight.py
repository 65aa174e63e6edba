"""The observer isolating in free flight: gusts, drifts, and what the position says of attitude and gyro."""

import jax
import numpy as np
import pytest

from quadftc_fdi.fault_observers.isolating import Isolating
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import (
    body_acceleration,
    body_rates,
    euler_from_quaternion,
    quaternion_from_euler,
    to_body,
)
from quadftc_model.samples import (
    ALARMS,
    FAULTY,
    STANDARD_GRAVITY,
    FaultObserverInputs,
    PositionSample,
    level_sample,
)
from quadftc_model.vehicle import load_vehicle

DEG = np.pi / 180.0
DT = 0.004
BEGIN = 1250  # the sample at which faults begin
VEHICLE = load_vehicle("x500")
SENSORS = ("attitude", "gyro", "accelerometer")


def flight(count, change=lambda elapsed, sample: sample, gusts=1.0, place=True, seed=1):
    """Inputs of a vehicle that holds its place, tilted against gusts that push it by 1.3 m/s² at most."""
    rng, inputs = np.random.default_rng(seed), []
    size, pace = gusts * np.array([5.0, -5.0, 0.0]) * DEG, np.array([1.9, 2.7, 0.0])
    for index in range(count):
        angles, rates = size * np.sin(pace * index * DT), size * pace * np.cos(pace * index * DT)
        force = to_body(quaternion_from_euler(angles), np.array([0.0, 0.0, STANDARD_GRAVITY]))
        sample = level_sample()._replace(
            q_xyzw=quaternion_from_euler(angles + 0.1 * DEG * rng.standard_normal(3)),
            body_rate=body_rates(angles, rates) + 0.002 * rng.standard_normal(3),
            specific_force=force + 0.02 * rng.standard_normal(3),
        )
        if index >= BEGIN:
            sample = change((index - BEGIN) * DT, sample)
        there = np.bool_(place and index % 2 == 0)
        where = PositionSample(0.001 * rng.standard_normal(3) * there, np.zeros(3), there)
        turned = body_rates(angles, rates), body_acceleration(angles, rates, -(pace**2) * angles)
        torque = VEHICLE.inertia * (turned[1] - gyroscopic_acceleration(VEHICLE.inertia, turned[0]))
        torque = torque + VEHICLE.rotational_drag * turned[0]
        inputs.append(FaultObserverInputs(sample, torque, VEHICLE.mass * force[2], where))
    return inputs


def diagnose(inputs):
    """Estimates of a flight."""
    law = Isolating(vehicle=VEHICLE, position_noise=0.001)
    state, first = law.step(law.init(inputs[0]), inputs[0], 0.0)
    estimates = [first]
    for each in inputs[1:]:
        state, estimate = law.step(state, each, DT)
        estimates.append(estimate)
    return estimates


def named(estimate):
    """Sensors and axes that are said to be faulty; "?": it may be another."""
    found = set()
    for name in SENSORS:
        sensor = getattr(estimate.sensors, name)
        for axis in np.flatnonzero(np.isin(sensor.state, ALARMS)).tolist():
            found.add(f"{name} {axis}{'?' * bool(sensor.ambiguous[axis])}")
    return found


def verdicts(estimates):
    """All that is named in some estimates, each once, in order."""
    return list(dict.fromkeys(name for each in estimates for name in sorted(named(each))))


def pushed(axis, offset):
    """A fault of the accelerometer, a function of the time elapsed [m/s²]."""
    return lambda elapsed, sample: sample._replace(
        specific_force=sample.specific_force + offset(elapsed) * np.eye(3)[axis]
    )


def tilted(axis, rate):
    """A drift of the attitude [rad/s]."""

    def change(elapsed, sample):
        angles = euler_from_quaternion(sample.q_xyzw) + rate * elapsed * np.eye(3)[axis]
        return sample._replace(q_xyzw=quaternion_from_euler(angles))

    return change


def turning(axis, offset):
    """A gyro that is off [rad/s]."""
    return lambda _, sample: sample._replace(body_rate=sample.body_rate + offset * np.eye(3)[axis])


@pytest.mark.parametrize("place", [True, False])
def test_gusts_are_no_fault(place):
    assert verdicts(diagnose(flight(2500, place=place))) == []


def test_the_front_of_a_gust_is_no_fault():
    # 5 m/s within 0.3 s push the lightest vehicle by 1.75 m/s²: 0.246 / s x 5 m/s + 0.021 / m x (5 m/s)²
    front = pushed(0, lambda elapsed: 0.875 * (1.0 - np.cos(np.pi * min(elapsed / 0.3, 1.0))))
    assert verdicts(diagnose(flight(BEGIN + 200, front, gusts=0.0, place=False))) == []


@pytest.mark.parametrize(("axis", "place"), [(0, True), (1, False), (2, True)])
def test_a_step_of_the_accelerometer_is_named_at_once(axis, place):
    estimates = diagnose(flight(BEGIN + 125, pushed(axis, lambda _: -1.0), place=place))
    assert verdicts(estimates) == [f"accelerometer {axis}"]
    assert named(estimates[BEGIN + 4])
    assert estimates[-1].sensors.accelerometer.size[axis] == pytest.approx(-1.0, abs=0.3 if place else 0.8)


def test_an_accelerometer_that_is_well_again_is_trusted_again():
    estimates = diagnose(flight(BEGIN + 1250, pushed(0, lambda elapsed: float(elapsed < 2.0))))
    assert named(estimates[BEGIN + 499]) == {"accelerometer 0"}
    assert named(estimates[-1]) == set()


def test_a_position_shows_an_accelerometer_that_drifts():
    inputs = flight(BEGIN + 1250, pushed(0, lambda elapsed: 0.2 * elapsed))
    assert verdicts(diagnose(inputs)) == ["accelerometer 0"]
    blind = [each._replace(position=each.position._replace(there=np.False_)) for each in inputs]
    assert verdicts(diagnose(blind)) == []


@pytest.mark.parametrize(("axis", "rate"), [(0, -0.3 * DEG), (1, 0.3 * DEG)])
def test_a_drifting_tilt_is_the_attitudes(axis, rate):
    estimates = diagnose(flight(BEGIN + 750, tilted(axis, rate)))
    assert named(estimates[-1]) == {f"attitude {axis}"}
    assert not any(f"gyro {axis}" in named(each) for each in estimates)


@pytest.mark.parametrize(("axis", "offset"), [(0, -0.3 * DEG), (1, 0.3 * DEG)])
def test_a_gyro_that_is_slightly_off_is_named(axis, offset):
    estimates = diagnose(flight(BEGIN + 750, turning(axis, offset)))
    assert any(
        each.sensors.gyro.state[axis] == FAULTY and f"gyro {axis}" in named(each) for each in estimates
    )
    assert not any(f"attitude {axis}" in named(each) for each in estimates)


@pytest.mark.parametrize("fault", [tilted(2, 0.3 * DEG), turning(2, 0.3 * DEG)])
def test_yaw_stays_ambiguous(fault):
    estimates = diagnose(flight(BEGIN + 750, fault))
    assert verdicts(estimates) == ["attitude 2?", "gyro 2?"]


def test_without_position_a_drift_stays_ambiguous():
    estimates = diagnose(flight(BEGIN + 750, tilted(1, 0.3 * DEG), place=False))
    assert verdicts(estimates) == ["attitude 1?", "gyro 1?"]


def test_jax_gives_the_same_numbers():
    jax.config.update("jax_enable_x64", True)
    faults = [pushed(1, lambda _: 1.0), tilted(0, 0.3 * DEG)]
    inputs = flight(BEGIN + 500, lambda elapsed, sample: faults[1](elapsed, faults[0](elapsed, sample)))
    law = Isolating(vehicle=VEHICLE, position_noise=0.001)

    @jax.jit
    def fly(first, rest):
        state, _ = law.step(law.init(first), first, 0.0)
        return jax.lax.scan(lambda state, each: law.step(state, each, DT), state, rest)[1]

    found = fly(inputs[0], jax.tree.map(lambda *rows: np.stack(rows), *inputs[1:]))
    wanted = jax.tree.map(lambda *rows: np.stack(rows), *diagnose(inputs)[1:])
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-9)
