"""Supervised diagnosis on simulated MEMS sensors: it detects, isolates, estimates and recovers."""

import copy
import functools
import math

import numpy as np
import pytest
from in_c import as_flown, fly_arrays

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
START, STOP, END = 10.0, 16.0, 22.0  # s; of most faults, and of the flights


def times(seconds, rate=250.0):
    return np.arange(round(seconds * rate)) / rate


TIME = times(END)


def a_fault(time, shape, axis=0, start=START, stop=STOP):
    """Fault (n, 3) [rad] of a shape over the time since its start."""
    rows = (start <= time) & (time < stop)
    return np.where(rows, shape(np.maximum(time - start, 0.0)), 0.0)[:, None] * np.eye(3)[axis]


class Scenario:
    """Flights with the same fault (n, 3) [rad], different in their motion and noise."""

    def __init__(self, fault, flights=6, absent=False, pitch=0.0, gyro_error=0.0):
        self.fault, self.absent = fault, np.broadcast_to(absent, len(fault))
        self.flights, self.pitch, self.gyro_error = flights, pitch, gyro_error


def inputs_of(attitude, gyro, there):
    """Inputs of samples (n, ...) that give no force."""
    yes, zeros = np.ones(len(there), bool), np.zeros((len(there), 3))
    return FaultObserverInputs(ImuSample(attitude, gyro, zeros, there, yes, yes), zeros)


class Diagnosed:
    """Flights (leading axis) with MEMS sensors, diagnosed."""

    def __init__(self, scenarios, rate=250.0, seed=1, observer=None):
        dt, rng = 1.0 / rate, np.random.default_rng(seed)
        counts = [each.flights for each in scenarios]
        fault = np.repeat([each.fault for each in scenarios], counts, axis=0).swapaxes(0, 1)
        there = ~np.repeat([each.absent for each in scenarios], counts, axis=0).T
        pitch = np.repeat([each.pitch for each in scenarios], counts)
        gyro_error = np.repeat([each.gyro_error for each in scenarios], counts)
        n, flights, _ = fault.shape
        self.time = dt * np.arange(n)
        size, w = rng.uniform(1.0, 4.0, (flights, 3)) * DEG, rng.uniform(0.3, 1.2, (flights, 3))
        angle = w * self.time[:, None, None] + rng.uniform(0.0, 6.0, (flights, 3))
        self.angles = size * np.sin(angle) + pitch[:, None] * np.array([0.0, 1.0, 0.0])
        omega = body_rates(self.angles, size * w * np.cos(angle))
        bias = rng.uniform(-1.0, 1.0, (flights, 3)) * DEG
        wrong = gyro_error[:, None, None] * rng.uniform(-1.0, 1.0, (flights, 3, 3))
        white = 0.007 * DEG / math.sqrt(dt) * rng.standard_normal(omega.shape)
        gyro = omega + (wrong @ omega[..., None])[..., 0] + bias + white
        noise = quaternion_from_rotation_vector(0.1 * DEG * rng.standard_normal(omega.shape))
        attitude = quaternion_product(quaternion_from_euler(self.angles + fault), noise)
        observer, found = observer or Supervised(vehicle=QBALL), []
        for lane in range(flights):
            inputs = inputs_of(attitude[:, lane], gyro[:, lane], there[:, lane])
            flown = fly_arrays(*as_flown(observer, inputs), dt)[1].said
            found.append((flown.state, flown.fault, flown.std_dev, flown.onset_age, flown.corrected.q_xyzw))
        columns = (np.stack(column, axis=1) for column in zip(*found, strict=True))
        self.state, self.estimate, self.std_dev, self.onset_age, q_xyzw = columns
        self.attitude = euler_from_quaternion(q_xyzw)
        self._derive(fault)

    def _derive(self, fault):
        self.faulty = np.isin(self.state, (FAULTY, RECOVERING))
        self.error = self.estimate - fault
        self.wrong = self.attitude - self.angles

    def of(self, flights):
        """The same of some flights only."""
        part = copy.copy(self)
        for name, values in vars(self).items():
            if name != "time":
                setattr(part, name, values[:, flights])
        return part


def step(size, **options):
    return a_fault(TIME, lambda elapsed: 0.0 * elapsed + size * DEG, **options)


def ramp(**options):
    return a_fault(TIME, lambda elapsed: 0.3 * DEG * elapsed, **options)


def sine(**options):
    return a_fault(TIME, lambda elapsed: 2.0 * DEG * np.sin(elapsed), **options)


DELAYS = {"step": 0.02, "ramp": 1.5, "sine": 0.3}  # s; within which a fault is found
KINDS = {"step": functools.partial(step, 0.5), "ramp": ramp, "sine": sine}
CASES = [(kind, axis) for kind in KINDS for axis in range(3)]
SCENARIOS = {
    **{(kind, axis): Scenario(KINDS[kind](axis=axis), flights=3) for kind, axis in CASES},
    "soon": Scenario(ramp(axis=1, start=3.5, stop=9.5)),
    "a little later": Scenario(ramp(axis=1, start=5.0, stop=11.0)),
    "all axes": Scenario(step(4.5) + step(4.0, axis=1) + step(4.0, axis=2)),
    "lasting": Scenario(step(0.5, stop=END), flights=12),
    "healthy": Scenario(step(0.0), flights=12),
    "gaps": Scenario(step(0.5, start=12.5, stop=END), absent=(TIME % 1.0 < 0.4) | (abs(TIME - 8.75) < 0.75)),
    "scale and alignment": Scenario(step(0.5), gyro_error=0.02),
    "one after the other": Scenario(step(0.5, stop=18.0) + ramp(axis=1, start=13.0, stop=18.0)),
    "pole": Scenario(step(0.0), pitch=math.pi / 2.0),
}


@pytest.fixture(scope="module")
def flown():
    """All scenarios by name."""
    batch = Diagnosed(list(SCENARIOS.values()))
    ends = np.cumsum([each.flights for each in SCENARIOS.values()])
    rows = zip(SCENARIOS.items(), ends, strict=True)
    return {name: batch.of(slice(end - each.flights, end)) for (name, each), end in rows}


@pytest.mark.parametrize(("kind", "axis"), CASES)
def test_a_fault_is_detected_on_its_axis_alone_estimated_and_over(flown, kind, axis):
    flights = flown[kind, axis]
    assert not flights.faulty[TIME < START].any()
    assert not np.delete(flights.faulty, axis, axis=-1).any()
    assert flights.faulty[(START + DELAYS[kind] <= TIME) & (TIME < STOP), :, axis].all()
    error = flights.error[(TIME >= START) & (TIME < STOP), :, axis]
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 0.25 * DEG)
    assert not flights.faulty[TIME > STOP + 5.0].any()


@pytest.mark.parametrize(("name", "start"), [("soon", 3.5), ("a little later", 5.0)])
def test_a_slow_fault_soon_after_the_start_does_not_cost_what_is_known_of_the_gyro(flown, name, start):
    """Going back to a state of the time when its bias was unknown would let the attitude drift away."""
    flights, rows = flown[name], start + 8.0 > TIME
    assert np.all(flights.faulty[rows].any(axis=0)[:, 1])
    assert np.max(np.abs(flights.wrong)[rows & (start < TIME)]) < 1.0 * DEG


def test_the_attitude_stays_right_through_steps_on_all_axes_at_once(flown):
    wrong = flown["all axes"].wrong[TIME > 5.0]
    assert np.sqrt(np.mean(wrong**2)) < 0.08 * DEG
    assert np.max(np.abs(wrong)) < 0.4 * DEG


def test_the_standard_deviation_is_honest(flown):
    rows = (TIME > START + 0.5) & (np.arange(len(TIME)) % 250 == 0)
    flights = flown["lasting"]
    ratio = (flights.error[rows, :, 0] / flights.std_dev[rows, :, 0]) ** 2
    assert 0.3 < np.mean(ratio) < 1.7  # samples of one flight depend on each other: a wide band


def test_the_onset_is_dated(flown):
    flights, row = flown["ramp", 0], np.searchsorted(TIME, START + 2.0)
    onset = (TIME[row] - flights.onset_age[row, :, 0]) - START
    assert np.all((onset > -0.1) & (onset < 1.5))
    assert np.all(flights.onset_age[TIME < START - 1.0] == -1.0)


def test_a_healthy_flight_raises_no_alarm_and_starts_within_two_seconds(flown):
    healthy = flown["healthy"]
    assert not healthy.faulty.any()
    assert np.all(healthy.state[0] == STARTING)
    assert np.mean(healthy.state[TIME > 2.0] == HEALTHY) > 0.99
    assert np.max(np.abs(healthy.wrong[TIME > 5.0])) < 0.06 * DEG


@pytest.mark.parametrize("rate", [50.0, 500.0, pytest.param(1000.0, marks=pytest.mark.thorough)])
def test_it_works_at_other_rates(rate):
    time = times(6.5, rate)
    fault = a_fault(time, lambda elapsed: 0.0 * elapsed + 2.0 * DEG, start=3.0, stop=4.0)
    flights = Diagnosed([Scenario(fault, flights=4)], rate)
    assert not flights.faulty[time < 3.0].any()
    assert flights.faulty[(time >= 3.1) & (time < 4.0), :, 0].all()
    assert not flights.faulty[time > 6.0].any()
    inside = (time >= 3.1) & (time < 4.0)  # three samples make a fault, 60 ms at 50 Hz
    assert np.sqrt(np.mean(flights.error[inside, :, 0] ** 2)) < 0.15 * DEG


def test_missing_attitudes_are_bridged(flown):
    flights = flown["gaps"]
    assert not flights.faulty[TIME < 12.5].any()
    assert flights.faulty[TIME > 13.0, :, 0].all()
    assert np.all(np.isfinite(flights.estimate))


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
    inputs = inputs_of(attitude, rates, np.ones(len(time), bool))
    _, flown = fly_arrays(*as_flown(Supervised(vehicle=QBALL), inputs), np.diff(time, prepend=time[0]))
    assert np.isin(flown.said.state, (STARTING, HEALTHY)).all()


def test_a_fault_from_the_start_does_not_lock_it_out():
    """Taken for the attitude; at its end it looks like a new fault, which stands still and is given up."""
    time = times(14.0, rate=125.0)
    fault = a_fault(time, lambda elapsed: 0.0 * elapsed + 3.0 * DEG, start=0.0, stop=3.0)
    observer = Supervised(vehicle=QBALL, patience=4.0)
    flights = Diagnosed([Scenario(fault)], rate=125.0, observer=observer)
    assert flights.faulty[(time > 3.1) & (time < 4.0), :, 0].all()
    assert not flights.faulty[time > 12.0].any()
    assert np.max(np.abs(flights.wrong[time > 13.0])) < 0.1 * DEG


def test_scale_and_alignment_errors_of_the_gyro_do_no_harm(flown):
    flights = flown["scale and alignment"]
    assert not flights.faulty[TIME < START].any()
    assert flights.faulty[(TIME >= START + 0.1) & (TIME < STOP), :, 0].all()
    inside = (TIME >= START) & (TIME < STOP)
    assert np.sqrt(np.mean(flights.error[inside, :, 0] ** 2)) < 0.15 * DEG
    assert not flights.faulty[TIME > STOP + 5.0].any()


def test_an_ongoing_fault_does_not_hide_one_that_begins_later_on_another_axis(flown):
    flights = flown["one after the other"]
    assert flights.faulty[(TIME >= 14.5) & (TIME < 18.0), :, :2].all()
    assert not flights.faulty[..., 2].any()
    inside = (TIME >= 13.0) & (TIME < 18.0)
    assert np.sqrt(np.mean(flights.error[inside, :, 1] ** 2)) < 0.15 * DEG


def test_near_the_pole_of_the_euler_angles_it_stays_finite_and_raises_no_alarm(flown):
    flights = flown["pole"]
    assert np.all(np.isfinite(flights.estimate))
    assert np.all(np.isfinite(flights.attitude))
    assert np.mean(flights.faulty) < 0.05
