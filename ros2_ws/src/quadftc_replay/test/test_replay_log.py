"""Replays of logs of any format, here of a table: the samples of an IMU on the clock of its gyro."""

from __future__ import annotations

import dataclasses
import gzip

import numpy as np
import pytest

from quadftc_bags.bag import BagError
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.flight_log import Signal
from quadftc_replay.imu_from_log import recording_from_log, recording_of
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.inspection.overlay import overlay_faults
from quadftc_replay.overlay import faults_from
from quadftc_replay.plan import ReplayOptions, plan_replay
from quadftc_replay.readers import LogChoice, read_log
from recorded_logs import DATA, needs_data

COUNT, PERIOD, EVERY = 400, 0.005, 10
MAPPING = """
attitude_from_gyro = true
[time]
column = "t"
[[signal]]
quantity = "gyro"
columns = ["wx", "wy", "wz"]
unit = "rad/s"
[[signal]]
quantity = "accelerometer"
columns = ["ax", "ay", "az"]
unit = "g"
[[signal]]
quantity = "attitude"
columns = ["qx", "qy", "qz", "qw"]
unit = "1"
[[signal]]
quantity = "torque_command"
columns = ["tx", "ty", "tz"]
unit = "N m"
"""


def angles_at(time: float) -> np.ndarray:
    return np.array([0.3 * np.sin(3.0 * time), 0.2 * np.sin(2.0 * time), 0.4 + 0.5 * time])


def rates_at(time: float) -> np.ndarray:
    turns = np.array([0.9 * np.cos(3.0 * time), 0.4 * np.cos(2.0 * time), 0.5])
    return np.asarray(body_rates(angles_at(time), turns))


def table() -> str:
    """A turning flight; the attitude stands in every tenth row alone."""
    lines = ["t,wx,wy,wz,ax,ay,az,qx,qy,qz,qw,tx,ty,tz"]
    for k in range(COUNT):
        time = PERIOD * k
        q = quaternion_from_euler(angles_at(time)).tolist() if k % EVERY == 0 else [""] * 4
        lines.append(",".join(map(str, [time, *rates_at(time), 0.0, 0.0, 1.0, *q, 0.001 * k, 0.0, 0.0])))
    return "\n".join(lines) + "\n"


@pytest.fixture
def choice(tmp_path):
    path = tmp_path / "mapping.toml"
    path.write_text(MAPPING)
    return LogChoice(mapping=path)


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "flight.csv"
    file.write_text(table())
    return file


def test_gyro_drives_and_the_others_belong_to_its_samples(path, choice):
    recording = recording_from_log(path, choice=choice)
    assert (recording.topic, recording.torque_topic, recording.attitude_from_gyro) == (
        *("gyro", "torque command"),
        True,
    )
    np.testing.assert_array_equal(recording.stamp_ns, 5_000_000 * np.arange(COUNT))
    np.testing.assert_allclose(recording.imu.body_rate, [rates_at(PERIOD * k) for k in range(COUNT)])
    rows = np.flatnonzero(recording.imu.attitude_valid)
    assert rows.tolist() == list(range(0, COUNT, EVERY))
    expected = [angles_at(PERIOD * row) for row in rows.tolist()]
    np.testing.assert_allclose(euler_from_quaternion(recording.imu.q_xyzw[rows]), expected, atol=1e-9)
    np.testing.assert_allclose(recording.imu.specific_force[3], [0.0, 0.0, 9.80665])
    np.testing.assert_allclose(recording.torque[:4, 0], [0.0, 0.0, 0.001, 0.002])


def test_vehicle_of_a_log_and_the_lag_of_its_rotors_reach_the_observer(path, choice):
    choice.mapping.write_text('vehicle = "crazyflie_2x"\n' + MAPPING)
    parameters = plan_replay(path, ReplayOptions(observer="bank", choice=choice)).observer.parameters
    assert parameters["vehicle"] == "crazyflie_2x"
    assert parameters["bank.rotor_lag"] == load_vehicle("crazyflie_2x").rotors.time_constant
    assert parameters["bank.feels_gravity"] is False
    asked = ReplayOptions(
        observer="bank", vehicle="x500", settings=("observer.rotor_lag=0.0",), choice=choice
    )
    parameters = plan_replay(path, asked).observer.parameters
    assert (parameters["vehicle"], parameters["bank.rotor_lag"]) == ("x500", 0.0)


def test_packed_log_is_replayed_with_an_overlaid_fault(path, choice):
    packed = path.with_suffix(".csv.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    faults = ("bias axis=yaw value=5deg start=1s",)
    plan = plan_replay(packed, ReplayOptions(observer="none", faults=faults, choice=choice))
    metrics = plan.summary(plan.diagnose())["metrics"]
    assert metrics["fault_estimate_rmse_inside_deg"]["yaw"] == pytest.approx(5.0)


def test_log_that_lacks_gyro_or_attitude_is_refused(path, choice):
    with pytest.raises(BagError, match="no gyro '1' in this CSV log; gyros there: the main one"):
        recording_from_log(path, "1", choice)
    for quantity, words in (("attitude", "no attitude in this CSV log"), ("gyro", "no gyro in this CSV log")):
        kept = [part for part in MAPPING.split("[[signal]]") if f'"{quantity}"' not in part]
        choice.mapping.write_text("[[signal]]".join(kept))
        with pytest.raises(BagError, match=words):
            recording_from_log(path, choice=choice)


def test_log_without_a_sample_of_its_attitude_is_refused(path, choice):
    log = read_log(path, choice)
    empty = dataclasses.replace(log, attitude=Signal(np.empty(0), np.empty((0, 4))))
    assert len(recording_of(log)) == COUNT
    with pytest.raises(BagError, match="no attitude in this CSV log"):
        recording_of(empty)


@needs_data
def test_real_log_of_two_imus_gives_either():
    path = DATA / "ardupilot/sitl/d_windy_fast.BIN"
    main, other = (plan_replay(path, ReplayOptions(topic=topic)).recording for topic in ("", "1"))
    for recording in (main, other):
        assert recording.attitude_from_gyro
        assert recording.imu.attitude_valid.sum() > 100
    assert len(main) == len(other)
    assert np.any(main.imu.body_rate != other.imu.body_rate)


@needs_data
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_small_step_of_the_gyro_is_no_fault_of_the_attitude_made_from_it(axis):
    log = read_log(DATA / "px4/pyulog/sample_appended_multiple.ulg")
    spec = f"bias axis={axis} value=0.2rad/s channel=gyro start=5.9s duration=2s"
    findings = inspect(overlay_faults(log, faults_from((), [spec]))).verdict.findings
    assert [(each.component, each.element) for each in findings] == [("gyro", axis)]
    assert abs(findings[0].onset_s - 5.9) < 0.02
