"""The inner loop: what stands between an attitude with a thrust and the rotors."""

import dataclasses

import numpy as np
import pytest
from law_contract import assert_contract, outputs_of

from quadftc_control.attitude_loop import AttitudeLoop, AttitudeLoopInputs
from quadftc_control.controller import Controller, controllers
from quadftc_model.guarded import GuardedStepper
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import AttitudeCommand, AttitudeReference, ControllerInputs, ControllerOutput
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("hummingbird")
COUNT, LANES = 40, 4
EVERY = pytest.mark.parametrize("name", controllers.names())
WHERE = pytest.mark.parametrize("flies", [False, True])


def loop(name="indi", flies=True):
    return AttitudeLoop(controller=controllers.get(name)(vehicle=VEHICLE), flies=flies)


def sequence_of(flies, lane=0):
    """Inputs over time; a rotor gets weak and is off, and speeds are measured at two of three samples."""
    rng = np.random.default_rng(lane)
    found = []
    for index in range(COUNT):
        angles, rate, shall = rng.normal(0.0, 0.1, (3, 3))
        start = loop(flies=flies).example()
        imu = start.imu._replace(q_xyzw=quaternion_from_euler(angles), body_rate=rate)
        thrust = np.float64(VEHICLE.weight * rng.uniform(0.5, 2.5))
        command = AttitudeCommand(AttitudeReference(shall, np.zeros(3), np.zeros(3)), thrust)
        inputs = start._replace(imu=imu, command=command, disturbance=rng.normal(0.0, 0.1, 3))
        if flies:
            left = np.clip(2.0 - 0.1 * index - 0.2 * lane, 0.0, 1.0)
            inputs = inputs._replace(
                speeds=VEHICLE.hover_speed * rng.uniform(0.9, 1.1, 4),
                measured=np.bool_(index % 3 > 0),
                effectiveness=np.array([left, 1.0, 1.0, 1.0]),
            )
        found.append(inputs)
    return found


def as_table(sequence):
    """Torque, error, sliding variable and squared speeds of a free flight over time."""
    outputs = outputs_of(loop(), sequence)
    return np.array([np.concatenate([*each.output[:3], np.square(each.speeds)], -1) for each in outputs])


@EVERY
@WHERE
def test_loop_keeps_the_contract_of_a_law(name, flies):
    lanes = [sequence_of(flies, lane) for lane in range(LANES)]
    # a root magnifies the rounding of a force that is all but zero
    assert_contract(loop(name, flies), lanes, rtol=1e-9, atol=1e-8)


@EVERY
def test_test_stand_gets_the_torque_of_the_controller_bit_for_bit(name):
    law, sequence = loop(name, flies=False), sequence_of(flies=False)
    seen = [ControllerInputs(each.imu, each.command.attitude, each.disturbance) for each in sequence]
    for found, expected in zip(outputs_of(law, sequence), outputs_of(law.controller, seen), strict=True):
        assert found.speeds is None
        for one, other in zip(found.output, expected, strict=True):
            np.testing.assert_array_equal(one, other)


@EVERY
def test_speeds_give_the_torque_that_is_told_and_the_thrust_where_it_fits(name):
    for inputs, (output, speeds) in zip(
        sequence_of(flies=True), outputs_of(loop(name), sequence_of(flies=True)), strict=True
    ):
        torque, thrust = wrench_from_speeds(VEHICLE, speeds, inputs.effectiveness)
        np.testing.assert_allclose(torque / VEHICLE.authority, output.torque / VEHICLE.authority, atol=1e-7)
        within = (speeds > VEHICLE.rotors.speed_min) & (speeds < VEHICLE.rotors.speed_max)
        if np.all(within & (inputs.effectiveness == 1.0)):
            np.testing.assert_allclose(thrust, inputs.command.thrust, rtol=1e-7)


def test_speeds_that_are_not_measured_say_nothing():
    sequence = [each._replace(measured=np.bool_(False)) for each in sequence_of(flies=True)]
    other = [each._replace(speeds=np.full(4, np.nan)) for each in sequence]
    np.testing.assert_array_equal(as_table(sequence), as_table(other))
    measured = [each._replace(measured=np.bool_(True)) for each in sequence]
    assert np.max(np.abs(as_table(sequence) - as_table(measured))) > 1e-3


def test_no_effectiveness_means_healthy_rotors():
    sequence = sequence_of(flies=True)
    healthy = [each._replace(effectiveness=np.ones(4)) for each in sequence]
    unknown = [each._replace(effectiveness=None) for each in sequence]
    np.testing.assert_array_equal(as_table(healthy), as_table(unknown))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Defective(Controller):
    """Its torque is no number at one of its steps."""

    def init(self, inputs: ControllerInputs) -> int:
        return 0

    def step(self, state: int, inputs: ControllerInputs, dt: float) -> tuple[int, ControllerOutput]:
        torque = np.full(3, np.nan if state == 3 else 0.001 * (state + 1))
        return state + 1, ControllerOutput(torque, np.zeros(3), np.zeros(3), np.zeros(3, dtype=bool))


@WHERE
def test_last_torque_is_held_where_the_output_is_no_number(flies):
    law = AttitudeLoop(controller=Defective(vehicle=VEHICLE), flies=flies)
    given, stepper, last = [], GuardedStepper(law), np.zeros(3)
    for index in range(5):
        given.append(stepper.step(1 + index * 4_000_000, law.example()._replace(last=last)))
        last = given[-1].output.torque
    np.testing.assert_allclose([each.output.torque[0] for each in given], [0.001, 0.002, 0.003, 0.003, 0.001])
    assert stepper.replaced == 1
    if flies:
        np.testing.assert_array_equal(given[3].speeds, given[2].speeds)


@WHERE
def test_example_is_an_input_of_one_vehicle(flies):
    example = loop(flies=flies).example()
    assert isinstance(example, AttitudeLoopInputs)
    assert (example.speeds is not None) == flies
