"""Supervised diagnosis on simulated MEMS sensors: it detects, isolates, estimates and recovers."""

import math

import numpy as np
import pytest

from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_model.rotations import (
    body_rates,
    euler_from_quaternion,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
)
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, STARTING, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

DEG = math.pi / 180.0
QBALL = load_vehicle("qball_x4")
FLIGHTS = 12
SIMULATED = {"wander": 0.0, "wander_moving": 0.0, "gyro_moving": 0.0, "gyro_shift": 0.0}


class Diagnosed:
    """Flights (leading axis) with MEMS sensors and a fault (n, flights, 3), diagnosed."""

    def __init__(self, fault, rate=250.0, seed=1, absent=None, observer=None, pitch=0.0, gyro_error=0.0):
        dt, (n, flights, _), rng = 1.0 / rate, fault.shape, np.random.default_rng(seed)
        self.time = dt * np.arange(n)
        size, w = rng.uniform(1.0, 4.0, (flights, 3)) * DEG, rng.uniform(0.3, 1.2, (flights, 3))
        phase = rng.uniform(0.0, 6.0, (flights, 3))
        angle = w * self.time[:, None, None] + phase
        self.angles = size * np.sin(angle) + [0.0, pitch, 0.0]
        omega = body_rates(self.angles, size * w * np.cos(angle))
        bias = rng.uniform(-1.0, 1.0, (flights, 3)) * DEG
        wrong = gyro_error * rng.uniform(-1.0, 1.0, (flights, 3, 3))
        gyro = (
            omega
            + (wrong @ omega[..., None])[..., 0]
            + bias
            + 0.007 * DEG / math.sqrt(dt) * rng.standard_normal(omega.shape)
        )
        noise = quaternion_from_rotation_vector(0.1 * DEG * rng.standard_normal(omega.shape))
        attitude = quaternion_product(quaternion_from_euler(self.angles + fault), noise)
        there, zeros = np.ones(flights, bool), np.zeros((flights, 3))
        observer = observer or Supervised(vehicle=QBALL, **SIMULATED)
        state, found = None, []
        for k in range(n):
            seen = there if absent is None else there & ~absent[k]
            inputs = FaultObserverInputs(ImuSample(attitude[k], gyro[k], zeros, seen, there, there), zeros)
            state = observer.init(inputs) if state is None else state
            state, estimate = observer.step(state, inputs, dt if k else 0.0)
            found.append(estimate)
        self.state = np.array([each.state for each in found])
        self.estimate = np.array([each.fault for each in found])
        self.std_dev = np.array([each.std_dev for each in found])
        self.onset_age = np.array([each.onset_age for each in found])
        self.attitude = euler_from_quaternion(np.array([each.corrected.q_xyzw for each in found]))
        self.faulty = np.isin(self.state, (FAULTY, RECOVERING))
        self.error = self.estimate - fault


def times(seconds, rate=250.0):
    return np.arange(round(seconds * rate)) / rate


def a_fault(time, shape, axis=0, start=14.0, stop=22.0, flights=FLIGHTS):
    fault = np.zeros((len(time), flights, 3))
    rows = (start <= time) & (time < stop)
    fault[rows, :, axis] = np.asarray(shape(time[rows] - start))[:, None]
    return fault


SHAPES = {
    "step": (lambda elapsed: 0.0 * elapsed + 0.5 * DEG, 0.02),
    "ramp": (lambda elapsed: 0.3 * DEG * elapsed, 1.0),
    "sine": (lambda elapsed: 2.0 * DEG * np.sin(1.0 * elapsed), 0.3),
}
CASES = [(kind, axis) for kind in SHAPES for axis in range(3)]
EACH = 3  # flights of a case


@pytest.fixture(scope="module")
def faults():
    """A fault of every kind on every axis, in one batch."""
    time = times(30.0)
    return Diagnosed(
        np.concatenate([a_fault(time, SHAPES[kind][0], axis, flights=EACH) for kind, axis in CASES], axis=1)
    )


@pytest.mark.parametrize(("kind", "axis"), CASES)
def test_a_fault_is_detected_on_its_axis_alone_estimated_and_over(faults, kind, axis):
    time, delay = faults.time, SHAPES[kind][1]
    first = EACH * CASES.index((kind, axis))
    flights = slice(first, first + EACH)
    faulty = faults.faulty[:, flights]
    assert not faulty[time < 14.0].any()
    others = [other for other in range(3) if other != axis]
    assert not faulty[..., others].any()
    assert faulty[(time >= 14.0 + delay) & (time < 22.0), :, axis].all()
    inside = (time >= 14.0) & (time < 22.0)
    error = faults.error[inside, flights, axis]
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.25 * DEG)
    assert not faulty[time > 27.0].any()


@pytest.mark.parametrize("start", [3.5, 5.0])
def test_a_slow_fault_soon_after_the_start_does_not_cost_what_is_known_of_the_gyro(start):
    """Going back to a state of the time when its bias was unknown would let the attitude drift away."""
    fault = a_fault(times(start + 8.0), SHAPES["ramp"][0], axis=1, start=start, stop=start + 6.0)
    flights = Diagnosed(fault, seed=5)
    assert np.all(flights.faulty.any(axis=0)[:, 1])
    assert np.max(np.abs(flights.attitude - flights.angles)[flights.time > start]) < 0.75 * DEG


def test_the_attitude_stays_right_through_steps_on_all_axes_at_once():
    time = times(24.0)
    fault = a_fault(time, SHAPES["step"][0]) + 4.0 * DEG * ((time >= 14.0) & (time < 22.0))[:, None, None]
    flown = Diagnosed(fault)
    wrong = flown.attitude - flown.angles
    assert np.sqrt(np.mean(wrong[time > 5.0] ** 2)) < 0.08 * DEG
    assert np.max(np.abs(wrong[time > 5.0])) < 0.4 * DEG


def test_the_standard_deviation_is_honest():
    time = times(20.0)
    flown = Diagnosed(a_fault(time, SHAPES["step"][0], stop=30.0))
    rows = (time > 14.5) & (np.arange(len(time)) % 250 == 0)
    ratio = (flown.error[rows, :, 0] / flown.std_dev[rows, :, 0]) ** 2
    assert 0.3 < np.mean(ratio) < 1.7  # samples of one flight depend on each other: a wide band


def test_the_onset_is_dated():
    time = times(16.0)
    flown = Diagnosed(a_fault(time, SHAPES["ramp"][0]))
    onset = (time[-1] - flown.onset_age[-1, :, 0]) - 14.0
    assert np.all((onset > -0.1) & (onset < 1.0))
    assert np.all(flown.onset_age[time < 13.0] == -1.0)


def test_a_healthy_flight_raises_no_alarm_and_starts_within_two_seconds():
    time = times(30.0)
    flown = Diagnosed(np.zeros((len(time), FLIGHTS, 3)))
    assert not flown.faulty.any()
    assert np.all(flown.state[0] == STARTING)
    assert np.mean(flown.state[time > 2.0] == HEALTHY) > 0.99
    assert np.max(np.abs((flown.attitude - flown.angles)[time > 5.0])) < 0.06 * DEG


@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_it_works_at_other_rates(rate):
    time = times(13.0, rate)
    step = a_fault(time, lambda elapsed: 0.0 * elapsed + 2.0 * DEG, start=6.0, stop=9.0, flights=4)
    flown = Diagnosed(step, rate)
    assert not flown.faulty[time < 6.0].any()
    assert flown.faulty[(time >= 6.1) & (time < 9.0), :, 0].all()
    assert not flown.faulty[time > 12.0].any()
    inside = (time >= 6.0) & (time < 9.0)
    assert np.sqrt(np.mean(flown.error[inside, :, 0] ** 2)) < 0.15 * DEG


def test_missing_attitudes_are_bridged():
    time = times(20.0)
    absent = (time % 1.0 < 0.4) | ((time > 8.0) & (time < 9.5))
    flown = Diagnosed(a_fault(time, SHAPES["step"][0], start=12.5, stop=30.0), absent=absent)
    assert not flown.faulty[time < 12.5].any()
    assert flown.faulty[(time > 13.0), :, 0].all()
    assert np.all(np.isfinite(flown.estimate))


def test_missing_samples_in_a_tumble_raise_no_alarm():
    """What the body rate was in between is a guess, and far off."""
    rng = np.random.default_rng(3)
    time = np.concatenate([times(0.4), 0.6 + times(2.0), 2.9 + times(2.0)])
    size, w = np.array([1.2, 0.4, 1.0]), np.array([2.5, 3.5, 2.0])
    angles = size * np.sin(w * time[:, None])
    rates = np.array([0.01, -0.01, 0.01]) + body_rates(angles, size * w * np.cos(w * time[:, None]))
    attitude = quaternion_product(
        quaternion_from_euler(angles),
        quaternion_from_rotation_vector(0.1 * DEG * rng.standard_normal(angles.shape)),
    )
    observer, state, zeros, there = Supervised(vehicle=QBALL, **SIMULATED), None, np.zeros(3), np.bool_(True)
    seen: set[int] = set()
    for k, dt in enumerate(np.diff(time, prepend=time[0])):
        inputs = FaultObserverInputs(ImuSample(attitude[k], rates[k], zeros, there, there, there), zeros)
        state = observer.init(inputs) if state is None else state
        state, estimate = observer.step(state, inputs, float(dt))
        seen |= set(estimate.state.tolist())
    assert seen <= {STARTING, HEALTHY}


def test_a_fault_from_the_start_does_not_lock_it_out():
    """Taken for the attitude; at its end it looks like a new fault, which stands still and is given up."""
    time = times(30.0)
    observer = Supervised(vehicle=QBALL, patience=8.0, **SIMULATED)
    flown = Diagnosed(
        a_fault(time, lambda elapsed: 0.0 * elapsed + 3.0 * DEG, start=0.0, stop=5.0), observer=observer
    )
    assert flown.faulty[(time > 5.1) & (time < 6.0), :, 0].all()
    assert not flown.faulty[time > 28.0].any()
    assert np.max(np.abs((flown.attitude - flown.angles)[time > 29.0])) < 0.1 * DEG


def test_scale_and_alignment_errors_of_the_gyro_do_no_harm():
    time = times(24.0)
    flown = Diagnosed(a_fault(time, SHAPES["step"][0], stop=19.0), gyro_error=0.02)
    assert not flown.faulty[time < 14.0].any()
    assert flown.faulty[(time >= 14.1) & (time < 19.0), :, 0].all()
    inside = (time >= 14.0) & (time < 19.0)
    assert np.sqrt(np.mean(flown.error[inside, :, 0] ** 2)) < 0.15 * DEG
    assert not flown.faulty[time > 23.9].any()


def test_an_ongoing_fault_does_not_hide_one_that_begins_later_on_another_axis():
    time = times(24.0)
    later = a_fault(time, SHAPES["ramp"][0], axis=1, start=17.0)
    flown = Diagnosed(a_fault(time, SHAPES["step"][0]) + later)
    assert flown.faulty[(time >= 18.5) & (time < 22.0), :, :2].all()
    assert not flown.faulty[..., 2].any()
    inside = (time >= 17.0) & (time < 22.0)
    assert np.sqrt(np.mean(flown.error[inside, :, 1] ** 2)) < 0.15 * DEG


def test_near_the_pole_of_the_euler_angles_it_stays_finite_and_raises_no_alarm():
    time = times(10.0)
    flown = Diagnosed(np.zeros((len(time), FLIGHTS, 3)), pitch=math.pi / 2.0)
    assert np.all(np.isfinite(flown.estimate))
    assert np.all(np.isfinite(flown.attitude))
    assert np.mean(flown.faulty) < 0.05
