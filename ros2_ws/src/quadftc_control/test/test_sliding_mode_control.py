"""Integral and conventional sliding-mode control: the surfaces, and what happens where the torque is cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_control.controller import anti_windup, limited
from quadftc_control.controllers.ismc import Ismc
from quadftc_control.sliding_surface import sat, torque_for, tracking
from quadftc_model.rotations import body_acceleration, body_rates, quaternion_from_euler
from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
TRUE = np.bool_(True)
NUMBER = st.floats(-1.0, 1.0)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER).map(np.array)


def inputs_of(angles, angle_rates, reference, disturbance=0.0):
    imu = ImuSample(
        quaternion_from_euler(angles), body_rates(angles, angle_rates), np.zeros(3), TRUE, TRUE, TRUE
    )
    return ControllerInputs(imu, AttitudeReference(*reference), np.zeros(3) + disturbance)


@given(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def test_integral_sliding_variable_is_zero_at_the_start(
    angles, rates, wanted, wanted_rates, wanted_accelerations
):
    law = Ismc(vehicle=VEHICLE)
    inputs = inputs_of(angles, rates, [wanted, wanted_rates, wanted_accelerations])
    _, output = law.step(law.init(inputs), inputs, 0.0)
    np.testing.assert_allclose(output.sliding_variable, 0.0, atol=1e-12)


def test_integral_sliding_variable_follows_equation_38():
    law = Ismc(vehicle=VEHICLE, k_c1=(1.0, 2.0, 3.0), k_c2=(4.0, 5.0, 6.0))
    zeros = np.zeros(3)

    def error(time):  # small, so that no torque is cut
        angle = 0.05 * np.sin(3.0 * time + np.array([0.0, 1.0, 2.0]))
        return angle, 0.15 * np.cos(3.0 * time + np.array([0.0, 1.0, 2.0]))

    state, integral = None, np.zeros(3)
    for index in range(250):
        angles, rates = error(0.004 * index)
        inputs = inputs_of(angles, rates, [zeros, zeros, zeros])
        state = law.init(inputs) if state is None else state
        state, output = law.step(state, inputs, 0.004 if index else 0.0)
    last, start = error(0.004 * 249), error(0.0)
    phase = np.array([0.0, 1.0, 2.0])
    integral = 0.05 / 3.0 * (np.cos(phase) - np.cos(3.0 * 0.004 * 249 + phase))
    k_c1, k_c2 = np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    expected = last[1] + k_c2 * last[0] + k_c1 * integral - k_c2 * start[0] - start[1]
    np.testing.assert_allclose(output.sliding_variable, expected, atol=1e-5)


@given(VECTOR, VECTOR, VECTOR)
def test_torque_gives_the_angle_accelerations_asked_for(angles, rates, accelerations):
    inputs = inputs_of(angles, rates, [np.zeros(3)] * 3)
    disturbance, omega = np.array([0.5, -0.3, 0.2]), inputs.imu.body_rate
    torque = torque_for(VEHICLE, inputs, tracking(inputs), accelerations, disturbance)
    acceleration = (torque - np.cross(omega, VEHICLE.inertia * omega)) / VEHICLE.inertia + disturbance  # (1)
    np.testing.assert_allclose(acceleration, body_acceleration(angles, rates, accelerations), atol=1e-10)


@given(VECTOR)
def test_sat_is_linear_inside_the_layer_and_the_sign_outside(S):
    phi = np.array([0.1, 0.5, 2.0])
    expected = np.where(np.abs(S) > phi, np.sign(S), S / phi)
    np.testing.assert_allclose(sat(S, phi), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("wanted", "given_torque", "error", "moves"),
    [
        (1.0, 1.0, 0.5, True),  # not cut
        (2.0, 1.0, -0.5, False),  # cut from above, and a falling integral asks for more
        (2.0, 1.0, 0.5, True),  # cut from above, but on the way back
        (-2.0, -1.0, 0.5, False),
        (-2.0, -1.0, -0.5, True),
    ],
)
def test_integral_stands_still_only_where_it_drives_a_cut_torque_further(wanted, given_torque, error, moves):
    integral = anti_windup(np.zeros(1), np.array([error]), np.array([wanted]), np.array([given_torque]), 0.1)
    assert integral[0] == pytest.approx(0.1 * error if moves else 0.0)


def test_limited_tells_the_axes_that_were_cut():
    torque, cut = limited(VEHICLE, np.array([0.1, 9.0, 0.0]))
    assert cut.tolist() == [False, True, False]
    assert torque[1] == pytest.approx(1.2)


def test_sliding_variable_stays_in_its_layer_while_the_torque_is_cut():
    law = Ismc(vehicle=VEHICLE)
    zeros = np.zeros(3)
    state = None
    for index in range(500):  # the vehicle does not move, whatever is asked of it
        inputs = inputs_of(np.array([0.0, 0.0, 2.5]), zeros, [zeros, zeros, zeros])
        state = law.init(inputs) if state is None else state
        state, output = law.step(state, inputs, 0.004 if index else 0.0)
    assert output.saturated[2]
    assert np.all(np.abs(output.sliding_variable) <= 0.1 + 1e-12)


def test_error_over_half_a_turn_leaves_no_sliding_variable_behind():
    law = Ismc(vehicle=VEHICLE)
    zeros, state, largest = np.zeros(3), None, 0.0
    for index, yaw in enumerate(
        [3.1, 3.2, *[3.2] * 20]
    ):  # the error changes its sign: from 3.1 to 3.2 - 2 pi
        inputs = inputs_of(np.array([0.0, 0.0, yaw]), zeros, [zeros, zeros, zeros])
        state = law.init(inputs) if state is None else state
        state, output = law.step(state, inputs, 0.004 if index else 0.0)
        largest = abs(output.sliding_variable[2])
    assert largest <= 0.1 + 1e-12
