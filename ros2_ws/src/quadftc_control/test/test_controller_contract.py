"""What every controller of the registry keeps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_contract import assert_contract, outputs_of
from sampling import sampled

from quadftc_compile.engine import CEngine
from quadftc_control.controller import controllers
from quadftc_model.rigid_body import angular_acceleration, propeller_momentum, rk4
from quadftc_model.rotations import euler_from_quaternion, normalise, quaternion_from_euler, quaternion_rate
from quadftc_model.rotors import commands_from_torque, torque_from_commands
from quadftc_model.samples import AttitudeReference, ControllerInputs, ImuSample, RotorFeedback
from quadftc_model.stepper import Stepper
from quadftc_model.vehicle import load_vehicle, vehicle_names

EVERY_CONTROLLER = pytest.mark.parametrize("name", controllers.names())
EVERY_VEHICLE = pytest.mark.parametrize("vehicle", vehicle_names())
SOME_PAIRS = pytest.mark.parametrize(
    ("name", "vehicle"), sampled(controllers.names(), vehicle_names(), every=5)
)
DT, COUNT, LANES = 0.004, 40, 5


def controller(name, vehicle="qball_x4"):
    return controllers.get(name)(vehicle=load_vehicle(vehicle))


def inputs_of(angles, body_rate, reference, disturbance):
    """Inputs, read-only; the reference is its angles, rates and accelerations."""
    there = np.ones(np.shape(angles)[:-1], dtype=bool)
    force = np.zeros_like(angles)
    imu = ImuSample(quaternion_from_euler(angles), body_rate, force, there, there, there)
    for array in (*imu, *reference, disturbance):
        array.setflags(write=False)
    return ControllerInputs(imu, AttitudeReference(*reference), disturbance)


def inputs_at(index):
    """Inputs of all lanes, another motion in each."""
    phase = np.arange(LANES)[:, None] + np.array([0.0, 1.0, 2.0])
    wave = np.sin(2.0 * DT * index + phase)
    return inputs_of(0.5 * wave, wave.copy(), [0.2 * wave, 0.1 * wave, 0.3 * wave], 0.5 * np.cos(phase))


def lane(inputs, index):
    imu, reference, disturbance, *_ = inputs
    return ControllerInputs(
        ImuSample(*(array[index] for array in imu)),
        AttitudeReference(*(array[index] for array in reference)),
        disturbance[index],
    )


def closed_loop(law, angles, duration):
    """Angles over time (n, 3) of a vehicle that starts at ``angles`` and shall be level."""
    vehicle, zeros = law.vehicle, np.zeros(3)
    stepper, motion, course = Stepper(law, CEngine()), (quaternion_from_euler(angles), np.zeros(3)), []
    for index in range(round(duration / DT)):
        course.append(euler_from_quaternion(motion[0]))
        inputs = inputs_of(course[-1], motion[1].copy(), [zeros, zeros, zeros], zeros)
        output = stepper.step(round(1e9 * DT) * index, inputs)
        commands = commands_from_torque(vehicle, output.torque)

        def derivative(_time, motion, commands=commands):
            q_xyzw, rate = motion
            torque = torque_from_commands(vehicle, commands)
            momentum = propeller_momentum(vehicle, commands)
            return quaternion_rate(q_xyzw, rate), angular_acceleration(vehicle, rate, torque, momentum)

        q_xyzw, rate = rk4(derivative, 0.0, motion, DT)
        motion = (normalise(q_xyzw), rate)
    return np.array(course)


@EVERY_CONTROLLER
@EVERY_VEHICLE
def test_outputs_have_their_shapes_and_types_and_are_finite(name, vehicle):
    sequence = [lane(inputs_at(index), 0) for index in range(COUNT)]
    for output in outputs_of(controller(name, vehicle), sequence):
        for array in output:
            assert array.shape == (3,)
            assert np.all(np.isfinite(array))
        assert output.saturated.dtype == bool


WILD = st.floats(-1e4, 1e4)
ANGLE = st.floats(-4.0, 4.0)


@SOME_PAIRS
@given(
    st.lists(
        st.tuples(
            *[
                st.tuples(bound, bound, bound).map(np.array)
                for bound in (ANGLE, WILD, ANGLE, WILD, WILD, WILD)
            ]
        ),
        min_size=2,
        max_size=4,
    )
)
def test_torque_is_attainable_for_wild_inputs(name, vehicle, samples):
    law = controller(name, vehicle)
    sequence = [inputs_of(sample[0], sample[1], list(sample[2:5]), sample[5]) for sample in samples]
    for output in outputs_of(law, sequence):
        assert np.all(np.isfinite(output.torque))
        moves = law.vehicle.allocation @ output.torque
        assert np.all(np.abs(moves) <= law.vehicle.command_room * (1.0 + 1e-9))


def with_rotors(inputs, effectiveness, measured=False):
    """The inputs with what is known of four rotors; measured, they give a torque."""
    rate = inputs.imu.body_rate
    flag = np.broadcast_to(np.bool_(measured), rate.shape[:-1])[()]
    weak = np.broadcast_to(effectiveness, (*rate.shape[:-1], 4)).copy()
    return inputs._replace(rotors=RotorFeedback(0.01 * rate * measured, flag, weak))


@EVERY_CONTROLLER
def test_effectiveness_of_one_changes_nothing_and_less_of_it_gives_a_finite_torque(name):
    law, sequence = controller(name), [inputs_at(index) for index in range(COUNT)]
    plain = outputs_of(law, sequence)
    healthy, weak = (
        outputs_of(law, [with_rotors(each, effectiveness) for each in sequence])
        for effectiveness in (np.ones(4), np.array([0.6, 1.0, 1.0, 0.0]))
    )
    np.testing.assert_array_equal([each.torque for each in healthy], [each.torque for each in plain])
    assert np.all(np.isfinite([each.torque for each in weak]))


@SOME_PAIRS
def test_controller_keeps_the_contract_of_a_law(name, vehicle):
    lanes = [[lane(inputs_at(index), one) for index in range(COUNT)] for one in range(LANES)]
    assert_contract(controller(name, vehicle), lanes)


@EVERY_CONTROLLER
def test_saturation_is_told_where_too_much_is_asked_for(name):
    law = controller(name)
    still = inputs_of(np.zeros(3), np.zeros(3), [np.zeros(3)] * 3, np.zeros(3))
    turning = inputs_of(np.zeros(3), np.array([0.0, 0.0, 1e3]), [np.zeros(3)] * 3, np.zeros(3))
    assert outputs_of(law, [still])[0].saturated.tolist() == [False, False, False]
    assert outputs_of(law, [still, turning])[1].saturated.tolist() == [False, False, True]


@EVERY_CONTROLLER
def test_level_vehicle_on_its_reference_needs_no_torque(name):
    still = inputs_of(np.zeros(3), np.zeros(3), [np.zeros(3)] * 3, np.zeros(3))
    assert [output.torque.tolist() for output in outputs_of(controller(name), [still] * 3)] == [
        [0.0, 0.0, 0.0]
    ] * 3


@EVERY_CONTROLLER
def test_error_is_the_attitude_minus_the_reference_the_short_way_round(name):
    angles, wanted = np.array([0.1, -0.2, 3.0]), np.array([0.3, 0.1, -3.0])
    output = outputs_of(
        controller(name), [inputs_of(angles, np.zeros(3), [wanted, np.zeros(3), np.zeros(3)], np.zeros(3))]
    )
    np.testing.assert_allclose(output[0].error, [-0.2, -0.3, 6.0 - 2.0 * np.pi], atol=1e-12)


@SOME_PAIRS
def test_tilted_vehicle_comes_level(name, vehicle):
    course = closed_loop(controller(name, vehicle), np.array([0.3, -0.2, 0.5]), 4.0)
    assert np.degrees(np.max(np.abs(course[-1]))) < 0.1


@EVERY_CONTROLLER
def test_torque_is_continuous_in_attitude_and_reference(name):
    law = controller(name)
    angles, rate, zeros = np.array([0.1, -0.2, 0.3]), np.array([0.1, 0.2, -0.3]), np.zeros(3)
    for distance in (0.0, 0.3):
        wanted = angles - distance
        torques = [
            outputs_of(law, [inputs_of(angles + shift, rate, [wanted, zeros, zeros], zeros)] * 2)[1].torque
            for shift in (0.0, 1e-7)
        ]
        assert np.max(np.abs(torques[1] - torques[0]) / law.vehicle.inertia) < 1e-3
