"""Telemetry logs: written by pymavlink and checked against its reader; clocks, several vehicles, damage."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v10 import ardupilotmega as old
from pymavlink.dialects.v20 import ardupilotmega as new

from quadftc_bags.bag import BagError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay.mavlink import RECEIVED, check_sums, read_telemetry
from quadftc_replay.readers import LogChoice, read_log
from recorded_logs import DATA, needs_data

COUNT, PERIOD_US = 200, 100_000
START_US = 1_700_000_000_000_000
PARAMETERS = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0}


def record(message, link, k: int, late_us: int = 7000) -> bytes:
    """A message as a ground station stores it; ``late_us`` after it was sent."""
    return struct.pack(">Q", START_US + k * PERIOD_US + late_us) + message.pack(link)


def flight(system: int = 1, dialect=new, boot_us: int = 5_000_000, sign: float = 1.0) -> list[bytes]:
    link, parts = dialect.MAVLink(None, srcSystem=system, srcComponent=1), list[bytes]()
    station = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    for name, value in PARAMETERS.items():
        parts.append(record(dialect.MAVLink_param_value_message(name.encode(), value, 9, 4, 0), link, 0))
    for k in range(COUNT):
        us = (boot_us + k * PERIOD_US) % 2**32
        parts += [
            record(dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3), link, k),
            record(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), station, k),
            record(dialect.MAVLink_attitude_message(us // 1000, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0), link, k),
            record(
                dialect.MAVLink_raw_imu_message(us, 10, -20, -1000, int(sign * k), 200, -300, 1, 2, 3),
                link,
                k,
            ),
            record(
                dialect.MAVLink_scaled_imu2_message(us // 1000, 0, 0, -1000, 50, 60, 70, 1, 2, 3), link, k
            ),
            record(
                dialect.MAVLink_servo_output_raw_message(us, 0, 1100, 1900, 1500, 1300, 0, 0, 0, 0), link, k
            ),
            record(
                dialect.MAVLink_local_position_ned_message(us // 1000, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3), link, k
            ),
            record(
                dialect.MAVLink_sys_status_message(0, 0, 0, 0, 12600 - k, 0, 0, 0, 0, 0, 0, 0, 0), link, k
            ),
        ]
    parts.append(
        record(dialect.MAVLink_statustext_message(2, b"Potential Thrust Loss (1)"), link, COUNT // 2)
    )
    return parts


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "flight.tlog"
    file.write_bytes(b"".join(flight()))
    return file


def test_sums_are_those_of_pymavlink():
    rows = np.random.default_rng(2).integers(0, 256, (20, 33), dtype=np.uint8)
    theirs = [new.x25crc(row.tobytes()).crc for row in rows]
    np.testing.assert_array_equal(check_sums(rows), theirs)


@pytest.mark.parametrize("dialect", [old, new])
def test_units_axes_and_motors_are_those_of_the_interface(tmp_path, dialect):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(flight(dialect=dialect)))
    log = read_log(path)
    assert (log.format, log.notes) == ("MAVLink tlog", ())
    assert log.start_ns == (START_US + 7000) * 1000
    np.testing.assert_allclose(log.gyros[""].value[10], [0.01, -0.2, 0.3])
    np.testing.assert_allclose(log.gyros["2"].value[10], [0.05, -0.06, -0.07])
    np.testing.assert_allclose(log.gyros[""].time, 0.1 * np.arange(COUNT), atol=1e-9)
    np.testing.assert_allclose(log.accelerometers[""].value[0], np.array([0.01, 0.02, 1.0]) * 9.80665)
    assert log.attitude is not None
    np.testing.assert_allclose(
        euler_from_quaternion(log.attitude.value[0]), [0.1, -0.2, np.pi / 2], rtol=1e-6
    )
    assert log.velocity is not None
    np.testing.assert_allclose(log.velocity.value[0], [0.2, 0.1, -0.3], rtol=1e-6)
    assert log.rotor_commands is not None
    assert np.argsort(log.rotor_commands.value[0]).tolist() == [0, 3, 2, 1]
    assert log.rotor_positions is not None
    assert log.battery is not None
    assert log.battery.value[5, 0] == pytest.approx(12.595)
    assert [(event.source, event.text) for event in log.events] == [
        ("STATUSTEXT", "Potential Thrust Loss (1)")
    ]


def test_several_vehicles_are_asked_for(tmp_path):
    path = tmp_path / "two.tlog"
    both = zip(flight(1), flight(2, boot_us=900_000_000, sign=-1.0), strict=True)
    path.write_bytes(b"".join(part for pair in both for part in pair))
    with pytest.raises(BagError, match=r"2 vehicles; choose one with --system: 1 \(800 messages\), 2 \(800"):
        read_log(path)
    with pytest.raises(BagError, match="no vehicle is system 3; there are 1"):
        read_log(path, LogChoice(system=3))
    log = read_log(path, LogChoice(system=2))
    assert log.gyros[""].value[10, 0] == pytest.approx(-0.01)
    assert log.notes[0].startswith("system 2, of 1 (")


def test_vehicle_that_starts_again_goes_on_in_time(tmp_path):
    path = tmp_path / "again.tlog"
    first = flight()
    second = [
        struct.pack(">Q", struct.unpack(">Q", part[:8])[0] + 30_000_000) + part[8:]
        for part in flight(boot_us=1_000_000)
    ]
    path.write_bytes(b"".join(first + second))
    log = read_log(path)
    assert len(log.gyros[""]) == 2 * COUNT
    assert log.gyros[""].time[COUNT] == pytest.approx(30.0, abs=1e-3)


def test_counter_that_is_full_goes_on(tmp_path):
    path = tmp_path / "wraps.tlog"
    path.write_bytes(b"".join(flight(boot_us=2**32 - 5_000_000)))
    log = read_log(path)
    assert log.rotor_commands is not None
    np.testing.assert_allclose(np.diff(log.rotor_commands.time), 0.1, atol=1e-3)


def test_log_that_is_cut_is_read_up_to_the_cut(path):
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2 + 5])
    log = read_log(path)
    assert any(note.startswith("cut short or damaged: ") for note in log.notes)
    assert 90 < len(log.gyros[""]) < 110


def test_damaged_messages_are_left_out(path):
    whole, rng = bytearray(path.read_bytes()), np.random.default_rng(6)
    for place in rng.integers(0, len(whole), 60).tolist():
        whole[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(whole)
    log = read_log(path)
    assert any("with a wrong check sum left out" in note for note in log.notes)
    assert 0.8 * COUNT < len(log.gyros[""]) <= COUNT
    np.testing.assert_allclose(log.gyros[""].value[:, 1], -0.2)


def test_log_of_nobody_is_refused(tmp_path):
    path = tmp_path / "station.tlog"
    station = new.MAVLink(None, srcSystem=255, srcComponent=190)
    beat = new.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    path.write_bytes(b"".join(record(beat, station, k) for k in range(10)))
    with pytest.raises(BagError, match="no message of a vehicle's attitude, IMU or outputs in it"):
        read_log(path)


@needs_data
def test_real_log_is_read_as_pymavlink_reads_it():
    path = DATA / "ardupilot/adgfuzz/mav.tlog"
    names = ("ATTITUDE", "RAW_IMU", "SERVO_OUTPUT_RAW", "PARAM_VALUE")
    log = read_telemetry(path, names)
    assert log.notes == ()
    theirs = mavutil.mavlink_connection(str(path))
    rows = dict.fromkeys(names, 0)
    while message := theirs.recv_match(type=list(names)):
        name, source = message.get_type(), message.get_srcComponent()
        if name == "PARAM_VALUE" and source != 190:
            continue
        table, row = log.messages[1][name], rows[name]
        rows[name] += 1
        assert table[RECEIVED][row] == pytest.approx(message._timestamp * 1e6, abs=1.0)
        for field in message.get_fieldnames():
            value = table[field][row]
            text = value.decode() if isinstance(value, bytes) else value
            assert text == pytest.approx(getattr(message, field)), (name, field)
    theirs.close()
    assert rows == {name: len(log.messages[1][name][RECEIVED]) for name in names}
