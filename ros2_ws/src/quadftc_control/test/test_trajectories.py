"""Trajectories: they begin at rest, derivatives are derivatives, and every one is smooth."""

import dataclasses

import numpy as np
import pytest

from quadftc_control.trajectory import PositionSetpoint, PositionSetpointFilter, combined, trajectories
from quadftc_model.assembly import build_prefixed, components_from, node_values
from quadftc_model.numbers import numbers_of, with_numbers
from quadftc_model.parameters import build, parameters_of
from quadftc_model.rotations import wrap
from quadftc_model.spec import format_spec

WINDOW = {"start": 1.0, "stop": 14.0}
POINTS = [[0.0, 0.0, 1.0], [2.0, 1.0, 1.5], [2.0, 1.0, 1.5], [-1.0, 0.5, 1.0]]
CASES = {
    "hover": ("hover", {"position": [1.0, -2.0, 3.0], "yaw": 0.3}),
    "circle": ("circle", {"speed": 2.0, **WINDOW}),
    "circle, clockwise, following": ("circle", {"speed": -1.0, "follow": True, "yaw": 0.5, **WINDOW}),
    "figure_eight": ("figure_eight", WINDOW),
    "figure_eight, following": ("figure_eight", {"follow": True, "width": 3.0, **WINDOW}),
    "waypoints by speed": ("waypoints", {"points": POINTS, "start": 1.0}),
    "waypoints by times": ("waypoints", {"points": POINTS, "times": [0.5, 3.0, 4.0, 9.0], "start": 1.0}),
}
EVERY = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
TIMES = np.linspace(0.05, 19.95, 80)


def made(case):
    return build(trajectories.get(case[0]), case[1])


def test_every_trajectory_is_tested():
    assert {name for name, _ in CASES.values()} >= set(trajectories.names())


@pytest.mark.parametrize("name", trajectories.names())
def test_parameters_are_documented_with_a_unit_and_defaults_are_valid(name):
    component = trajectories.get(name)
    assert all(spec.doc and spec.unit for spec in parameters_of(component))
    assert np.all(np.isfinite(component().sample(1.0).position))


@EVERY
def test_parameters_survive_the_way_through_a_node_and_through_a_line_of_text(case):
    law = made(case)
    again = build_prefixed(type(law), node_values(law, "r"), "r")
    assert dataclasses.asdict(again) == dataclasses.asdict(law)
    line = {"trajectories": [format_spec(*case)]}
    assert dataclasses.asdict(components_from(trajectories, line, "trajectories")[0]) == dataclasses.asdict(
        law
    )


@EVERY
def test_derivatives_are_the_derivatives(case):
    law, step = made(case), 1e-5
    for time in TIMES:
        before, now, after = (law.sample(float(time) + shift) for shift in (-step, 0.0, step))
        for name, slope in (("position", "velocity"), ("velocity", "acceleration"), ("acceleration", "jerk")):
            measured = (getattr(after, name) - getattr(before, name)) / (2 * step)
            np.testing.assert_allclose(getattr(now, slope), measured, atol=1e-6, rtol=1e-6)
        turned = wrap(after.yaw - before.yaw)
        np.testing.assert_allclose(now.yaw_rate, turned / (2 * step), atol=1e-6)


@EVERY
def test_trajectory_begins_and_ends_at_rest(case):
    for time in (0.0, 0.999, 40.0):
        sample = made(case).sample(time)
        for array in (sample.velocity, sample.acceleration, sample.jerk, sample.yaw_rate):
            np.testing.assert_allclose(array, 0.0, atol=1e-9)


@EVERY
def test_trajectory_has_no_jumps_up_to_its_jerk(case):
    sample = made(case).sample(np.linspace(0.0, 20.0, 20001))
    for array in (sample.position, sample.velocity, sample.acceleration, sample.jerk):
        assert np.max(np.abs(np.diff(array, axis=0))) < 0.1  # in 1 ms


@EVERY
def test_batch_of_times_and_jax_equal_the_loop(case):
    jax = pytest.importorskip("jax")
    law = made(case)
    TIMES.setflags(write=False)
    batch = law.sample(TIMES)
    with jax.enable_x64(True):
        unknown = jax.jit(lambda values, times: with_numbers(law, values).sample(times))
        compiled = jax.tree.map(np.asarray, unknown(numbers_of(law), TIMES))
        one = unknown(numbers_of(law), 7.3)
    assert one.position.shape == (3,)
    assert one.yaw.shape == ()
    for index, time in enumerate(TIMES):
        single = law.sample(float(time))
        for many in (batch, compiled):
            for name in single._fields:
                off = getattr(many, name)[index] - getattr(single, name)
                off = wrap(off) if name == "yaw" else off
                np.testing.assert_allclose(off, np.zeros(np.shape(getattr(single, name))), atol=1e-12)


def test_circle_has_its_radius_and_speed():
    law = build(trajectories.get("circle"), {"radius": 2.0, "speed": 1.5, "centre": [1.0, 2.0, 3.0]})
    sample = law.sample(np.linspace(3.0, 20.0, 50))
    np.testing.assert_allclose(np.linalg.norm(sample.position - [1.0, 2.0, 3.0], axis=1), 2.0, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sample.velocity, axis=1), 1.5, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sample.acceleration, axis=1), 1.5**2 / 2.0, rtol=1e-12)


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_heading_that_follows_points_along_the_flight(speed):
    law = build(
        trajectories.get("circle"), {"speed": speed, "follow": True, "yaw": 0.0 if speed > 0 else np.pi}
    )
    sample = law.sample(np.linspace(5.0, 20.0, 50))
    heading = np.stack([np.cos(sample.yaw), np.sin(sample.yaw)], axis=1)
    np.testing.assert_allclose(sample.velocity[:, :2], heading, atol=1e-12)


def test_figure_of_eight_is_geronos_lemniscate():
    law = build(
        trajectories.get("figure_eight"), {"length": 2.0, "width": 1.0, "period": 5.0, "centre": [0, 0, 1]}
    )
    x, y, z = law.sample(np.linspace(3.0, 9.0, 101)).position.T
    np.testing.assert_allclose(x**4, x**2 - y**2, atol=1e-12)
    np.testing.assert_allclose(z, 1.0)
    assert np.ptp(x) == pytest.approx(2.0, abs=2e-3)
    assert law.sample(10.0).position == pytest.approx(law.sample(15.0).position)


def test_waypoints_are_reached_in_time_and_within_the_bounds():
    timed = made(CASES["waypoints by times"])
    for point, time in zip(POINTS, (0.5, 3.0, 4.0, 9.0), strict=True):
        np.testing.assert_allclose(timed.sample(1.0 + time).position, point, atol=1e-12)
    fast = build(trajectories.get("waypoints"), {"points": POINTS, "speed": 1.2, "acceleration": 3.0})
    sample = fast.sample(np.linspace(0.0, 20.0, 4001))
    assert np.max(np.linalg.norm(sample.velocity, axis=1)) == pytest.approx(1.2, rel=1e-3)
    assert np.max(np.linalg.norm(sample.acceleration, axis=1)) <= 3.0
    np.testing.assert_allclose(sample.position[-1], POINTS[-1])
    short = build(trajectories.get("waypoints"), {"points": [0, 0, 0, 0.1, 0, 0], "acceleration": 3.0})
    sample = short.sample(np.linspace(0.0, 5.0, 4001))
    assert np.max(np.linalg.norm(sample.acceleration, axis=1)) == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"points": [1.0, 2.0]}, "points: .*rows of 3 numbers, in m"),
        ({"points": []}, "points: expected one at least"),
        ({"points": POINTS, "times": [1.0, 2.0]}, "times: expected 4 numbers"),
        ({"points": POINTS, "times": [1, 2, 2, 3]}, "each must be later than the one before"),
    ],
)
def test_wrong_waypoints_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        build(trajectories.get("waypoints"), values)


def test_window_that_ends_before_it_starts_is_refused():
    with pytest.raises(ValueError, match="stop = 1 s: must be later than start = 2 s"):
        build(trajectories.get("circle"), {"start": 2.0, "stop": 1.0})


def test_trajectories_add_up():
    parts = [made(CASES["hover"]), made(CASES["circle"])]
    total = combined(parts, 3.3)
    for field in total._fields:
        expected = getattr(parts[0].sample(3.3), field) + getattr(parts[1].sample(3.3), field)
        np.testing.assert_allclose(getattr(total, field), expected, rtol=1e-15)


def test_no_trajectory_means_the_origin():
    assert not any(np.any(each) for each in combined([], 1.0))


def followed(target, yaw, count=4000, dt=0.004):
    """All references on the way to a live setpoint, from the origin."""
    law = PositionSetpointFilter()
    state, out = law.init(PositionSetpoint(np.zeros(3), 0.0)), []
    for _ in range(count):
        state, reference = law.step(state, PositionSetpoint(np.array(target), yaw), dt)
        out.append(reference)
    return [np.array([getattr(each, name) for each in out]) for name in out[0]._fields[:5]]


def test_live_setpoint_is_reached_within_speed_and_acceleration():
    position, velocity, acceleration, yaw, yaw_rate = followed([8.0, -6.0, 1.0], 3.0)
    np.testing.assert_allclose(position[-1], [8.0, -6.0, 1.0], atol=1e-3)
    assert yaw[-1] == pytest.approx(3.0, abs=1e-3)
    assert np.max(np.linalg.norm(velocity, axis=1)) <= 2.0 + 1e-9
    assert np.max(np.linalg.norm(acceleration, axis=1)) <= 2.0 + 1e-9
    np.testing.assert_allclose(np.diff(velocity, axis=0), 0.004 * acceleration[1:], atol=1e-12)
    assert np.max(position[:, 0]) < 8.05
    assert np.max(yaw_rate) < 3.0


def test_live_setpoint_filter_starts_at_rest_at_the_setpoint():
    law, there = PositionSetpointFilter(), PositionSetpoint(np.array([1.0, 2.0, 3.0]), 0.4)
    _, reference = law.step(law.init(there), there, 0.0)
    assert reference.position.tolist() == [1.0, 2.0, 3.0]
    assert not np.any([reference.velocity, reference.acceleration])
