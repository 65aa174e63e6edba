"""Logs of a Crazyflie's uSD card: every byte of the format, units and frames, damage, and what is refused."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from quadftc_bags.bag import BagError
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler
from quadftc_replay.flight_log import MAIN
from quadftc_replay.imu_from_log import recording_from_log
from quadftc_replay.readers import read_log
from quadftc_replay.usdlog import read_usdlog
from recorded_logs import DATA, needs_data

FIXED = "fixedFrequency"
ID = 65535
PERIOD_US = 4000
BOOT_US = 3_000_000
COUNT = 300
GYRO = ("gyro.x(f)", "gyro.y(f)", "gyro.z(f)")
QUATERNION = tuple(f"stateEstimate.q{axis}(f)" for axis in "xyzw")
DEGREES = ("stateEstimate.roll(f)", "stateEstimate.pitch(f)", "stateEstimate.yaw(f)")
LEE = tuple(f"ctrlLee.{name}{axis}(f)" for name in ("omega", "rpy", "torque") for axis in "xyz")


def log_bytes(events: dict[int, tuple[str, tuple[str, ...]]], rows: list[tuple], version: int = 2) -> bytes:
    """Write a log by the description of the format; a row is id, time and values."""
    parts = [struct.pack("<BHH", 0xBC, version, len(events))]
    for key, (name, variables) in events.items():
        parts += [struct.pack("<H", key), f"{name}\0".encode(), struct.pack("<H", len(variables))]
        parts += [f"{variable}\0".encode() for variable in variables]
    formats = {key: "".join(each[-2] for each in variables) for key, (_, variables) in events.items()}
    for key, time, *values in rows:
        parts.append(struct.pack(f"<H{'Q' if version == 2 else 'I'}{formats[key]}", key, time, *values))
    data = b"".join(parts)
    return data + struct.pack("<I", zlib.crc32(data))


def angles_at(time: float) -> np.ndarray:
    return np.array([0.3 * np.sin(3.0 * time), 0.2 * np.sin(2.0 * time), 0.4 + 0.5 * time])


def angle_rates_at(time: float) -> np.ndarray:
    return np.array([0.9 * np.cos(3.0 * time), 0.4 * np.cos(2.0 * time), 0.5])


def flight(attitude: tuple[str, ...] = QUATERNION, count: int = COUNT, begin: int = BOOT_US) -> bytes:
    """A turning flight, with gyro [deg/s] and attitude."""
    rows = []
    for k in range(count):
        time = 1e-6 * PERIOD_US * k
        rate = np.degrees(body_rates(angles_at(time), angle_rates_at(time)))
        if attitude == QUATERNION:
            values = quaternion_from_euler(angles_at(time))
        else:
            values = np.degrees(angles_at(time)) * [1.0, -1.0, 1.0]
        rows.append((ID, begin + k * PERIOD_US, *rate, *values))
    return log_bytes({ID: (FIXED, GYRO + attitude)}, rows)


def write(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "log00"
    path.write_bytes(data)
    return path


def refusal(path: Path, read=recording_from_log) -> str:
    with pytest.raises(BagError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)


@pytest.mark.parametrize("attitude", [QUATERNION, DEGREES])
def test_log_gives_si_units_and_the_frame_of_ros(tmp_path, attitude):
    recording = recording_from_log(write(tmp_path, flight(attitude)))
    time = PERIOD_US * 1e-6 * np.arange(COUNT)
    np.testing.assert_array_equal(recording.stamp_ns, (BOOT_US + PERIOD_US * np.arange(COUNT)) * 1000)
    expected = [body_rates(angles_at(each), angle_rates_at(each)) for each in time]
    np.testing.assert_allclose(recording.imu.body_rate, expected, atol=1e-6)
    angles = euler_from_quaternion(recording.imu.q_xyzw)
    np.testing.assert_allclose(angles, [angles_at(each) for each in time], atol=1e-6)
    assert not recording.imu.force_valid.any()
    assert recording.torque_topic is None
    assert recording.attitude_from_gyro


def test_controller_gives_rate_attitude_and_the_torque_that_acted_since_the_sample_before(tmp_path):
    rows = [
        (ID, BOOT_US + k * PERIOD_US, 0.1, 0.2, 0.3, 0.0, 0.4, 0.0, 1e-4 * k, 0.0, -1e-4) for k in range(5)
    ]
    recording = recording_from_log(write(tmp_path, log_bytes({ID: (FIXED, LEE)}, rows)))
    np.testing.assert_allclose(recording.imu.body_rate[2], [0.1, 0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(euler_from_quaternion(recording.imu.q_xyzw[2]), [0.0, 0.4, 0.0], atol=1e-6)
    np.testing.assert_allclose(recording.torque[:, 0], [0.0, 0.0, 1e-4, 2e-4, 3e-4], rtol=1e-6)
    assert recording.torque_topic == "torque command"


def test_old_frame_of_the_firmware_has_the_sign_of_pitch_turned(tmp_path):
    names = ("stateEstimateZ.rateRoll(h)", "stateEstimateZ.ratePitch(h)", "stateEstimateZ.rateYaw(h)")
    motors = tuple(f"motor.m{k}(I)" for k in (1, 2, 3, 4))
    rows = [(7, 10 * k, 100, -200, 300, 0, 65535, 13107, 0) for k in range(3)]
    log = read_log(write(tmp_path, log_bytes({7: ("estimate", names + motors)}, rows, version=1)))
    gyro = log.gyros[MAIN]
    assert gyro.time == pytest.approx([0.0, 0.01, 0.02])  # version 1 counts milliseconds
    np.testing.assert_allclose(gyro.value[1], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(log.rotor_commands.value[1], [0.0, 1.0, 0.2, 0.0])
    assert log.attitude is None


def test_events_of_several_kinds_are_told_apart(tmp_path):
    events = {
        ID: (FIXED, GYRO + QUATERNION),
        3: ("estTDOA", ("anchor(B)", "distance(e)")),
        4: ("never", ("x(i)",)),
    }
    rows = []
    for k in range(20):
        rows.append((ID, BOOT_US + k * PERIOD_US, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
        rows += [(3, BOOT_US + k * PERIOD_US + 7, k, 0.5)] * (k % 3)
    log = read_usdlog(write(tmp_path, log_bytes(events, rows)))
    assert log.warnings == ()
    assert {name: len(event.stamp_ns) for name, event in log.events.items()} == {
        FIXED: 20,
        "estTDOA": 19,
        "never": 0,
    }
    assert log.events["estTDOA"].columns["anchor"].max() == 19
    assert set(log.events["estTDOA"].columns["distance"]) == {0.5}


def test_rare_events_of_a_whole_log_are_kept(tmp_path):
    rows = [(1, 3_600_000_000 * k, k) for k in range(4)]  # an hour between two
    log = read_usdlog(write(tmp_path, log_bytes({1: ("landed", ("count(B)",))}, rows)))
    assert log.events["landed"].columns["count"].tolist() == [0, 1, 2, 3]
    assert log.warnings == ()


def test_log_cut_short_is_read_up_to_the_cut(tmp_path):
    data = flight()
    row = 10 + 4 * 7
    recording = recording_from_log(write(tmp_path, data[: -4 - 100 * row - 5]))
    assert len(recording) == COUNT - 101
    assert "cut short or damaged, no check sum (CRC-32) that matches" in recording.warnings[0]
    assert f"; {row - 5} bytes behind the last row" in recording.warnings[0]


def test_row_that_is_damaged_costs_no_other_row(tmp_path):
    data = bytearray(flight())
    row = 10 + 4 * 7
    begin = len(data) - 4 - COUNT * row
    data[begin + 50 * row] ^= 0xFF  # id
    data[begin + 90 * row + 8] ^= 0x10  # time: years later
    recording = recording_from_log(write(tmp_path, bytes(data)))
    assert len(recording) == COUNT - 2
    assert f"{2 * row} bytes at 2 places are no rows" in recording.warnings[0]


def test_changed_value_shows_in_the_check_sum(tmp_path):
    data = bytearray(flight())
    data[-10] ^= 1
    recording = recording_from_log(write(tmp_path, bytes(data)))
    assert len(recording) == COUNT
    assert "no check sum (CRC-32) that matches" in recording.warnings[0]


def test_signalling_nan_is_an_absent_body_rate(tmp_path):
    data = bytearray(flight())
    row = 10 + 4 * 7
    begin = len(data) - 4 - COUNT * row
    data[begin + 50 * row + 10 : begin + 50 * row + 14] = bytes.fromhex("0100807f")
    recording = recording_from_log(write(tmp_path, bytes(data)))
    assert np.flatnonzero(~recording.imu.rate_valid).tolist() == [50]


def stamped(tmp_path: Path, stamps_us: list[int]) -> Path:
    rows = [(ID, stamp, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0) for stamp in stamps_us]
    return write(tmp_path, log_bytes({ID: (FIXED, GYRO + QUATERNION)}, rows))


def test_stamps_that_repeat_or_go_back_are_left_out(tmp_path):
    recording = recording_from_log(stamped(tmp_path, [4000, 8000, 8000, 6000, 12000]))
    assert len(recording) == 3
    assert (np.diff(recording.stamp_ns) > 0).all()
    assert ": 2 of 5 " in recording.warnings[0]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "magic at byte 0: end of the file; expected a whole header"),
        (b"\x00" * 9, "magic at byte 0: 0x0; expected 0xbc"),
        (b"\xbc\x03\x00\x01\x00", "version at byte 1: 3; expected 1 or 2"),
        (b"\xbc\x02\x00\x00\x00", "number of events at byte 3: 0; expected at least 1"),
        (b"\xbc\x02\x00\x01\x00\xff\xffabc", "name of an event at byte 7: end of the file"),
        (
            b"\xbc\x02\x00\x01\x00\xff\xffa\x80\x00",
            r"name of an event at byte 7: b'a\x80'; expected printable",
        ),
        (b"\xbc\x02\x00\x01\x00\xff\xffa\x00\x01", "number of variables of 'a' at byte 9: end of the file"),
        (log_bytes({1: ("a", ("x(f)", "x(f)"))}, []), "event 'a' at byte 7: variable 'x' again"),
        (log_bytes({1: ("a", ("x(f)",)), 2: ("a", ("y(f)",))}, []), "event at byte 16: 'a' with id 2 again"),
        (log_bytes({1: ("a", ("x(s)",))}, []), "variable of 'a' at byte 11: 'x(s)'; expected name(type)"),
    ],
)
def test_wrong_header_is_refused_with_byte_field_and_expectation(tmp_path, data, words):
    path = write(tmp_path, data)
    assert words in refusal(path, read_usdlog)


@needs_data
def test_real_logs_are_whole_and_their_attitude_turns_with_their_gyro():
    logs = DATA / "crazyflie"
    for path in sorted((logs / "crazyswarm2").glob("log*"))[::3]:
        recording = recording_from_log(path)
        assert not any("check sum" in warning for warning in recording.warnings), path
        # over the whole log, the rates of the angles correlate with those that the gyro gives
        time = 1e-9 * recording.stamp_ns
        angles = euler_from_quaternion(recording.imu.q_xyzw)
        for axis in (0, 1):
            turned = np.gradient(angles[:, axis], time)
            assert np.corrcoef(turned, recording.imu.body_rate[:, axis])[0, 1] > 0.2, (path, axis)
    for name in ("log10", "log15"):
        log = read_log(logs / "sysid" / name)
        assert log.rotor_commands.value.max() <= 1.0
        force = log.accelerometers[MAIN].value[:1000]
        assert np.linalg.norm(force, axis=1).mean() == pytest.approx(9.81, rel=0.02)
