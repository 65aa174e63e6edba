"""When a sensor that was named is believed again: once its fault would show, and does not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from quadftc_fdi.bank import trust
from quadftc_fdi.bank.motion import BETA, STATES, WALK, Motion, start_motion
from quadftc_fdi.bank.noise import noise_of, start_learning
from quadftc_fdi.bank.readings import BACK
from quadftc_fdi.bank.trust import Trust
from quadftc_model.rotations import quaternion_from_euler

DT = 0.004
NONE = np.zeros(3)
SPREAD = 1e-3  # rad, rad/s
NAMED = np.array([False, True, False])
MOVES = 0.2  # rad, amplitude of a sine of 1 rad/s
Fault = Callable[[float, float, float], float]  # of angle, rate, acceleration


def moving(angle: float, rate: float, bias: float = 0.0) -> Motion:
    level = quaternion_from_euler(NONE)
    started = start_motion(level, NONE, noise_of(start_learning(level, NONE), np.True_, 0.0))
    P = np.zeros((3, STATES, STATES))
    P[..., BETA, BETA] = SPREAD**2
    angles, rates, biases = (np.array([0.0, value, 0.0]) for value in (angle, rate, bias))
    return started._replace(
        q_xyzw=quaternion_from_euler(angles), rate=rates, bias=biases, unknown=NONE, covariance=P
    )


def watched(state: Trust, sensor: str, fault: Fault, begin: float, seconds: float, moves: float) -> Trust:
    for k in range(round(seconds / DT)):
        t = begin + k * DT
        angle, rate, acceleration = moves * np.sin(t), moves * np.cos(t), -moves * np.sin(t)
        named = NAMED & (not state.faulty.any()) & (begin == 0.0)
        error = fault(angle, rate, acceleration)
        if sensor == "gyro":
            motion = moving(angle, rate, bias=error)
            known = np.array([0.0, acceleration, 0.0])
            state = trust.watch_gyro(state, named, np.float64(0.0), motion, known, NONE, NONE, DT)
        else:
            off, variance = np.array([0.0, error, 0.0]), NONE + SPREAD**2
            motion, there = moving(angle, rate), np.array(True)
            now = np.float64(0.0)
            state = trust.watch_attitude(state, named, now, off, variance, variance, there, motion, DT)
    return state


FAULTS = {
    ("gyro", "scale"): lambda angle, rate, acceleration: 0.5 * rate,
    ("gyro", "delay"): lambda angle, rate, acceleration: -0.2 * acceleration,
    ("attitude", "scale"): lambda angle, rate, acceleration: 0.5 * angle,
    ("attitude", "delay"): lambda angle, rate, acceleration: -0.2 * rate,
}


@pytest.mark.parametrize(("sensor", "kind"), FAULTS)
def test_a_fault_of_the_motion_is_not_over_while_nothing_moves(sensor: str, kind: str) -> None:
    state = watched(trust.full_trust(NONE), sensor, FAULTS[sensor, kind], 0.0, 6.0, MOVES)
    state = watched(state, sensor, lambda *_: 0.0, 6.0, 10.0, 0.0)
    assert state.faulty.tolist() == NAMED.tolist()
    state = watched(state, sensor, lambda *_: 0.0, 16.0, 3.0, MOVES)
    assert not state.faulty.any()


@pytest.mark.parametrize("sensor", ["gyro", "attitude"])
def test_an_offset_is_over_when_it_is_gone(sensor: str) -> None:
    state = watched(trust.full_trust(NONE), sensor, lambda *_: 0.1, 0.0, 6.0, MOVES)
    assert state.faulty.tolist() == NAMED.tolist()
    assert not watched(state, sensor, lambda *_: 0.0, 6.0, trust.AGREES + BACK, 0.0).faulty.any()


def test_noise_is_over_when_it_is_gone() -> None:
    noise = np.random.default_rng(1)
    state = watched(trust.full_trust(NONE), "gyro", lambda *_: noise.normal(0.0, 0.1), 0.0, 6.0, MOVES)
    assert state.faulty.tolist() == NAMED.tolist()
    assert not watched(state, "gyro", lambda *_: 0.0, 6.0, 2 * BACK, 0.0).faulty.any()


def test_a_gyro_that_was_blamed_for_the_attitude_has_the_bias_that_it_had() -> None:
    """Without a torque nothing has told it meanwhile: what the bias became is the attitude's error."""
    blamed = trust.full_trust(NONE)._replace(faulty=NAMED, other=NONE + 0.01, age=NONE + 4.0)
    motion = moving(0.0, 0.0, bias=0.2)
    after = trust.as_before(motion._replace(covariance=motion.covariance + SPREAD), blamed, NAMED)
    assert after.bias.tolist() == [0.0, 0.01, 0.0]
    P = after.covariance[1]
    assert P[BETA, BETA] == pytest.approx(4.0 * WALK**2)
    assert not np.delete(P[BETA], BETA).any()
    np.testing.assert_array_equal(after.covariance[0], motion.covariance[0] + SPREAD)
