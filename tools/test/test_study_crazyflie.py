"""The study on real gyros: the model is found again in flights made with it, steps are judged by hand."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import pytest

from quadftc_model.vehicle import load_vehicle
from quadftc_replay.imu_from_usdlog import CrazyflieFlight
from quadftc_tools.study.acceleration_model import (
    AccelerationModel,
    Motion,
    acceleration,
    explained,
    fit_model,
    lagged_torque,
    predict,
)
from quadftc_tools.study.crazyflie import BEFORE, TAKE_OFF, Entry, Log, in_flight, run_tests
from quadftc_tools.study.gyro_steps import (
    CASES,
    EVERY,
    SETTLE,
    JumpTest,
    Named,
    Recorded,
    Sample,
    delays,
    judge,
    onset_rows,
    rates,
)

RATE = 250.0  # Hz
TRUTH = AccelerationModel(np.array([0.03, 0.06, 0.015]), np.array([0.5, 0.8, 1.5]))


def flight(seconds: float = 6.0, seed: int = 0, noise: float = 0.0, offset: float = 0.0) -> Motion:
    """A flight that follows the model, under random commands; time stamps are uneven."""
    generator = np.random.default_rng(seed)
    count = int(seconds * RATE)
    time = np.cumsum(generator.uniform(0.5, 1.5, count)) / RATE
    torque = np.repeat(generator.normal(0.0, 30.0, (count // 10 + 1, 3)), 10, axis=0)[:count]
    motion = Motion(time, np.zeros((count, 3)), torque)
    change = (predict(TRUTH, motion) + offset) * np.diff(time)[:, None]
    rate = np.vstack([np.zeros(3), np.cumsum(change, axis=0)])
    return motion._replace(body_rate=rate + generator.normal(0.0, noise, rate.shape))


def test_lagged_torque_is_the_exact_response_to_a_held_command():
    time = np.array([0.0, 0.01, 0.05])
    torque = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    means = lagged_torque(Motion(time, torque, torque), np.array([0.02, 0.04, 1e9]))
    # of 1 - exp(-t / T) over 0.04 s
    expected = [1.0 - T / 0.04 * (1.0 - np.exp(-0.04 / T)) for T in (0.02, 0.04)]
    np.testing.assert_allclose(means[0], 0.0)
    np.testing.assert_allclose(means[1], [*expected, 0.0], atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 5.0])
def test_fit_finds_lag_and_gain_whatever_the_constant_disturbance(offset):
    motions = [flight(seed=seed, noise=0.005, offset=offset) for seed in (1, 2)]
    model = fit_model(motions)
    np.testing.assert_allclose(model.lag, TRUTH.lag)
    np.testing.assert_allclose(model.gain, TRUTH.gain, rtol=0.02)
    assert np.all(explained(model, flight(seed=3, noise=0.005)) > 0.95)


def test_model_of_nothing_explains_nothing():
    none = AccelerationModel(TRUTH.lag, np.zeros(3))
    np.testing.assert_allclose(explained(none, flight()), 0.0, atol=1e-12)


def recorded(motion: Motion, q_xyzw: Any = None, flying: Any = None) -> Recorded:
    drive = np.vstack([np.zeros(3), predict(TRUTH, motion)])
    flying = np.ones(len(motion.time), np.bool_) if flying is None else flying
    return Recorded(motion.time, motion.body_rate, q_xyzw, drive, flying)


def test_jump_test_finds_every_step_at_once_and_nothing_else():
    result = judge(JumpTest(), recorded(flight(noise=0.005)))
    for size in (0.2, 0.4):
        found = rates([result], size)
        assert found.steps == len(onset_rows(recorded(flight()))) * len(CASES) // 2
        assert found.found == (1.0, 1.0)
        assert found.isolated == 1.0
    assert delays([result]).max() == 0.0
    assert result.alarms.tolist() == [0, 0, 0]
    assert result.hours == pytest.approx(6.0 / 3600.0, rel=0.02)


def test_jump_test_without_the_torque_misses_steps():
    motion = flight(noise=0.005)
    blind = recorded(motion)._replace(drive=np.zeros((len(motion.time), 3)))
    assert rates([judge(JumpTest(), blind)], 0.2).found[0] < 0.5


def test_steps_that_are_late_on_another_axis_or_given_to_another_sensor_count_so():
    @dataclasses.dataclass(frozen=True)
    class Scripted:
        """Names an axis once its reading has been off for some time; blames what it is told."""

        late: float
        shift: int = 0
        blames_other: bool = False

        class State(NamedTuple):
            time: Any

        def start(self, sample: Sample) -> State:
            return self.State(np.zeros(sample.gyro.shape))

        def step(self, state: State, sample: Sample, dt: float) -> tuple[State, Named]:
            time = np.where(np.abs(sample.gyro) > 0.1, state.time + dt, 0.0)
            named = np.roll(time > self.late, self.shift, axis=-1)
            return self.State(time), Named(named, named if self.blames_other else named & False)

    quiet = recorded(flight())._replace(gyro=np.zeros((1500, 3)))
    prompt = rates([judge(Scripted(0.0), quiet)], 0.2)
    assert (prompt.found, prompt.isolated) == ((1.0, 1.0), 1.0)
    late = rates([judge(Scripted(0.05), quiet)], 0.2)
    assert (late.found, late.isolated) == ((0.0, 1.0), 1.0)
    wrong = rates([judge(Scripted(0.0, shift=1), quiet)], 0.2)
    assert (wrong.found, wrong.isolated) == ((0.0, 0.0), 0.0)
    blamed = rates([judge(Scripted(0.0, blames_other=True), quiet)], 0.2)
    assert (blamed.found, blamed.isolated) == ((1.0, 1.0), 0.0)


def test_alarms_are_counted_in_flight_and_elsewhere_and_spoil_no_rate():
    motion = flight(noise=0.002)
    rate = motion.body_rate.copy()
    rate[100:, 1] += 1.0  # before the flight
    rate[1000:, 2] += 1.0  # in it
    flying = np.arange(len(rate)) >= 300
    result = judge(JumpTest(), recorded(motion._replace(body_rate=rate), flying=flying))
    assert result.alarms.tolist() == [0, 0, 1]
    assert result.alarms_elsewhere.tolist() == [0, 1, 0]
    found = rates([result], 0.4)
    assert found.steps < result.verdicts.before.size // 2  # those that came while yaw was named are left out
    assert found.found == (1.0, 1.0)


def test_test_that_always_names_something_has_no_step_to_find():
    @dataclasses.dataclass(frozen=True)
    class Always:
        def start(self, sample: Sample) -> tuple[()]:
            return ()

        def step(self, state: tuple[()], sample: Sample, dt: float) -> tuple[tuple[()], Named]:
            return state, Named(np.ones(sample.gyro.shape, np.bool_), np.zeros(sample.gyro.shape, np.bool_))

    result = judge(Always(), recorded(flight(2.0)))
    assert rates([result], 0.2) == (0, (0.0, 0.0), 0.0)
    assert not np.isfinite(delays([result])).any()


def test_onsets_are_in_flight_and_leave_time_to_be_found():
    motion = flight()
    rows = onset_rows(recorded(motion, flying=motion.time < 4.0))
    times = motion.time[rows]
    assert times[0] >= motion.time[0] + SETTLE
    assert times[-1] <= 3.9 + 1.5 / RATE
    np.testing.assert_allclose(np.diff(times), EVERY, atol=1.5 / RATE)


def test_flight_is_between_take_off_and_crash():
    time = np.arange(0.0, 10.0, 0.01)
    motors = np.tile(np.where((time > 2.0) & (time < 9.0), 0.6, 0.0)[:, None], (1, 4))
    rate = np.zeros((len(time), 3))
    rate[time > 8.0, 1] = 3.0
    log = CrazyflieFlight(
        "fixedFrequency", (time * 1e9).astype(np.int64), rate, None, None, None, motors, None, {}, ()
    )
    inside = time[in_flight(log, time)]
    assert inside[0] == pytest.approx(2.0 + TAKE_OFF, abs=0.03)
    assert inside[-1] == pytest.approx(8.0 - BEFORE, abs=0.03)
    assert not in_flight(log._replace(motors=None), time)[:10].any()


def test_test_that_begins_in_flight_gets_the_logs_with_a_take_off_from_there_on():
    motion = flight()
    flying = motion.time > 2.0
    logs = [
        Log("sysid", name, motion, None, mask) for name, mask in (("ground", flying), ("air", flying | True))
    ]
    entries = {
        "jump": Entry(JumpTest(), ("no torque",)),
        "late": Entry(JumpTest(), ("no torque",), airborne=True),
    }
    both, late = run_tests(entries, logs, {"sysid": TRUTH})
    assert list(both.results) == [("sysid", "ground"), ("sysid", "air")]
    assert list(late.results) == [("sysid", "ground")]
    counts = [len(each.results["sysid", "ground"].verdicts.before) for each in (both, late)]
    assert counts[0] - counts[1] == SETTLE / EVERY  # it has to settle in flight


def test_acceleration_is_the_change_of_the_rate():
    motion = Motion(np.array([0.0, 0.5]), np.array([[0.0] * 3, [1.0, 2.0, 3.0]]), np.zeros((2, 3)))
    np.testing.assert_allclose(acceleration(motion), [[2.0, 4.0, 6.0]])


def test_vehicle_of_the_study_is_that_of_the_logs():
    assert load_vehicle("crazyflie_2x").inertia == pytest.approx([16.57e-6, 16.66e-6, 29.26e-6], rel=1e-3)
