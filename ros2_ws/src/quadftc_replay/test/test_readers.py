"""Readers of flight logs: real logs of every format, and what damage does."""

from __future__ import annotations

import os

import numpy as np
import pytest

from quadftc_bags.bag import BagError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay import thinning
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers import read_log
from quadftc_replay.readers.crazyflie import distribute
from quadftc_replay.readers.layouts import FRAMES, frame_layout
from quadftc_replay.readers.signals import NAMED, good_stamps, sound
from recorded_logs import DATA, needs_data


def held(log: FlightLog) -> set[str]:
    """Names of the signals that a log has."""
    names = {name for name in NAMED if getattr(log, name)}
    others = "attitude body_rate position velocity acceleration rotor_speeds "
    others += "rotor_commands torque_command thrust_command battery"
    return names | {name for name in others.split() if getattr(log, name) is not None}


@needs_data
@pytest.mark.parametrize(
    ("path", "signals"),
    [
        ("crazyflie/sysid/log10", "gyros accelerometers rotor_commands"),
        ("crazyflie/crazyswarm2/log08", "gyros attitude position velocity torque_command thrust_command"),
        (
            "crazyflie/crazypad/motor_data-normal_flight-E9_log00",
            "position velocity acceleration rotor_commands battery",
        ),
        ("crazyflie/crazypad/controller_data-normal_flight-E8_log00", "gyros position rotor_commands"),
        (
            "px4/battery_brownout.ulg",
            "gyros accelerometers magnetometers barometers attitude position velocity acceleration"
            " rotor_commands torque_command thrust_command battery",
        ),
        (
            "px4/motor_failure.ulg",
            "gyros accelerometers magnetometers barometers gps_positions gps_velocities gps_status attitude"
            " position velocity acceleration rotor_speeds rotor_commands torque_command thrust_command"
            " battery",
        ),
    ],
)
def test_real_log_gives_what_it_holds(path, signals):
    log = read_log(DATA / path)
    assert held(log) == set(signals.split())
    assert log.rotor_positions is not None
    assert log.rotor_positions.shape == (4, 2)
    # opposite rotors turn alike, neighbours against each other
    x, y = log.rotor_positions.T
    assert len(set((np.sign(x * y) * log.rotor_yaw_signs).tolist())) == 1
    for force in log.accelerometers.values():
        assert np.median(np.linalg.norm(force.value, axis=1)) == pytest.approx(9.8, rel=0.4)
    if log.rotor_commands is not None:
        assert np.nanmin(log.rotor_commands.value) >= 0.0
        assert 0.4 < np.nanmax(log.rotor_commands.value) <= 1.0


@needs_data
def test_real_attitude_turns_with_the_gyro():
    for path in ("crazyflie/crazyswarm2/log08", "px4/battery_brownout.ulg"):
        log = read_log(DATA / path)
        assert log.attitude is not None
        assert log.attitude_from_gyro
        angles = np.unwrap(euler_from_quaternion(log.attitude.value), axis=0)
        time, gyro = log.attitude.time, log.gyros[""]
        for axis in (0, 1):
            turned = np.gradient(angles[:, axis], time)
            measured = np.interp(time, gyro.time, gyro.value[:, axis])
            assert np.corrcoef(turned, measured)[0, 1] > 0.4, (path, axis)


@needs_data
@pytest.mark.parametrize(
    "name",
    [
        "px4/motor_failure.ulg",
        "crazyflie/crazyswarm2/log104",
        "crazyflie/crazypad/motor_data-normal_flight-E9_log00",
        "broad/10_slow_translation_a/10_slow_translation_a_0.mcap",
    ],
)
def test_damaged_real_log_is_read_or_refused_in_one_line(tmp_path, name):
    whole, rng = (DATA / name).read_bytes(), np.random.default_rng(4)
    path = tmp_path / "log"
    for trial in range(4 if len(whole) > 5_000_000 else 16):
        data = bytearray(whole[: rng.integers(1, len(whole))] if trial % 4 == 0 else whole)
        # bits of the beginning, of all, or a whole piece
        if trial % 4 == 1:
            for place in rng.integers(4, min(len(data), 20_000), 20).tolist():
                data[place] = int(rng.integers(256))
        elif trial % 4 == 2:
            for place in rng.integers(0, len(data), 500).tolist():
                data[place] ^= 1 << int(rng.integers(8))
        elif trial % 4 == 3:
            place = int(rng.integers(len(data) - 2000))
            data[place : place + 2000] = rng.bytes(2000)
        path.write_bytes(data)
        problem = ""
        try:
            log = read_log(path)
            assert log.end < 7200.0
            assert all(np.all(np.diff(gyro.time) > 0.0) for gyro in log.gyros.values())
        except BagError as error:
            problem = str(error)
        assert "\n" not in problem
        assert not problem or problem.startswith(str(path))


@needs_data
@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("px4/motor_failure.ulg", 128),
        ("crazyflie/crazyswarm2/log104", 256),
        ("broad/10_slow_translation_a/10_slow_translation_a_0.mcap", 2**15),
    ],
)
def test_long_log_is_thinned_out_and_says_so(name, most, monkeypatch):
    whole = read_log(DATA / name).gyros[""]
    monkeypatch.setattr(thinning, "MOST", most)
    log = read_log(DATA / name)
    few = log.gyros[""]
    assert most // 2 <= len(few) <= most
    stride = round(len(whole) / len(few))
    np.testing.assert_array_equal(few.value, whole.value[::stride])
    np.testing.assert_allclose(np.diff(few.time), np.diff(whole.time[::stride]), atol=1e-9)
    assert any(f"one in {stride} was read" in note for note in log.notes)


def test_damaged_parameters_are_left_out():
    damaged = {"a": 4.0, "b": float("nan"), "c": 1e30, "d": b"\x00", "e": 3}
    assert sound(damaged) == {"a": 4.0, "e": 3.0}


@pytest.mark.parametrize("content", [b"", b"\xbc\x09", b"ULog", b"not a log at all", b"\x7fELF"])
def test_other_file_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "log"
    path.write_bytes(content)
    with pytest.raises(BagError, match="expected a log of one of the formats") as caught:
        read_log(path)
    assert "\n" not in str(caught.value)


def test_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "log")
    with pytest.raises(BagError, match="neither a file nor a directory"):
        read_log(tmp_path / "log")


def test_one_damaged_stamp_costs_one_sample():
    stamps = np.arange(100) * 1_000_000
    for damaged in (2**60, -5):
        stamps[40] = damaged
        rows, complaint = good_stamps(stamps)
        assert np.setdiff1d(np.arange(100), rows).tolist() == [40]
        assert complaint.startswith("1 of 100 samples")
    assert good_stamps(np.append(np.arange(5), 2**60))[0].tolist() == [0, 1, 2, 3, 4]


def test_pid_commands_are_distributed_and_capped_as_in_the_firmware():
    commands = np.array(
        [[40000.0, 2001.0, 0.0, 0.0], [60000.0, 0.0, 20000.0, 0.0], [1000.0, 4000.0, 0.0, 0.0]]
    )
    expected = [
        [39000, 39000, 41000, 41000],
        [65535, 45535, 45535, 65535],
        [0, 0, 3000, 3000],
    ]
    np.testing.assert_allclose(distribute(commands) * 65535.0, expected)


@pytest.mark.parametrize(("rotors", "frame"), list(FRAMES))
def test_rotors_of_usual_frames_are_spread_and_balanced(rotors, frame):
    layout = frame_layout(rotors, frame)
    assert layout is not None
    np.testing.assert_allclose(layout.positions.sum(axis=0), 0.0, atol=1e-12)
    assert layout.yaw_signs.sum() == 0.0
    assert len(np.unique(layout.positions.round(6), axis=0)) == rotors
