"""The noise that the observer bank learns: of a vehicle whose noise is known."""

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest
from in_c import fly_arrays

from quadftc_fdi.bank import noise
from quadftc_model.arrays import namespace, rows_of
from quadftc_model.rotations import turn

DEG = np.pi / 180.0
SECONDS, VEHICLES = 20.0, 8
CORRELATED, DAMPING = 1.0, 3.0  # s, 1/s; of the unknown acceleration, of the known one against the rate


class Readings(NamedTuple):
    gyro: np.ndarray
    known: np.ndarray
    q_xyzw: np.ndarray
    good: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Learner:
    """Learning as a law: its output is the noise."""

    def init(self, inputs):
        return noise.start_learning(inputs.q_xyzw, inputs.gyro), inputs

    def step(self, state, inputs, dt):
        learning, last = state
        good = inputs.good & (namespace(inputs.gyro).zeros_like(inputs.gyro) < 1.0)
        pairs = inputs.gyro, last.gyro, inputs.known, inputs.q_xyzw, last.q_xyzw
        learning = noise.learn(learning, *pairs, good, good, good, dt)
        return (learning, inputs), noise.noise_of(learning, np.True_, dt)


def readings(dt, gyro, unknown, attitude, wander):
    """Vehicles in gusts (samples, vehicles, ...); standard deviations [rad/s, rad/s², rad, rad/sqrt(s)]."""
    rng, shape = np.random.default_rng(1), (round(SECONDS / dt), VEHICLES, 3)
    keep = np.exp(-dt / CORRELATED)
    gusts = unknown * np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
    drift = wander * np.sqrt(dt) * rng.standard_normal(shape)
    q_xyzw, rate, pushed = np.tile([0.0, 0.0, 0.0, 1.0], (VEHICLES, 1)), np.zeros(shape[1:]), 0.0
    turns, rates, known = np.empty((*shape[:2], 4)), np.empty(shape), np.empty(shape)
    for k in range(shape[0]):
        pushed = keep * pushed + gusts[k]
        known[k] = -DAMPING * rate
        after = rate + (known[k] + pushed) * dt
        q_xyzw, rate = turn(q_xyzw, 0.5 * (rate + after) * dt + drift[k]), after
        turns[k], rates[k] = q_xyzw, rate
    turns = turn(turns, attitude * rng.standard_normal(shape))
    rates += gyro * rng.standard_normal(shape)
    return Readings(rates, known, turns, np.ones(shape[:2], bool))


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_white_noise_unknown_acceleration_and_wander_are_told_apart(rate):
    truth = {"gyro": 0.003, "unknown": 0.5, "attitude": 0.1 * DEG, "wander": 0.5 * DEG}
    seen = readings(1.0 / rate, **truth)
    flown = [fly_arrays(Learner(), rows_of(seen, (slice(None), k)), 1.0 / rate)[1] for k in range(VEHICLES)]
    found = {
        name: np.sqrt(np.mean([getattr(each, name)[-1] for each in flown])) for name in noise.Noise._fields
    }
    # the loudest of late counts of the gyro
    # half of the wander from sample to sample looks white, and the drift that is taken off is in part d
    truth["attitude"] = np.hypot(truth["attitude"], truth["wander"] * np.sqrt(0.5 / rate))
    for name, within in {"gyro": 0.15, "unknown": 0.15, "attitude": 0.03, "wander": 0.2}.items():
        assert found[name] == pytest.approx(truth[name], rel=within), name


def test_a_wander_far_below_the_noise_of_a_reading_is_found():
    seen = readings(0.004, 0.003, 0.5, 0.1 * DEG, 0.03 * DEG)  # 0.01 deg in a lag
    flown = [fly_arrays(Learner(), rows_of(seen, (slice(None), k)), 0.004)[1] for k in range(VEHICLES)]
    assert np.sqrt(np.mean([each.wander[-1] for each in flown])) == pytest.approx(0.03 * DEG, rel=0.4)


@pytest.mark.parametrize("rate", [100.0, 250.0])
def test_an_error_that_comes_and_goes_is_no_wander(rate):
    dt, sway = 1.0 / rate, 0.3 * DEG
    seen, rng = readings(dt, 0.003, 0.5, 0.1 * DEG, 0.02 * DEG), np.random.default_rng(4)
    keep, error = np.exp(-dt / noise.LONGER), sway * rng.standard_normal(seen.gyro.shape)
    for k in range(1, len(error)):
        error[k] = keep * error[k - 1] + np.sqrt(1.0 - keep**2) * error[k]
    seen = seen._replace(q_xyzw=turn(seen.q_xyzw, error))
    flown = [fly_arrays(Learner(), rows_of(seen, (slice(None), k)), dt)[1] for k in range(VEHICLES)]
    found, wander = (
        np.sqrt(np.mean([getattr(each, name)[-1] for each in flown])) for name in ("sway", "wander")
    )
    assert found == pytest.approx(sway, rel=0.25)
    assert wander < 0.8 * sway  # per root second; by the shorter lag alone it would be 2.2


def test_what_is_not_believed_teaches_as_little():
    seen = rows_of(readings(0.004, 0.003, 0.5, 0.1 * DEG, 0.5 * DEG), (slice(None), 0))
    state, good = noise.start_learning(seen.q_xyzw[0], seen.gyro[0]), np.array([1.0, 0.5, 0.0])
    for k in range(1, 500):
        pairs = seen.gyro[k], seen.gyro[k - 1], seen.known[k], seen.q_xyzw[k], seen.q_xyzw[k - 1]
        state = noise.learn(state, *pairs, good, good, good > 0.0, 0.004)
    assert state.gyro.time == pytest.approx(0.004 * 499 * good)
    assert state.attitude.time == pytest.approx(0.004 * 499 * good**2)


def test_a_fault_that_has_not_been_found_teaches_little():
    seen = rows_of(readings(0.004, 0.003, 0.5, 0.1 * DEG, 0.5 * DEG), (slice(None), 0))
    elapsed = np.arange(len(seen.gyro)) * 0.004 - 15.0
    jumps = seen._replace(gyro=seen.gyro + 0.5 * (elapsed >= 0.0)[:, None])
    healthy, faulty = (fly_arrays(Learner(), each, 0.004)[1] for each in (seen, jumps))
    after = int(np.argmax(elapsed > 0.3))  # the jump is behind both lags
    for name in noise.Noise._fields:
        was, now = (np.sqrt(getattr(each, name)[after]) for each in (healthy, faulty))
        usual = 0.5 * DEG * np.sqrt(noise.LONGER) * (name == "sway")  # none: less than what wanders meanwhile
        assert np.all(now < np.maximum(1.5 * was, usual)), name


@pytest.mark.parametrize(("share", "size"), [(0.02, 2.0), (0.06, 4.0)])
def test_spikes_of_a_gyro_teach_little(share, size):
    """Neither that noise lasts, nor that the vehicle is pushed."""
    clean = rows_of(readings(0.004, 0.003, 0.5, 0.1 * DEG, 0.5 * DEG), (slice(None), 0))
    spikes = size * (np.random.default_rng(3).random(clean.gyro.shape) < share)
    spikes[-50:] = 0.0  # the last is behind the longer lag
    flown = [
        fly_arrays(Learner(), each, 0.004)[1] for each in (clean, clean._replace(gyro=clean.gyro + spikes))
    ]
    for name, most in {"gyro": 30.0, "unknown": 8.0}.items():
        usual, spiky = (np.sqrt(getattr(each, name)[-1]) for each in flown)
        assert np.all(spiky < most * usual), (name, spiky / usual)


def test_noise_that_a_filter_has_smoothed_counts_as_long_as_it_lasts():
    seen, rng, keep = readings(0.001, 0.0, 0.5, 0.1 * DEG, 0.5 * DEG), np.random.default_rng(2), 0.8
    noise_of = 0.003 * rng.standard_normal(seen.gyro.shape)
    for k in range(1, len(noise_of)):
        noise_of[k] = keep * noise_of[k - 1] + np.sqrt(1.0 - keep**2) * noise_of[k]
    smooth = rows_of(seen._replace(gyro=seen.gyro + noise_of), (slice(None), 0))
    found = np.sqrt(fly_arrays(Learner(), smooth, 0.001)[1].gyro[-1])
    assert found == pytest.approx(0.003 * np.sqrt((1.0 + keep) / (1.0 - keep)), rel=0.25)


def test_vibration_that_comes_is_heard_at_once():
    seen = rows_of(readings(0.004, 0.003, 0.5, 0.1 * DEG, 0.5 * DEG), (slice(None), 0))
    loud = 0.03 * np.random.default_rng(3).standard_normal(seen.gyro.shape)
    begins = len(loud) - 25  # 0.1 s before the end
    loud[:begins] = 0.0
    found = np.sqrt(fly_arrays(Learner(), seen._replace(gyro=seen.gyro + loud), 0.004)[1].gyro)
    assert np.all(found[begins - 1] < 0.005)
    assert np.all(found[-1] > 0.015)


def test_without_a_torque_what_moves_the_vehicle_is_little_noise_of_the_gyro():
    dt = 0.004
    seen = readings(dt, gyro=0.003, unknown=200.0, attitude=0.1 * DEG, wander=0.0)
    told = rows_of(seen, (slice(None), 0))._replace(known=0.0 * seen.known[:, 0])
    state, good = noise.start_learning(told.q_xyzw[0], told.gyro[0]), np.ones(3, bool)
    for k in range(1, 2500):
        pairs = told.gyro[k], told.gyro[k - 1], told.known[k], told.q_xyzw[k], told.q_xyzw[k - 1]
        state = noise.learn(state, *pairs, good, good, good, dt)
    driven, free = (noise.noise_of(state, np.bool_(driven), dt).gyro for driven in (True, False))
    assert np.all((free < driven / 16.0) & (free > 0.003**2))
