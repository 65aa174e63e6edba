"""Guidance: scenario time or a setpoint in, a command out that can be used."""

import dataclasses

import numpy as np
import pytest
from law_contract import assert_contract, assert_step_is_traced, outputs_of

from quadftc_control.guidance import (
    FlightGuidance,
    FlightGuidanceInputs,
    LiveGuidance,
    LiveGuidanceInputs,
    ScenarioClock,
    StandGuidance,
    flight_guidance_from,
    live_guidance_from,
    stand_guidance_from,
)
from quadftc_control.position_controller import position_controllers
from quadftc_control.position_loop import PositionLoop, PositionLoopInputs
from quadftc_control.reference import combined, references
from quadftc_control.trajectory import PositionSetpoint, PositionSetpointFilter, trajectories
from quadftc_control.trajectory import combined as combined_trajectory
from quadftc_model.assembly import node_values
from quadftc_model.parameters import build
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import PositionSample, level_sample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("x500")
DT, COUNT, LANES = 0.004, 30, 4
ABSURD = build(references.get("step"), {"angles": [90.0, 0.0, 0.0], "start": 1.0, "rise": 0.002})
REFERENCES = (build(references.get("hold"), {"angles": [0.1, 0.2, 0.3]}), references.get("sine")())
TRAJECTORIES = (build(trajectories.get("circle"), {"speed": 2.0}), trajectories.get("waypoints")())


def outer(name="geometric"):
    return PositionLoop(
        estimator=PositionEstimator(), controller=position_controllers.get(name)(vehicle=VEHICLE)
    )


def seen(index, lane=0):
    """What IMU and position sensor say at a sample."""
    rng = np.random.default_rng([index, lane])
    force = np.array([0.0, 0.0, 9.8]) + rng.normal(0.0, 0.1, 3)
    q_xyzw = quaternion_from_euler(rng.normal(0.0, 0.1, 3))
    imu = level_sample()._replace(q_xyzw=q_xyzw, body_rate=rng.normal(0.0, 0.1, 3), specific_force=force)
    return imu, PositionSample(rng.normal(0.0, 1.0, 3), np.zeros(3), np.bool_(index % 5 == lane % 5))


def by_time(index, lane=0):
    return FlightGuidanceInputs(*seen(index, lane), np.float64(1.0 + lane + index * DT))


def by_setpoint(index, lane=0):
    return LiveGuidanceInputs(
        *seen(index, lane), PositionSetpoint(np.ones(3) * lane, np.float64(0.1 * index))
    )


LAWS = {
    "stand": (StandGuidance(references=REFERENCES), lambda index, lane=0: np.float64(lane + index * DT)),
    "stand, level": (StandGuidance(), lambda index, lane=0: np.float64(lane + index * DT)),
    "flight": (FlightGuidance(trajectories=TRAJECTORIES, loop=outer()), by_time),
    "flight, origin": (FlightGuidance(loop=outer("pid_cascade")), by_time),
    "live": (LiveGuidance(smooth=PositionSetpointFilter(), loop=outer()), by_setpoint),
}
EVERY = pytest.mark.parametrize("case", LAWS.values(), ids=LAWS)


def leaves(tree):
    return [each for part in tree for each in leaves(part)] if isinstance(tree, tuple) else [np.asarray(tree)]


@EVERY
def test_guidance_keeps_the_contract_of_a_law(case):
    law, at = case
    assert_contract(law, [[at(index, lane) for index in range(COUNT)] for lane in range(LANES)])
    assert_step_is_traced(law, law.example())


def test_references_are_followed_and_one_that_is_absurd_leaves_the_last():
    law = StandGuidance(references=(*REFERENCES, ABSURD))
    times = [0.5, 0.999, 1.0005, 1.001, 1.5]
    found = outputs_of(law, times)
    for index in (0, 1, 4):
        np.testing.assert_array_equal(found[index].attitude, combined(law.references, times[index]))
    np.testing.assert_array_equal(found[2].attitude, found[1].attitude)
    assert np.max(np.abs(combined(law.references, times[2]).accelerations)) > 1e6


def test_first_reference_that_is_absurd_is_level_and_still():
    assert not np.any(outputs_of(StandGuidance(references=(ABSURD,)), [1.0005])[0].attitude)


def test_trajectory_that_is_absurd_leaves_the_last():
    fast = build(trajectories.get("circle"), {"speed": 100.0, "radius": 1e-3, "start": 1.0, "rise": 0.01})
    law = FlightGuidance(trajectories=(fast,), loop=outer())
    found = outputs_of(law, [by_time(index)._replace(elapsed=0.9 + 0.05 * index) for index in range(8)])
    np.testing.assert_array_equal(found[0].reference.position, fast.sample(0.9).position)
    for output in found[3:]:
        np.testing.assert_array_equal(output.reference.position, found[2].reference.position)
        assert all(np.all(np.isfinite(each)) for each in leaves(output))


@pytest.mark.parametrize("first", [0, 10])
def test_command_that_is_no_number_is_the_last_one_and_the_loop_begins_again(first):
    """By a corrected sample that is none, which no observer should give."""
    law, sequence = FlightGuidance(trajectories=TRAJECTORIES, loop=outer()), [by_time(k) for k in range(40)]
    bad = sequence[first]
    sequence[first] = bad._replace(imu=bad.imu._replace(q_xyzw=np.full(4, np.nan)))
    found = outputs_of(law, sequence)
    for output in found:
        told = leaves(output._replace(body_velocity=()))  # which needs the attitude of the sample
        assert all(np.all(np.isfinite(each)) for each in told)
    if first:
        np.testing.assert_array_equal(found[first].command.attitude, found[first - 1].command.attitude)
        assert np.any(found[first + 1].command.attitude.angles != found[first].command.attitude.angles)
    else:
        assert not np.any(found[0].command.attitude)
        assert found[0].command.thrust == VEHICLE.weight


def test_trajectory_and_outer_loop_are_those_of_the_guidance():
    law, sequence = LAWS["flight"][0], [by_time(index) for index in range(COUNT)]
    shall = [combined_trajectory(TRAJECTORIES, each.elapsed) for each in sequence]
    inner = [PositionLoopInputs(each.imu, each.place, to) for each, to in zip(sequence, shall, strict=True)]
    for found, to, expected in zip(
        outputs_of(law, sequence), shall, outputs_of(law.loop, inner), strict=True
    ):
        for one, other in zip(leaves(found[:4]), leaves((to, *expected)), strict=True):
            np.testing.assert_array_equal(one, other)


def test_live_setpoint_is_made_smooth_for_the_outer_loop():
    law, sequence = LAWS["live"][0], [by_setpoint(index) for index in range(COUNT)]
    smooth = outputs_of(law.smooth, [each.setpoint for each in sequence])
    for found, expected in zip(outputs_of(law, sequence), smooth, strict=True):
        for one, other in zip(leaves(found.reference), leaves(expected), strict=True):
            np.testing.assert_array_equal(one, other)


def test_first_stamp_is_scenario_time_zero():
    clock = ScenarioClock()
    assert [clock.elapsed(stamp_ns) for stamp_ns in (5_000_000_000, 7_004_000_000)] == [0.0, 2.004]
    clock.reset()
    assert clock.elapsed(9_000_000_000) == 0.0


def test_guidance_is_built_from_the_parameters_of_its_node():
    values = {"vehicle": "x500", "position_controller": "geometric", "geometric.max_error": 1.5}
    values |= {
        "trajectories": ["circle radius=3"],
        "references": ["hold angles=0.1"],
        "setpoint.max_speed": 1.0,
    }
    assert [node_values(each, "")["radius"] for each in flight_guidance_from(values).trajectories] == [3.0]
    assert flight_guidance_from(values).loop.controller.max_error == 1.5
    assert live_guidance_from(values).smooth.max_speed == 1.0
    assert dataclasses.astuple(stand_guidance_from(values).references[0]) == ((0.1, 0.1, 0.1),)
