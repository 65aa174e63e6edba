"""PX4 logs: frames, which attitude belongs to which gyro sample, and what is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, quaternion_rate
from quadftc_replay.imu_from_log import recording_from_log
from quadftc_replay.imu_recording import nearest_rows, sampling_rate
from quadftc_replay.readers import read_log, ulog

GYRO_PERIOD_US = 5000  # 200 Hz
ATTITUDE_EVERY = 10  # gyro samples
COUNT = 400
BOOT_US = 3_000_000
GRAVITY = 9.81

FORMATS = {
    "vehicle_attitude": "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;uint8_t quat_reset_counter;",
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;int32_t accelerometer_timestamp_relative;"
    "float[3] accelerometer_m_s2;",
    "vehicle_angular_velocity": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
    "sensor_gyro": "uint64_t timestamp;float x;float y;float z;",
}
PACKING = {
    "vehicle_attitude": "<QQ4fB",
    "sensor_combined": "<Q3fi3f",
    "vehicle_angular_velocity": "<QQ3f",
    "sensor_gyro": "<Q3f",
}


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def write_ulog(path: Path, topics: dict[str, list[tuple]]) -> Path:
    """Write a log by the description of the format: header, flags, formats, subscriptions, data."""
    parts = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", BOOT_US), message("B", bytes(40))]
    parts += [message("F", f"{name}:{FORMATS[name]}".encode()) for name in topics]
    parts += [message("A", struct.pack("<BH", 0, k) + name.encode()) for k, name in enumerate(topics)]
    for number, (name, rows) in enumerate(topics.items()):
        for row in rows:
            parts.append(message("D", struct.pack("<H", number) + struct.pack(PACKING[name], *row)))
    path.write_bytes(b"".join(parts))
    return path


def frd(vector) -> list[float]:
    return [vector[0], -vector[1], -vector[2]]


def ned_wxyz(angles) -> list[float]:
    """PX4's quaternion of an attitude given as ROS's Euler angles [rad]."""
    roll, pitch, yaw = angles
    x, y, z, w = quaternion_from_euler(np.array([roll, -pitch, np.pi / 2 - yaw])).tolist()
    return [w, x, y, z]


def angles_at(time: float) -> np.ndarray:
    return np.array([0.3 * np.sin(3.0 * time), 0.2 * np.sin(2.0 * time), 0.4 + 0.5 * time])


def rate_at(time: float) -> np.ndarray:
    """Body rate, by differences of the quaternion: q' = q (omega, 0) / 2 is linear in omega."""
    step = 1e-5
    before, q, after = (quaternion_from_euler(angles_at(time + shift)) for shift in (-step, 0.0, step))
    columns = np.stack([quaternion_rate(q, unit) for unit in np.eye(3)], axis=-1)
    return 4.0 * columns.T @ ((after - before) / (2.0 * step))


def flight(attitude_lag_us: int = 0) -> dict[str, list[tuple]]:
    """A turning flight; attitudes are sampled late by ``attitude_lag_us``, and published another ms later."""
    attitudes, gyros = [], []
    for k in range(COUNT):
        stamp = BOOT_US + k * GYRO_PERIOD_US
        rate = frd(rate_at(1e-6 * stamp))
        gyros.append((stamp, *rate, 0, 0.0, 0.0, -GRAVITY))
        if k % ATTITUDE_EVERY == 0:
            sampled = stamp + attitude_lag_us
            attitudes.append((sampled + 1000, sampled, *ned_wxyz(angles_at(1e-6 * sampled)), 0))
    return {"vehicle_attitude": attitudes, "sensor_combined": gyros}


def test_gyro_drives_and_each_attitude_belongs_to_its_sample(tmp_path):
    recording = recording_from_log(write_ulog(tmp_path / "log.ulg", flight()))
    assert sampling_rate(recording.stamp_ns) == pytest.approx(200.0)
    assert len(recording) == COUNT
    rows = np.flatnonzero(recording.imu.attitude_valid)
    assert rows.tolist() == list(range(0, COUNT, ATTITUDE_EVERY))
    times = 1e-9 * recording.stamp_ns
    expected = np.array([angles_at(time) for time in times[rows]])
    np.testing.assert_allclose(euler_from_quaternion(recording.imu.q_xyzw[rows]), expected, atol=1e-6)
    np.testing.assert_allclose(recording.imu.body_rate, [rate_at(time) for time in times], atol=1e-6)
    np.testing.assert_allclose(
        recording.imu.specific_force, np.tile([0.0, 0.0, GRAVITY], (COUNT, 1)), rtol=1e-6
    )


@pytest.mark.parametrize("lag_us", [-2000, 2400])
def test_attitude_between_two_samples_is_carried_to_the_nearer(tmp_path, lag_us):
    recording = recording_from_log(write_ulog(tmp_path / "log.ulg", flight(lag_us)))
    rows = np.flatnonzero(recording.imu.attitude_valid)
    assert rows.tolist() == list(range(0, COUNT, ATTITUDE_EVERY))
    expected = np.array([angles_at(1e-9 * stamp) for stamp in recording.stamp_ns[rows]])
    error = np.abs(euler_from_quaternion(recording.imu.q_xyzw[rows]) - expected)
    assert error.max() < 5e-5  # the turn over the lag is up to 2e-3 rad


def test_of_faster_attitudes_the_nearest_is_taken_and_in_a_gap_none():
    gyro = np.array([0, 10, 20, 30, 130, 140])
    attitude = np.array([1, 4, 9, 12, 19, 24, 80, 139])
    assert nearest_rows(gyro, attitude).tolist() == [0, 2, 4, -1, -1, 7]


def test_angular_velocity_serves_where_there_is_no_sensor_combined(tmp_path):
    topics = flight()
    combined = topics.pop("sensor_combined")
    topics["vehicle_angular_velocity"] = [(row[0] + 700, row[0], *row[1:4]) for row in combined]
    recording = recording_from_log(write_ulog(tmp_path / "log.ulg", topics))
    assert recording.topic == "gyro"
    assert recording.stamp_ns[0] == 1000 * BOOT_US  # when it was sampled
    assert not recording.imu.force_valid.any()
    assert recording.imu.attitude_valid.sum() == COUNT // ATTITUDE_EVERY


def test_reset_of_the_estimator_is_reported(tmp_path):
    topics = flight()
    topics["vehicle_attitude"] = [
        (*row[:-1], int(k >= 20)) for k, row in enumerate(topics["vehicle_attitude"])
    ]
    warnings = recording_from_log(write_ulog(tmp_path / "log.ulg", topics)).warnings
    assert "has reset the attitude 1 times, at 1.00 s: no fault" in warnings[0]


def message_starts(data):
    """Where the messages of a ULog begin: behind its head of 16 bytes, each with the size of its content."""
    at = 16
    while at + 3 <= len(data):
        yield at
        at += 3 + int.from_bytes(data[at : at + 2], "little")


@pytest.mark.parametrize("kept", [1, 2, 3, 4], ids=lambda kept: f"{kept} bytes of a message")
def test_log_cut_short_is_read_up_to_the_cut(tmp_path, kept):
    path = write_ulog(tmp_path / "log.ulg", flight())
    whole = path.read_bytes()
    path.write_bytes(whole[: next(at for at in message_starts(whole) if at > len(whole) - 5000) + kept])
    recording = recording_from_log(path)
    assert 100 < len(recording) < COUNT
    assert recording.warnings[0] == f"{path}: cut short: the log ends within a message"


def test_gyro_whose_clock_stands_still_is_left_out(tmp_path):
    topics = {
        "vehicle_attitude": flight()["vehicle_attitude"],
        "sensor_gyro": [(BOOT_US, 0.1, 0.0, 0.0)] * 50,
    }
    log = ulog.read(write_ulog(tmp_path / "log.ulg", topics))
    assert not log.gyros
    assert "other gyros, slower than 20 Hz, left out: sensor_gyro[0]" in log.notes


def test_message_of_px4_is_told_without_colours_and_with_its_module_once(tmp_path):
    path = write_ulog(tmp_path / "a.ulg", flight())
    said = (b"[logger] [logger] ./log/1.ulg", b"[commander] \x1b[32mReady for takeoff!\x1b[0m")
    logged = [
        message("L", struct.pack("<BQ", ord("6"), BOOT_US + 1000 * k) + text) for k, text in enumerate(said)
    ]
    path.write_bytes(path.read_bytes() + b"".join(logged))
    texts = [event.text for event in read_log(path).events]
    assert texts == ["[logger] ./log/1.ulg", "[commander] Ready for takeoff!"]
