"""Reduced attitude control: when it takes over, and what it does with the direction of the thrust."""

import dataclasses

import numpy as np
import pytest
from law_contract import assert_contract, flown, outputs_of

from quadftc_control.controllers.indi import Indi
from quadftc_control.controllers.ismc import Ismc
from quadftc_control.controllers.pid import Pid
from quadftc_control.reduced_attitude import Enduring, ReducedAttitude, wanted_direction, yaw_left
from quadftc_model.rigid_body import angular_acceleration, rk4
from quadftc_model.rotations import normalise, quaternion_from_euler, quaternion_rate
from quadftc_model.samples import AttitudeReference, ControllerInputs, RotorFeedback, level_sample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("hummingbird")
OFF, HEALTHY = np.array([0.0, 1.0, 1.0, 1.0]), np.ones(4)


def inputs_of(effectiveness, angles=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0), wanted=(0.0, 0.0, 0.0)):
    imu = level_sample()._replace(q_xyzw=quaternion_from_euler(np.array(angles)), body_rate=np.array(rate))
    reference = AttitudeReference(np.array(wanted), np.zeros(3), np.zeros(3))
    rotors = RotorFeedback(np.zeros(3), np.bool_(False), effectiveness)
    return ControllerInputs(imu, reference, np.zeros(3), None if effectiveness is None else rotors)


def activity(law, sequence):
    """Whether the law has taken over, at each of a sequence of inputs."""
    return [bool(state.active) for state, _ in flown(law, sequence)]


def test_yaw_left_is_one_of_healthy_rotors_and_falls_with_each_of_them():
    assert yaw_left(VEHICLE, HEALTHY) == pytest.approx(1.0)
    left = [float(yaw_left(VEHICLE, np.array([x, 1.0, 1.0, 1.0]))) for x in np.linspace(1.0, 0.0, 50)]
    assert np.all(np.diff(left) <= 1e-12)
    assert left[-1] < 0.0


def test_yaw_left_is_that_of_each_rotor_alone_where_rotors_are_alike():
    for x in (0.3, 0.7):
        found = [float(yaw_left(VEHICLE, 1.0 - (1.0 - x) * np.eye(4)[rotor])) for rotor in range(4)]
        np.testing.assert_allclose(found, found[0])


@pytest.mark.parametrize("controller", [Ismc, Indi])
def test_healthy_rotors_are_flown_as_by_the_controller_bit_for_bit(controller):
    law = controller(vehicle=VEHICLE)
    rng = np.random.default_rng(1)
    for effectiveness in (None, HEALTHY):
        rest = [(rng.normal(0, 0.2, 3), rng.normal(0, 1.0, 3), rng.normal(0, 0.2, 3)) for _ in range(20)]
        sequence = [inputs_of(effectiveness, *each) for each in rest]
        mine, alone = outputs_of(Enduring(law=law), sequence), outputs_of(law, sequence)
        for output, expected in zip(mine, alone, strict=True):
            for one, other in zip(output, expected, strict=True):
                np.testing.assert_array_equal(one, other)


def test_it_takes_over_when_a_rotor_is_off_and_leaves_when_it_is_back_and_yaw_is_still():
    spins = (0.0, 0.0, 5.0)
    sequence = [inputs_of(HEALTHY)] + [inputs_of(OFF)] * 2
    sequence += [inputs_of(OFF, rate=spins), inputs_of(HEALTHY, rate=spins), inputs_of(HEALTHY)]
    assert activity(Enduring(law=Ismc(vehicle=VEHICLE)), sequence) == [False, True, True, True, True, False]


def test_between_both_thresholds_it_stays_what_it_was():
    share = np.linspace(1.0, 0.0, 1000)
    left = np.array([float(yaw_left(VEHICLE, np.array([x, 1.0, 1.0, 1.0]))) for x in share])
    between = np.array([share[np.argmin(np.abs(left - 0.15))], 1.0, 1.0, 1.0])
    law = Enduring(law=Ismc(vehicle=VEHICLE))
    assert activity(law, [inputs_of(each) for each in (HEALTHY, between, OFF, between)]) == [
        False,
        False,
        True,
        True,
    ]


def test_the_wanted_direction_does_not_depend_on_the_yaw():
    for yaw in (-2.0, 0.0, 3.0):
        inputs = inputs_of(OFF, (0.0, 0.0, yaw), wanted=(0.2, -0.1, 1.0))
        found = wanted_direction(inputs.imu, inputs.reference)
        np.testing.assert_allclose(
            found, [np.sin(-0.1) * np.cos(0.2), -np.sin(0.2), np.cos(-0.1) * np.cos(0.2)]
        )


@pytest.mark.parametrize("spin", [0.0, 8.0, -20.0])
def test_the_thrust_comes_to_its_direction_however_fast_the_vehicle_spins(spin):
    """With torques that come at once: the tilt falls by exp(-k_direction t), and straight."""
    vehicle = dataclasses.replace(VEHICLE, rotors=dataclasses.replace(VEHICLE.rotors, time_constant=5e-4))
    law = ReducedAttitude(k_yaw=0.0)
    motion = quaternion_from_euler(np.array([0.15, 0.0, 0.0])), np.array([0.0, 0.0, spin])
    for _ in range(400):
        imu = level_sample()._replace(q_xyzw=motion[0], body_rate=motion[1])
        torque = law.torque(vehicle, imu, inputs_of(OFF).reference, 0.001)

        def derivative(_time, motion, torque=torque):
            q_xyzw, rate = motion
            return quaternion_rate(q_xyzw, rate), angular_acceleration(vehicle, rate, torque, 0.0)

        q_xyzw, rate = rk4(derivative, 0.0, motion, 0.001)
        motion = normalise(q_xyzw), rate
    x, y = motion[0][:2]
    tilt = np.arccos(1.0 - 2.0 * (x * x + y * y))
    assert tilt == pytest.approx(0.15 * np.exp(-law.k_direction * 0.4), abs=0.03)
    assert np.hypot(*motion[1][:2]) < 0.3


@pytest.mark.parametrize("controller", [Ismc, Pid])
def test_law_that_takes_over_keeps_the_contract(controller):
    rng, law = np.random.default_rng(2), Enduring(law=controller(vehicle=VEHICLE))
    lanes = [
        [inputs_of(np.clip(rng.uniform(-0.5, 1.5, 4), 0, 1), *rng.normal(0, 0.3, (3, 3))) for _ in range(20)]
        for _ in range(4)
    ]
    assert set(activity(law, lanes[0])) == {True, False}
    assert_contract(law, lanes, rtol=1e-9)
