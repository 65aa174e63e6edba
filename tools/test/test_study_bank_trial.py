"""The trial of fault observers: what it records, how it adds faults, how it counts."""

import numpy as np
import pytest

from quadftc_cli.commands import BAD_INPUT
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.arrays import rows_of
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import FaultObserverInputs
from quadftc_model.vehicle import load_vehicle
from quadftc_tools.study import bank_trial
from quadftc_tools.study.bank_trial import ATTITUDE, GYRO, KINDS, NOBODY, PUSH, Fault, Kind, Verdict

STEP = "gyro: step of 0.15 to 0.5 rad/s"
START, SIZE = 6.5, 8.0  # s, rad/s²


@pytest.fixture(scope="module")
def recorded():
    """A flight, the same with a push about pitch, and the period of the samples."""
    torque = SIZE * load_vehicle("qball_x4").inertia
    healthy, dt = bank_trial.record_flight(1003, START, np.zeros(3))
    pushed, _ = bank_trial.record_flight(1003, START, torque * [0.0, 1.0, 0.0])
    return healthy, pushed, dt


def test_a_push_moves_one_axis_from_its_start_on(recorded):
    healthy, pushed, dt = recorded
    onset = round(START / dt)
    for one, other in zip((*healthy.imu[:3], healthy.torque), (*pushed.imu[:3], pushed.torque), strict=True):
        assert np.array_equal(one[:onset], other[:onset])
    after = round(0.012 / dt)  # before the controller has reacted much
    moved = (pushed.imu.body_rate - healthy.imu.body_rate)[onset + after]
    assert moved[1] == pytest.approx(SIZE * 0.012, rel=0.2)
    assert np.all(np.abs(moved[[0, 2]]) < 0.02)


def test_the_torque_is_what_acted_since_the_sample_before(recorded):
    """Rate by torque, over 0.2 s of the push: torque and push, with gusts and the rotors' lag left."""
    healthy, pushed, dt = recorded
    onset, rows = round(START / dt), round(0.2 / dt)
    inertia = load_vehicle("qball_x4").inertia[1]
    apart = pushed.torque[:, 1] - healthy.torque[:, 1]
    by_torque = np.cumsum(apart[onset : onset + rows])[-1] * dt / inertia
    moved = (pushed.imu.body_rate - healthy.imu.body_rate)[onset + rows, 1]
    assert abs(by_torque) > 0.3  # the controller works against it
    assert moved == pytest.approx(SIZE * 0.2 + by_torque, abs=0.15)


@pytest.mark.parametrize(("power", "late"), [(0, 0.02), (1, 0.004)])
def test_a_fault_is_added_to_its_sensor_and_axis_alone(recorded, power, late):
    imu, dt = rows_of(recorded[0].imu, slice(0, 51)), recorded[2]
    by_gyro = bank_trial.with_fault(imu, Fault(Kind(GYRO, power=power), 2, 0.02), dt)
    assert (by_gyro.body_rate - imu.body_rate)[-1] == pytest.approx([0.0, 0.0, late])
    assert np.array_equal(by_gyro.q_xyzw, imu.q_xyzw)
    by_attitude = bank_trial.with_fault(imu, Fault(Kind(ATTITUDE, power=power), 0, 0.02), dt)
    moved = euler_from_quaternion(by_attitude.q_xyzw) - euler_from_quaternion(imu.q_xyzw)
    assert moved[-1] == pytest.approx([late, 0.0, 0.0])
    assert np.array_equal(by_attitude.body_rate, imu.body_rate)


def words(rows, *named):
    """Words of some rows: (row, sensor, axis) from which on one is named."""
    said = np.zeros((rows, 3, 3), bool)
    for row, sensor, axis in named:
        said[row:, sensor, axis] = True
    return said


@pytest.mark.parametrize(
    ("kind", "named", "ambiguous", "expected"),
    [
        (GYRO, [(3, GYRO, 1)], [], Verdict(0.03, False, False)),
        (GYRO, [(3, GYRO, 1), (5, GYRO, 2)], [], Verdict(0.03, True, False)),
        (GYRO, [(3, ATTITUDE, 1)], [(1, GYRO, 1)], Verdict(None, True, False)),
        (GYRO, [], [(4, GYRO, 1)], Verdict(None, False, True)),
        (ATTITUDE, [(0, ATTITUDE, 1)], [(1, GYRO, 1)], Verdict(0.0, False, False)),
        (PUSH, [(8, GYRO, 1)], [], Verdict(None, True, False)),
        (NOBODY, [], [], Verdict(None, False, False)),
    ],
)
def test_a_flight_is_judged_by_what_is_named_and_when(kind, named, ambiguous, expected):
    verdict = bank_trial.verdict_of(words(10, *named), words(10, *ambiguous), Fault(Kind(kind), 1, 0.1), 0.01)
    assert verdict == expected


def test_the_table_has_shares_and_times():
    verdicts = [Verdict(0.1, False, False)] * 7 + [Verdict(0.5, True, False), Verdict(None, False, True)]
    verdicts.append(Verdict(None, True, False))
    judged = [bank_trial.Judged(STEP, "bank", each) for each in verdicts]
    judged += [bank_trial.Judged(STEP, "isolating", Verdict(None, False, False))]
    judged += [bank_trial.Judged("none", "bank", Verdict(None, False, False))]
    *_, none, step, other = bank_trial.tabulate(judged).splitlines()
    assert step == f"| {STEP} | 10 | `bank` | 80 % | 20 % | 10 % | 100/360/500 ms |"
    assert other == "|  |  | `isolating` | 0 % | 0 % | 0 % | - |"
    assert none == "| none | 1 | `bank` | - | 0 % | 0 % | - |"


def test_what_follows_an_onset_is_as_in_the_whole_flight(recorded):
    """Observers go on from a state of C that was copied at the onset."""
    healthy, dt = recorded[0], recorded[2]
    seed, observer = 1003, "isolating"
    judged = {each.kind: each.verdict for each in bank_trial.judge_flight(seed, [observer])}
    start, faults = bank_trial.draw_faults(seed)
    onset = int(np.ceil(start / dt))
    faulty = bank_trial.with_fault(rows_of(healthy.imu, slice(onset, None)), faults[STEP], dt)
    imu = type(faulty)(*(np.concatenate([a[:onset], b]) for a, b in zip(healthy.imu, faulty, strict=True)))
    inputs = FaultObserverInputs(imu, healthy.torque, driven=healthy.driven)
    runner = bank_trial.runner_of(observer)
    state, _ = runner.first(rows_of(inputs, 0))
    _, estimate = runner.run(state, rows_of(inputs, slice(1, None)), np.full(len(imu.body_rate) - 1, dt))
    said = (each[onset - 1 :] for each in bank_trial.words_of(estimate))
    assert judged[STEP] == bank_trial.verdict_of(*said, faults[STEP], dt)
    assert judged[STEP].delay == pytest.approx(0.008)  # docs/isolating.md: in three samples
    assert set(judged) == set(KINDS)


def test_seeds_of_tuning_and_of_judging_are_apart():
    tuning, judging = (set(bank_trial.seeds_of(part, 100)) for part in ("tuning", "judging"))
    assert len(tuning | judging) == 200
    onset, faults = bank_trial.draw_faults(1003)
    assert 6.0 <= onset < 9.0
    assert all(each.kind.smallest <= abs(each.size) <= each.kind.largest for each in faults.values())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--flights", "101", "--set", "tuning"], "--flights 101: expected 1 to 100 of tuning"),
        (["--flights", "0"], "--flights 0: expected"),
        (["--flights", "1", "--observer", "nobody"], "'nobody'"),
        (["--flights", "1", "--observer", "supervised"], "'supervised': expected one that says which sensor"),
    ],
)
def test_wrong_input_is_a_line(capsys, arguments, message):
    assert "supervised" in fault_observers.names()
    assert bank_trial.main(arguments) == BAD_INPUT
    assert message in capsys.readouterr().err
