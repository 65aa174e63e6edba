"""The observer isolating in free flight: gusts, drifts, and what the position says of attitude and gyro."""

import functools

import numpy as np
import pytest
from in_c import fly_law

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


@functools.cache
def without_fault(gusts, place, count=2500):
    """Inputs of a vehicle that holds its place, tilted against gusts that push it by 1.3 m/s² at most."""
    rng, inputs = np.random.default_rng(1), []
    size, pace = gusts * np.array([5.0, -5.0, 0.0]) * DEG, np.array([1.9, 2.7, 0.0])
    for index in range(count):
        angles, rates = size * np.sin(pace * index * DT), size * pace * np.cos(pace * index * DT)
        force = to_body(quaternion_from_euler(angles), np.array([0.0, 0.0, STANDARD_GRAVITY]))
        sample = level_sample()._replace(
            q_xyzw=quaternion_from_euler(angles + 0.1 * DEG * rng.standard_normal(3)),
            body_rate=body_rates(angles, rates) + 0.002 * rng.standard_normal(3),
            specific_force=force + 0.02 * rng.standard_normal(3),
        )
        there = np.bool_(place and index % 2 == 0)
        where = PositionSample(0.001 * rng.standard_normal(3) * there, np.zeros(3), there)
        turned = body_rates(angles, rates), body_acceleration(angles, rates, -(pace**2) * angles)
        torque = VEHICLE.inertia * (turned[1] - gyroscopic_acceleration(VEHICLE.inertia, turned[0]))
        torque = torque + VEHICLE.rotational_drag * turned[0]
        inputs.append(FaultObserverInputs(sample, torque, VEHICLE.mass * force[2], where))
    return inputs


def flight(count, change=lambda elapsed, sample: sample, gusts=1.0, place=True):
    """The same with a fault from `BEGIN` on."""
    inputs = without_fault(gusts, place)
    faulty = enumerate(inputs[BEGIN:count])
    return inputs[:BEGIN] + [each._replace(imu=change(index * DT, each.imu)) for index, each in faulty]


LAW = Isolating(vehicle=VEHICLE, position_noise=0.001)


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


def off_for_three_seconds(elapsed, sample):
    """A gyro that comes to be off within 0.3 s, too slowly for a jump, and jumps back."""
    return turning(0, -0.075 * min(elapsed / 0.3, 1.0) * (elapsed < 3.0))(elapsed, sample)


def front_of_a_gust(elapsed):
    # 5 m/s within 0.3 s push the lightest vehicle by 1.75 m/s²: 0.246 / s x 5 m/s + 0.021 / m x (5 m/s)²
    return 0.875 * (1.0 - np.cos(np.pi * min(elapsed / 0.3, 1.0)))


def tilted_and_pushed(elapsed, sample):
    return tilted(0, SLOW)(elapsed, pushed(1, lambda _: 1.0)(elapsed, sample))


drift = pushed(0, lambda elapsed: 0.2 * elapsed)
SLOW, LONG = 0.3 * DEG, BEGIN + 750
STEPS = {0: True, 1: False, 2: True}  # of the accelerometer: axis, and whether there is a position
QUICK = {0: -4.0 * DEG, 1: 1.0 * DEG}  # tilts found before the position can show them
TILTS, TURNS = {0: -SLOW, 1: SLOW}, {0: -SLOW, 1: SLOW}
FLIGHTS = {
    "gusts": {"count": 2500},
    "gusts alone": {"count": 2500, "place": False},
    "front": {"count": BEGIN + 200, "change": pushed(0, front_of_a_gust), "gusts": 0.0, "place": False},
    **{
        f"step {axis}": {"count": BEGIN + 125, "change": pushed(axis, lambda _: -1.0), "place": place}
        for axis, place in STEPS.items()
    },
    "for a while": {"count": BEGIN + 1250, "change": pushed(0, lambda elapsed: float(elapsed < 2.0))},
    "drift": {"count": BEGIN + 1250, "change": drift},
    "drift alone": {"count": BEGIN + 1250, "change": drift, "place": False},
    **{f"tilt {axis}": {"count": LONG, "change": tilted(axis, rate)} for axis, rate in TILTS.items()},
    **{f"quick {axis}": {"count": LONG, "change": tilted(axis, rate)} for axis, rate in QUICK.items()},
    **{f"turn {axis}": {"count": BEGIN + 900, "change": turning(axis, rate)} for axis, rate in TURNS.items()},
    "off": {"count": BEGIN + 1250, "change": off_for_three_seconds},
    "yaw": {"count": LONG, "change": tilted(2, SLOW)},
    "yaw rate": {"count": LONG, "change": turning(2, SLOW)},
    "tilt alone": {"count": LONG, "change": tilted(1, SLOW), "place": False},
    "both": {"count": BEGIN + 500, "change": tilted_and_pushed},
}


@pytest.fixture(scope="module")
def flown():
    """Estimates of all flights by name."""
    return {name: fly_law(LAW, flight(**case), DT)[1] for name, case in FLIGHTS.items()}


@pytest.mark.parametrize("name", ["gusts", "gusts alone", "front"])
def test_gusts_are_no_fault(flown, name):
    assert verdicts(flown[name]) == []


@pytest.mark.parametrize(("axis", "place"), STEPS.items())
def test_a_step_of_the_accelerometer_is_named_at_once(flown, axis, place):
    estimates = flown[f"step {axis}"]
    assert verdicts(estimates) == [f"accelerometer {axis}"]
    assert named(estimates[BEGIN + 4])
    assert estimates[-1].sensors.accelerometer.size[axis] == pytest.approx(-1.0, abs=0.3 if place else 0.8)


def test_an_accelerometer_that_is_well_again_is_trusted_again(flown):
    estimates = flown["for a while"]
    assert named(estimates[BEGIN + 499]) == {"accelerometer 0"}
    assert named(estimates[-1]) == set()


def test_a_position_shows_an_accelerometer_that_drifts(flown):
    assert verdicts(flown["drift"]) == ["accelerometer 0"]
    assert verdicts(flown["drift alone"]) == []


@pytest.mark.parametrize("pace", ["tilt", "quick"])
@pytest.mark.parametrize("axis", TILTS)
def test_a_drifting_tilt_is_the_attitudes(flown, pace, axis):
    estimates = flown[f"{pace} {axis}"]
    assert named(estimates[-1]) == {f"attitude {axis}"}
    assert not any(f"gyro {axis}" in named(each) for each in estimates)


@pytest.mark.parametrize("axis", TURNS)
def test_a_gyro_that_is_slightly_off_is_named(flown, axis):
    estimates = flown[f"turn {axis}"]
    assert any(
        each.sensors.gyro.state[axis] == FAULTY and f"gyro {axis}" in named(each) for each in estimates
    )
    assert not any(f"attitude {axis}" in named(each) for each in estimates)


def test_a_gyro_that_is_off_is_named_until_it_reads_right_again(flown):
    estimates = flown["off"]
    assert all(named(each) == {"gyro 0"} for each in estimates[BEGIN + 250 : BEGIN + 749])
    assert named(estimates[-1]) == set()


@pytest.mark.parametrize("name", ["yaw", "yaw rate"])
def test_yaw_stays_ambiguous(flown, name):
    assert verdicts(flown[name]) == ["attitude 2?", "gyro 2?"]


def test_without_position_a_drift_stays_ambiguous(flown):
    assert verdicts(flown["tilt alone"]) == ["attitude 1?", "gyro 1?"]
