"""The cascaded PID: what each of its terms does."""

import numpy as np
import pytest

from quadftc_control.controllers.pid import Pid
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
TRUE, ZEROS, DT = np.bool_(True), np.zeros(3), 0.004
NO_GAINS = {"k_angle": (0.0,) * 3, "k_p": (0.0,) * 3, "k_i": (0.0,) * 3, "k_d": (0.0,) * 3}


def inputs_of(angles=ZEROS, body_rate=ZEROS, rates=ZEROS):
    imu = ImuSample(quaternion_from_euler(angles), body_rate, ZEROS, TRUE, TRUE, TRUE)
    return ControllerInputs(imu, AttitudeReference(ZEROS, rates, ZEROS), ZEROS)


def acceleration(gains, *sequence):
    """Angular acceleration [rad/s²] that is asked for at the last of the inputs."""
    law = Pid(vehicle=VEHICLE, **{**NO_GAINS, **gains})
    state = law.init(sequence[0])
    for index, inputs in enumerate(sequence):
        state, output = law.step(state, inputs, DT if index else 0.0)
    return output.torque / VEHICLE.inertia


def test_rate_error_acts_by_its_gain():
    rates = np.array([0.1, 0.2, -0.1])
    asked = acceleration(
        {"k_p": (1.0, 2.0, 3.0)}, inputs_of(body_rate=np.array([0.3, 0.1, 0.1]), rates=rates)
    )
    np.testing.assert_allclose(asked, [-0.2, 0.2, -0.6], rtol=1e-12)


def test_angle_error_becomes_a_rate_setpoint():
    asked = acceleration(
        {"k_angle": (2.0,) * 3, "k_p": (3.0,) * 3}, inputs_of(angles=np.array([0.1, 0.0, 0.0]))
    )
    np.testing.assert_allclose(asked, [-0.6, 0.0, 0.0], atol=1e-12)


def test_integral_of_the_rate_error_grows_with_time():
    turning = inputs_of(body_rate=np.array([0.5, -0.5, 0.2]))
    asked = acceleration({"k_i": (1.0, 2.0, 3.0)}, *[turning] * 11)
    np.testing.assert_allclose(asked, -10 * DT * np.array([0.5, -1.0, 0.6]), rtol=1e-12)


def test_derivative_is_that_of_the_low_passed_rate():
    jump = np.array([0.1, -0.2, 0.05])
    asked = acceleration({"k_d": (0.1,) * 3}, inputs_of(), inputs_of(body_rate=jump))
    np.testing.assert_allclose(asked, -0.1 * jump * 190.0 / (1.0 + 190.0 * DT), rtol=1e-12)


def test_derivative_fades_at_the_cutoff():
    jump = inputs_of(body_rate=np.array([0.1, 0.0, 0.0]))
    early, late = (acceleration({"k_d": (0.1,) * 3}, inputs_of(), *[jump] * count)[0] for count in (1, 11))
    assert late / early == pytest.approx((1.0 + 190.0 * DT) ** -10, rel=1e-9)
