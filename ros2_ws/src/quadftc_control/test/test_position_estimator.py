"""The position estimator on simulated flights along a circle."""

import dataclasses

import numpy as np
import pytest
from in_c import fly_arrays
from law_contract import assert_contract

from quadftc_control.trajectory import trajectories
from quadftc_model.arrays import rows_of
from quadftc_model.assembly import build_prefixed, node_values
from quadftc_model.parameters import parameters_of
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.rotations import quaternion_from_euler, to_body
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample, PositionSample

DT = 0.004
MOCAP = PositionEstimator(delay=0.008)
GPS = PositionEstimator(delay=0.1, noise=0.2, gives_velocity=True, velocity_noise=0.1)
SENSORS = {"mocap": (MOCAP, 100.0, 0.001, 0.0), "gps": (GPS, 10.0, 0.2, 0.1)}


class Flight:
    """What happens along the circle; each is a function of time."""

    def __init__(self, bias=None, shift=None, silent=None, force_lost=None, seed=0, spin=0.0):
        self.bias = bias or (lambda time: 0.0)  # m/s², on all axes of the accelerometer
        self.shift = shift or (lambda time: 0.0)  # m, of the position sensor
        self.silent = silent or (lambda time: False)
        self.force_lost = force_lost or (lambda time: False)
        self.seed = seed
        self.spin = spin  # rad/s, about the vertical

    def inputs(self, sensor, duration):
        """Inputs of the estimator (n, ...), and the true motion."""
        law, rate, noise, velocity_noise = SENSORS[sensor]
        time = DT * np.arange(round(duration / DT))
        index, late, every = np.arange(len(time)), round(law.delay / DT), round(1.0 / rate / DT)
        bias, shift, silent, lost = (
            np.array([each(now) for now in time])
            for each in (self.bias, self.shift, self.silent, self.force_lost)
        )
        draws = np.moveaxis(np.random.default_rng(self.seed).standard_normal((len(time), 4, 3)), 1, 0)
        motion = trajectories.get("circle")(speed=2.0).sample(time)
        force = motion.acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY])
        roll = np.arctan2(-force[:, 1], np.hypot(force[:, 0], force[:, 2]))
        angles = np.stack([roll, np.arctan2(force[:, 0], force[:, 2]), 0.3 + self.spin * time], axis=-1)
        measured = to_body(quaternion_from_euler(angles), force) + 0.02 * draws[0] + bias[:, None]
        imu = ImuSample(
            quaternion_from_euler(angles + 0.0017 * draws[1]),
            np.broadcast_to([0.0, 0.0, self.spin], force.shape),
            np.where(lost[:, None], 0.0, measured),
            *(np.ones(len(time), np.bool_), np.ones(len(time), np.bool_), ~lost),
        )
        then = np.maximum(index - late, 0)
        there = (index >= late) & ((index - late) % every == 0) & ~silent
        place = motion.position[then] + noise * draws[2] + shift[:, None]
        speed = (motion.velocity[then] + velocity_noise * draws[3]) * law.gives_velocity
        return PositionEstimatorInputs(imu, PositionSample(place, speed, there)), motion

    def errors(self, sensor, duration=12.0):
        """Errors of position, velocity and acceleration, and the estimated bias; (n, 3) each."""
        inputs, true = self.inputs(sensor, duration)
        _, (estimate, bias) = fly_arrays(WithBias(SENSORS[sensor][0]), inputs, DT)
        return [*(a - b for a, b in zip(estimate, true[:3], strict=True)), bias]


@dataclasses.dataclass(frozen=True, eq=False)
class WithBias:
    """The estimator, whose output tells the bias, too."""

    law: PositionEstimator

    def init(self, inputs):
        return self.law.init(inputs)

    def step(self, state, inputs, dt):
        state, estimate = self.law.step(state, inputs, dt)
        return state, (estimate, state.bias)


def in_turn(inputs):
    return [rows_of(inputs, row) for row in range(len(inputs.imu.q_xyzw))]


def rms(array, after):
    return np.sqrt(np.mean(np.sum(array[round(after / DT) :] ** 2, axis=1)))


def at(time):
    return round(time / DT)


def test_parameters_are_documented_and_survive_the_way_through_a_node():
    assert all(spec.doc and spec.unit for spec in parameters_of(PositionEstimator))
    again = build_prefixed(PositionEstimator, node_values(GPS, "estimator"), "estimator")
    assert dataclasses.asdict(again) == dataclasses.asdict(GPS)


@pytest.mark.parametrize(("sensor", "place", "speed"), [("mocap", 0.002, 0.02), ("gps", 0.15, 0.2)])
def test_motion_is_known_better_than_the_sensor_says(sensor, place, speed):
    position, velocity, _, _ = Flight().errors(sensor)
    assert rms(position, 2.0) < place
    assert rms(velocity, 2.0) < speed


@pytest.mark.parametrize(("sensor", "place", "within"), [("mocap", 0.01, 0.5), ("gps", 0.3, 1.5)])
def test_step_of_the_accelerometer_is_learnt_and_throws_nothing(sensor, place, within):
    flight = Flight(bias=lambda time: 1.0 if time > 6.0 else 0.0)
    position, _, _, bias = flight.errors(sensor)
    assert np.max(np.abs(position[at(4.0) :])) < place
    np.testing.assert_allclose(bias[at(5.0) : at(6.0)].mean(axis=0), 0.0, atol=0.3)
    np.testing.assert_allclose(bias[at(6.0 + within) :].mean(axis=0), 1.0, atol=0.2)


def test_delay_that_is_not_compensated_is_an_error_of_position(monkeypatch):
    late = dataclasses.replace(GPS, delay=0.0)
    with_it = rms(Flight().errors("gps")[0], 4.0)
    flight = Flight()
    inputs = flight.inputs("gps", 12.0)  # the sensor is late all the same
    monkeypatch.setitem(SENSORS, "gps", (late, *SENSORS["gps"][1:]))
    monkeypatch.setattr(flight, "inputs", lambda *_: inputs)
    assert rms(flight.errors("gps")[0], 4.0) > 2.0 * with_it > 0.0


def test_outliers_are_not_used():
    position, velocity, _, _ = Flight(shift=lambda time: 1.0 if 5.0 < time < 5.3 else 0.0).errors("mocap")
    assert rms(position, 2.0) < 0.01
    assert rms(velocity, 2.0) < 0.05


def test_sensor_that_jumps_for_good_is_believed_again():
    position = Flight(shift=lambda time: 1.0 if time > 5.0 else 0.0).errors("mocap")[0]
    assert np.max(np.abs(position[at(3.0) : at(5.4)])) < 0.02
    np.testing.assert_allclose(position[at(6.0) :], 1.0, atol=0.01)


def test_silence_is_bridged_by_the_accelerometer():
    position, velocity, _, _ = Flight(silent=lambda time: 5.0 < time < 7.0).errors("mocap")
    assert np.max(np.abs(position[at(3.0) :])) < 0.3
    assert np.max(np.abs(position[at(7.2) :])) < 0.01
    assert np.max(np.abs(velocity[at(7.5) :])) < 0.1


def test_position_alone_holds_where_the_force_is_lost():
    position, velocity, _, _ = Flight(force_lost=lambda time: 6.0 < time < 8.0).errors("mocap")
    assert np.max(np.abs(position[at(3.0) :])) < 0.05
    assert np.max(np.abs(velocity[at(3.0) :])) < 0.5
    assert rms(velocity, 9.0) < 0.03


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_position_that_is_no_number_changes_nothing(value):
    inputs = in_turn(Flight().inputs("mocap", 2.0)[0])
    state = MOCAP.init(inputs[0])
    for each in inputs:
        state, _ = MOCAP.step(state, each, DT)
    bad = PositionSample(np.full(3, value), np.zeros(3), np.bool_(True))
    none = PositionSample(np.zeros(3), np.zeros(3), np.bool_(False))
    (_, given), (_, without) = (
        MOCAP.step(state, PositionEstimatorInputs(inputs[-1].imu, sample), DT) for sample in (bad, none)
    )
    for a, b in zip(given, without, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("sensor", SENSORS)
def test_estimator_keeps_the_contract_of_a_law(sensor):
    flights = [
        Flight(seed=1),
        Flight(seed=2, shift=lambda time: 3.0 if time > 0.3 else 0.0),
        Flight(seed=3, silent=lambda time: time < 0.5, force_lost=lambda time: time > 1.0),
    ]
    lanes = [in_turn(flight.inputs(sensor, 1.6)[0]) for flight in flights]
    assert_contract(SENSORS[sensor][0], lanes, atol=1e-11)


@pytest.mark.parametrize(("sensor", "bound"), [("mocap", 0.02), ("gps", 0.25)])
def test_a_vehicle_that_spins_keeps_its_estimate(sensor, bound):
    """A body turns by two radians while a sample of GPS comes: its bias is not learnt, and does no harm."""
    position, velocity, _, bias = Flight(bias=lambda _: 0.3, spin=20.0).errors(sensor)
    assert rms(position, 4.0) < bound
    assert rms(velocity, 4.0) < 4.0 * bound
    np.testing.assert_array_equal(bias, 0.0)
