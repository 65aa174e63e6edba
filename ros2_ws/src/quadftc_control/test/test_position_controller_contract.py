"""What every position controller of the registry keeps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from law_contract import assert_contract, outputs_of
from sampling import sampled

from quadftc_compile.engine import CEngine
from quadftc_control.position_controller import PositionControllerInputs, position_controllers
from quadftc_control.trajectory import trajectories
from quadftc_model.parameters import build
from quadftc_model.rotations import quaternion_from_euler, to_earth
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample, PositionEstimate, PositionReference
from quadftc_model.stepper import Stepper
from quadftc_model.vehicle import load_vehicle, vehicle_names

EVERY_CONTROLLER = pytest.mark.parametrize("name", position_controllers.names())
EVERY_VEHICLE = pytest.mark.parametrize("vehicle", vehicle_names())
SOME_VEHICLES = pytest.mark.parametrize("vehicle", sampled(vehicle_names(), every=3))
DT_NS, DT, COUNT, LANES = 4_000_000, 0.004, 40, 5
UP = np.array([0.0, 0.0, 1.0])


def controller(name, vehicle="qball_x4", **values):
    return build(position_controllers.get(name), values, vehicle=load_vehicle(vehicle))


def inputs_of(angles, position, velocity, reference, acceleration=None):
    """Inputs, read-only, of a vehicle that does not turn."""
    there = np.ones(np.shape(angles)[:-1], dtype=bool)[()]
    zeros = np.zeros_like(angles)
    imu = ImuSample(quaternion_from_euler(angles), zeros, zeros + STANDARD_GRAVITY * UP, there, there, there)
    estimate = PositionEstimate(position, velocity, zeros if acceleration is None else acceleration)
    for array in (*imu[:3], *estimate, *reference):
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return PositionControllerInputs(imu, estimate, reference)


def resting(position=(0.0, 0.0, 0.0), yaw=0.0):
    zeros = np.zeros(3)
    return PositionReference(np.array(position, dtype=float), zeros, zeros, yaw, 0.0, zeros)


def inputs_at(index):
    """Inputs of all lanes, another motion in each."""
    phase = np.arange(LANES)[:, None] + np.array([0.0, 1.0, 2.0])
    wave = np.sin(2.0 * DT * index + phase)
    yaw = 3.0 * wave[:, 0]
    reference = PositionReference(wave * 4.0, wave * 0.3, wave * 0.2, yaw, 0.2 * yaw, wave * 0.1)
    return inputs_of(0.4 * wave, wave.copy(), -wave, reference)


def lane(inputs, index):
    imu, estimate, reference = inputs
    at = [type(each)(*(array[index] for array in each)) for each in (imu, estimate, reference)]
    yaw, yaw_rate = float(at[2].yaw), float(at[2].yaw_rate)
    return PositionControllerInputs(at[0], at[1], at[2]._replace(yaw=yaw, yaw_rate=yaw_rate))


def flown_long(law, sequence):
    """All outputs over a sequence of inputs, in C; the first step takes no time."""
    stepper = Stepper(law, CEngine())
    return [stepper.step(index * DT_NS, inputs) for index, inputs in enumerate(sequence)]


@EVERY_CONTROLLER
@EVERY_VEHICLE
def test_vehicle_at_its_place_stays_level_and_carries_its_weight(name, vehicle):
    law = controller(name, vehicle)
    still = inputs_of(np.zeros(3), np.ones(3), np.zeros(3), resting([1.0, 1.0, 1.0]))
    for output in outputs_of(law, [still] * 3):
        assert not np.any(output.attitude)
        assert output.thrust == pytest.approx(law.vehicle.mass * STANDARD_GRAVITY, rel=1e-12)


@EVERY_CONTROLLER
@pytest.mark.parametrize("yaw", [0.0, 1.3, -2.5])
@pytest.mark.parametrize("towards", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-0.3, 0.4, 0.2)])
def test_thrust_turns_towards_the_place_at_any_heading(name, yaw, towards):
    heading = np.array([0.0, 0.0, yaw])
    away = inputs_of(heading, np.zeros(3), np.zeros(3), resting(towards, yaw))
    output = outputs_of(controller(name), [away] * 200)[-1]
    thrust = to_earth(quaternion_from_euler(output.attitude.angles), UP)
    assert thrust[0] * towards[1] - thrust[1] * towards[0] == pytest.approx(0.0, abs=1e-3)
    assert thrust[:2] @ towards[:2] > 0.01
    assert output.attitude.angles[2] == pytest.approx(yaw, abs=1e-6)


@EVERY_CONTROLLER
def test_yaw_that_is_not_there_yet_does_not_turn_the_push(name):
    heading = np.array([0.0, 0.0, 1.0])
    away = inputs_of(heading, np.zeros(3), np.zeros(3), resting([1.0, 0.0, 0.0], yaw=0.0))
    angles = outputs_of(controller(name), [away] * 200)[-1].attitude.angles
    thrust = to_earth(quaternion_from_euler(np.array([*angles[:2], heading[2]])), UP)
    assert thrust[0] > 0.1
    assert thrust[1] == pytest.approx(0.0, abs=1e-3)


WILD = st.floats(-1e5, 1e5)
ANGLE = st.floats(-4.0, 4.0)
THREE = st.tuples(WILD, WILD, WILD).map(np.array)


@EVERY_CONTROLLER
@SOME_VEHICLES
@settings(max_examples=15)
@given(st.tuples(ANGLE, ANGLE, ANGLE).map(np.array), THREE, THREE, THREE, THREE, THREE, ANGLE)
def test_tilt_and_thrust_are_within_their_limits_for_wild_inputs(
    name, vehicle, angles, p, v, pd, vd, ad, yaw
):
    law = controller(name, vehicle)
    outputs = flown_long(law, [inputs_of(angles, p, v, PositionReference(pd, vd, ad, yaw, 0.1, vd))] * 600)
    most = law.vehicle.thrust_max
    for output in outputs:
        assert law.min_thrust * most <= output.thrust <= law.max_thrust * most
        assert np.all(np.isfinite(output.attitude))
    # the filter has come to rest at what is wanted
    roll, pitch, _ = outputs[-1].attitude.angles
    assert np.cos(roll) * np.cos(pitch) >= np.cos(law.max_tilt) - 1e-3


@EVERY_CONTROLLER
def test_rates_and_accelerations_fit_the_angles_and_the_rotors(name):
    law = controller(name)
    far = [inputs_of(np.zeros(3), np.zeros(3), np.zeros(3), resting([5.0, -5.0, 3.0], 1.0))] * 300
    angles, rates, accelerations = (
        np.array(part) for part in zip(*(output.attitude for output in flown_long(law, far)), strict=True)
    )
    np.testing.assert_allclose(np.diff(angles, axis=0) / DT, 0.5 * (rates[1:] + rates[:-1]), atol=1e-9)
    np.testing.assert_allclose(np.diff(rates, axis=0) / DT, accelerations[1:], atol=1e-9)
    possible = law.vehicle.authority / law.vehicle.inertia
    assert np.all(np.abs(accelerations) <= law.agility * possible * (1.0 + 1e-9))


@EVERY_CONTROLLER
@SOME_VEHICLES
def test_controller_keeps_the_contract_of_a_law(name, vehicle):
    lanes = [[lane(inputs_at(index), one) for index in range(COUNT)] for one in range(LANES)]
    assert_contract(controller(name, vehicle), lanes)


class PointMass:
    """A vehicle that has its attitude at once and its thrust after the lag, and what pushes it [m/s²]."""

    def __init__(self, law, push, start):
        self.law, self.push = law, np.asarray(push, float)
        self.position, self.velocity = np.array(start, dtype=float), np.zeros(3)
        self.acceleration = np.zeros(3)
        self.angles, self.thrust = np.zeros(3), law.vehicle.mass * STANDARD_GRAVITY

    def errors(self, trajectory, duration):
        """Position minus reference over time, (n, 3)."""
        stepper, out = Stepper(self.law, CEngine()), []
        share = DT / self.law.vehicle.rotors.time_constant
        for index in range(round(duration / DT)):
            reference = trajectory.sample(index * DT)
            motion = (self.angles, self.position, self.velocity)
            inputs = inputs_of(*(each.copy() for each in motion), reference, self.acceleration)
            out.append(self.position - reference.position)
            output = stepper.step(index * DT_NS, inputs)
            self.angles = output.attitude.angles
            self.thrust += share * (output.thrust - self.thrust)
            lift = to_earth(quaternion_from_euler(self.angles), UP) * self.thrust / self.law.vehicle.mass
            drag = self.law.drag(float(np.hypot(*self.velocity[:2]))) * self.velocity * [1.0, 1.0, 0.0]
            self.acceleration = lift - STANDARD_GRAVITY * UP - drag + self.push
            self.position = self.position + DT * (self.velocity + 0.5 * DT * self.acceleration)
            self.velocity = self.velocity + DT * self.acceleration
        return np.array(out)


@EVERY_CONTROLLER
@SOME_VEHICLES
def test_vehicle_flies_to_its_place_and_holds_it_in_steady_wind(name, vehicle):
    place = trajectories.get("hover")(position=(3.0, -2.0, 1.0))
    errors = PointMass(controller(name, vehicle), [0.5, -0.3, 0.2], np.zeros(3)).errors(place, 16.0)
    assert np.max(np.abs(errors[-1])) < 0.02
    assert np.all(np.abs(errors) <= np.array([3.0, 2.0, 1.0]) + 0.6)  # little overshoot


@EVERY_CONTROLLER
@SOME_VEHICLES
def test_circle_is_followed_without_an_error_of_the_lag(name, vehicle):
    circle = trajectories.get("circle")(speed=2.0)
    errors = PointMass(controller(name, vehicle), np.zeros(3), [2.0, 0.0, 1.0]).errors(circle, 7.0)
    assert np.max(np.linalg.norm(errors, axis=1)) < 0.05
    # the test must be able to fail: without the jerk the lag shows
    blind = PointMass(controller(name, vehicle), np.zeros(3), [2.0, 0.0, 1.0])
    lagging = blind.errors(WithoutJerk(circle), 7.0)
    assert np.max(np.linalg.norm(lagging, axis=1)) > 2.0 * np.max(np.linalg.norm(errors, axis=1))


class WithoutJerk:
    def __init__(self, trajectory):
        self._trajectory = trajectory

    def sample(self, time):
        return self._trajectory.sample(time)._replace(jerk=np.zeros(3))


@EVERY_CONTROLLER
def test_integral_does_not_wind_up_while_the_limits_hold(name):
    law = controller(name)
    far = inputs_of(np.zeros(3), np.zeros(3), np.zeros(3), resting([100.0, 0.0, 0.0]))
    there = inputs_of(np.zeros(3), np.zeros(3), np.zeros(3), resting())
    tilts = [flown_long(law, [far] * count + [there] * 300)[-1].attitude.angles[1] for count in (100, 3000)]
    assert tilts[1] == pytest.approx(tilts[0], abs=1e-3)
