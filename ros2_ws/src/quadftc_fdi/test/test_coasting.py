"""Without the attitude: gravity holds the tilt where it can be believed, and the gyro is learned."""

import math

import numpy as np
import pytest
from in_c import as_flown, fly_arrays

from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_fdi.supervision import gravity
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import quaternion_from_euler, rotation_between, to_body, turn
from quadftc_model.samples import STANDARD_GRAVITY, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

DEG, SCALE = math.pi / 180.0, 6  # place of the scale error about x in the filter's covariance
DT, FAULT, END = 0.02, 20.0, 40.0  # s
TIME = np.arange(round(END / DT)) * DT
UP = np.array([0.0, 0.0, STANDARD_GRAVITY])
OBSERVER = Supervised(vehicle=load_vehicle("qball_x4"))
OFF = np.array([0.5, -0.4, 0.0])  # m/s²; an accelerometer that is off by 2.9 and 2.3 deg
# how fast a vehicle goes back and forth [m/s], what share its gyro reads too little, its rate of roll [rad/s]
# during the fault, what its accelerometer reads in place of the specific force or in addition to it
FLIGHTS = {
    "rests": (0.0, 0.01, 1.5, {}),
    "moves": (0.3, 0.01, 1.5, {}),
    "moves fast": (1.0, 0.01, 1.5, {}),
    "no accelerometer": (0.3, 0.01, 1.5, {"there": False}),
    "reads zero": (0.3, 0.01, 1.5, {"reads": 0.0 * UP}),
    "reads little": (0.3, 0.01, 1.5, {"reads": 0.005 * UP}),
    "swings": (0.0, 0.01, 6.0, {"there": False, "swings": 0.7}),
    "good gyro": (0.0, 0.0, 0.0, {"there": False}),
    "good gyro, moves fast": (1.0, 0.0, 0.0, {}),
    "good gyro, accelerometer off": (0.0, 0.0, 0.0, {"added": OFF}),
}


def samples_of(flights):
    """IMU samples (n, flights, ...) with faults of 6 deg from 20 s on, and the true attitudes."""
    rng, since = np.random.default_rng(2), np.maximum(TIME - FAULT, 0.0)
    noise, white = rng.standard_normal((2, len(TIME), 3))
    samples, attitudes = [], []
    for size, little, rolling, reading in flights:
        turning = 2.0 * math.pi * reading.get("swings", 0.0)
        rolled = rolling * (np.sin(turning * since) / turning if turning else since)
        angles = rolled[:, None] * np.array([1.0, 0.0, 0.0])
        swing = 2.0 * math.pi * np.array([0.4, 0.55, 0.0])
        acceleration = size * swing * np.cos(swing * TIME[:, None])
        q = quaternion_from_euler(angles)
        force = to_body(q, UP + acceleration) + reading.get("added", 0.0)
        force = np.broadcast_to(reading.get("reads", force), force.shape)
        rate = (1.0 - little) * rolling * np.cos(turning * since) * (since > 0.0)
        rate = rate[:, None] * np.array([1.0, 0.0, 0.0])
        rate = rate + 0.007 * DEG / math.sqrt(DT) * white
        measured = quaternion_from_euler(angles + 0.1 * DEG * noise + 6.0 * DEG * (since > 0.0)[:, None])
        there = np.full(len(TIME), reading.get("there", True))
        samples.append((measured, rate, force, there | True, there | True, there))
        attitudes.append(q)
    together = ImuSample(*(np.stack(parts, axis=1) for parts in zip(*samples, strict=True)))
    return together, np.stack(attitudes, axis=1)


def diagnose(samples):
    """Attitudes (n, 4) that fly, and the last state."""
    inputs = FaultObserverInputs(samples, 0.0 * samples.body_rate)
    state, flown = fly_arrays(*as_flown(OBSERVER, inputs), DT)
    return flown.said.corrected.q_xyzw, state.law


@pytest.fixture(scope="module")
def flown():
    """By flight: largest error of the tilt [deg] in the fault, what gravity is off by [deg], the gyro's scale
    error about x as it is known then, and its standard deviation."""
    samples, true = samples_of(FLIGHTS.values())
    lanes = range(len(FLIGHTS))
    found, states = zip(*(diagnose(rows_of(samples, (slice(None), lane))) for lane in lanes), strict=True)
    verticals = [to_body(q, UP / STANDARD_GRAVITY) for q in (np.stack(found, axis=1), true)]
    error = np.linalg.norm(np.cross(*verticals), axis=-1)[TIME > FAULT].max(axis=0) / DEG
    off = np.sqrt([each.gravity.off[0] for each in states]) / DEG
    scale = [each.filter.x[3] for each in states]
    known = np.sqrt([each.filter.P[SCALE, SCALE] for each in states])
    return dict(zip(FLIGHTS, zip(error, off, scale, known, strict=True), strict=True))


def test_gravity_bounds_what_a_wrong_gyro_does_to_the_tilt(flown):
    assert flown["no accelerometer"][0] > 10.0
    for name, bound in (("rests", 1.5), ("moves", 3.0), ("moves fast", 6.0)):
        assert flown[name][0] < bound, name


def test_a_reading_without_gravity_says_nothing(flown):
    for name in ("reads zero", "reads little"):
        assert flown[name] == flown["no accelerometer"]
    assert flown["no accelerometer"][3] > 0.004


def test_a_good_gyro_is_believed_against_gravity(flown):
    for name in ("good gyro, moves fast", "good gyro, accelerometer off"):
        assert flown[name][0] == pytest.approx(flown["good gyro"][0], abs=0.1), name


def test_what_swings_with_the_vehicle_is_an_error_of_the_gyro(flown):
    _, _, scale, known = flown["swings"]
    assert known < 0.0015  # 0.005 before
    assert scale == pytest.approx(0.01, abs=0.003)


def test_it_learns_by_what_gravity_is_off(flown):
    assert flown["good gyro, moves fast"][1] < 0.4
    assert flown["good gyro, accelerometer off"][1] > 1.5


@pytest.mark.thorough  # one by one: test_fault_observer_contract.py and test_c_equals_numpy.py
def test_batch_in_numpy_gives_the_numbers_of_a_flight_in_c():
    samples, _ = samples_of([FLIGHTS["moves"]])
    samples, state = rows_of(samples, slice(round(24.0 / DT))), None
    flown, _ = diagnose(rows_of(samples, (slice(None), 0)))
    for k, wanted in enumerate(flown):
        imu = rows_of(samples, k)
        inputs = FaultObserverInputs(imu, 0.0 * imu.body_rate)
        state, found = OBSERVER.step(OBSERVER.init(inputs) if k == 0 else state, inputs, DT if k else 0.0)
        np.testing.assert_allclose(found.corrected.q_xyzw, [wanted], atol=1e-9)


def test_a_tilt_error_is_seen_as_the_matrix_says():
    true, error = quaternion_from_euler(np.array([0.3, -0.5, 2.0])), 1e-4 * np.array([1.0, -2.0, 0.5])
    wrong = turn(true, -error)
    np.testing.assert_allclose(rotation_between(wrong, true), error, atol=1e-8)
    start = gravity.start_gravity(np.zeros(3))
    _, seen, _ = gravity.feel(start, wrong, to_body(true, UP), np.True_, np.True_, DT)
    np.testing.assert_allclose(seen, gravity.tilt_matrix(wrong) @ error, atol=1e-7)
