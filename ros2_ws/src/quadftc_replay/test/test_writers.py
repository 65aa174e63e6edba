"""Logs written as autopilots do: other libraries read them, and our readers give the signals back."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary
from pyulog import ULog

from quadftc_model.rotations import quaternion_from_euler
from quadftc_replay.flight_log import Event, FlightLog, Signal
from quadftc_replay.readers import read_log
from quadftc_replay.readers.layouts import frame_layout
from quadftc_replay.writers import WRITERS, ardupilot, px4
from quadftc_replay.writers.ardupilot import DataflashWriter
from quadftc_replay.writers.px4 import UlogWriter

SECONDS = 20.0
ROTORS = 6
# how far a signal may be off: half a step of its field, or the rounding of single precision
RESOLUTION = {
    "ardupilot": {
        "gyros": 1e-6,
        "accelerometers": 1e-5,
        "magnetometers": 0.51,
        "barometers": 1e-5,
        "gps_positions": 0.02,
        "gps_velocities": 1e-5,
        "gps_status": 1e-6,
        "attitude": 1e-6,
        "position": 1e-5,
        "velocity": 1e-5,
        "torque_command": 1e-6,
        "thrust_command": 1e-6,
        "rotor_commands": 0.002,  # a pulse has whole microseconds
        "rotor_speeds": 1e-3,
        "battery": 1e-5,
        "vibration": 1e-5,
        "clips": 0.51,
    },
    "px4": {
        "gyros": 1e-6,
        "accelerometers": 1e-5,
        "magnetometers": 1e-3,
        "barometers": 1e-5,
        "gps_positions": 1e-3,
        "gps_velocities": 1e-5,
        "gps_status": 1e-6,
        "attitude": 1e-6,
        "position": 1e-5,
        "velocity": 1e-5,
        "torque_command": 1e-6,
        "thrust_command": 1e-6,
        "rotor_commands": 1e-6,
        "rotor_speeds": 0.06,  # whole turns a minute
        "battery": 1e-5,
        "vibration": 1e-5,
        "clips": 0.51,
    },
}


def wave(rate: float, width: int, size: float = 1.0, middle: float = 0.0) -> Signal:
    time = np.arange(0.0, SECONDS, 1.0 / rate)
    phases = np.arange(1.0, width + 1.0)
    return Signal(time, middle + size * np.sin(0.3 * phases * time[:, None] + phases))


def flown(frame: str = "x") -> FlightLog:
    layout = frame_layout(ROTORS, frame)
    angles = wave(100.0, 3, 0.3)
    status = Signal(np.arange(0.0, SECONDS, 0.1), np.tile([4.0, 14.0, 0.8], (200, 1)))
    shakes = wave(10.0, 1, 2.0, 5.0)
    clips = Signal(np.array([0.0, 9.0, 19.0]), np.array([[0.0], [2.0], [7.0]]))
    return FlightLog(
        path=Path("flown"),
        format="test",
        gyros={"": wave(400.0, 3), "1": wave(400.0, 3, 0.5)},
        accelerometers={"": wave(400.0, 3, 3.0, 9.0), "1": wave(400.0, 3, 2.0, 8.0)},
        magnetometers={"": wave(50.0, 3, 300.0)},
        barometers={"": wave(50.0, 1, 5.0)},
        gps_positions={"": wave(10.0, 3, 30.0)},
        gps_velocities={"": wave(10.0, 3, 4.0)},
        gps_status={"": status},
        attitude=Signal(angles.time, quaternion_from_euler(angles.value)),
        position=wave(100.0, 3, 30.0),
        velocity=wave(100.0, 3, 3.0),
        rotor_speeds=wave(100.0, ROTORS, 100.0, 500.0),
        rotor_commands=wave(100.0, ROTORS, 0.2, 0.5),
        torque_command=wave(100.0, 3, 0.1),
        thrust_command=wave(100.0, 1, 0.1, 0.4),
        torque_unit="1",
        battery=wave(10.0, 1, 0.5, 15.0),
        vibration=Signal(shakes.time, np.repeat(shakes.value, 3, axis=1)),
        clips=clips,
        rotor_positions=layout.positions,
        rotor_yaw_signs=layout.yaw_signs,
        events=(Event(3.0, "MSG", "EKF3 IMU0 is using GPS"), Event(9.0, "ERR", "compass: error 1")),
    )


@pytest.mark.parametrize("autopilot", WRITERS)
def test_what_was_written_is_read(autopilot, tmp_path):
    log, path = flown(), tmp_path / "log"
    WRITERS[autopilot](log, path)
    read = read_log(path)
    assert read.notes == ()
    assert not read.incomplete
    for field, off in RESOLUTION[autopilot].items():
        before, after = getattr(log, field), getattr(read, field)
        pairs = (
            [(before, after)]
            if isinstance(before, Signal)
            else [(before[name], after[name]) for name in after]
        )
        assert pairs, field
        for signal, again in pairs:
            start = signal.at(again.time[:1]) if field == "gps_positions" else 0.0
            wanted = (signal.at(again.time) - start)[:, : again.value.shape[1]]
            np.testing.assert_allclose(again.value, wanted, atol=off, err_msg=field)
    np.testing.assert_allclose(read.rotor_positions, log.rotor_positions, atol=1e-6)
    assert read.rotor_yaw_signs.tolist() == log.rotor_yaw_signs.tolist()
    assert [(round(each.time, 5), each.text.split(": ")[-1]) for each in read.events[-2:]] == [
        (3.0, "EKF3 IMU0 is using GPS"),
        (9.0, "error 1"),
    ]


def test_pymavlink_reads_the_rates_of_a_default_log(tmp_path):
    path = tmp_path / "log.bin"
    ardupilot.write_ardupilot(flown(), path)
    reader, counts, times = DFReader_binary(str(path)), {}, []
    while (message := reader.recv_msg()) is not None:
        counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
        times += [message.TimeUS] if message.get_type() != "FMT" else []
    reader.close()
    assert times == sorted(times)
    several = {"IMU": 2, "ESC": ROTORS}
    for name, rate in ardupilot.RATES.items():
        assert counts[name] == pytest.approx(
            rate * SECONDS * several.get(name, 1), abs=several.get(name, 1)
        ), name
    assert reader.params["FRAME_CLASS"] == 2
    assert reader.params["FRAME_TYPE"] == 1


def test_pyulog_reads_the_rates_of_a_default_log(tmp_path):
    path = tmp_path / "log.ulg"
    px4.write_px4(flown(), path)
    log = ULog(str(path))
    assert not log.file_corruption
    counts = {each.name: len(each.data["timestamp"]) for each in log.data_list}
    for name, rate in px4.RATES.items():
        assert counts[name] == pytest.approx(rate * SECONDS, abs=1), name
    assert log.initial_parameters["CA_ROTOR_COUNT"] == ROTORS


def test_rotors_that_count_in_another_order_are_told_by_the_outputs(tmp_path):
    log, order = flown(), [3, 0, 5, 1, 4, 2]
    other = dataclasses.replace(
        log,
        rotor_positions=0.2 * log.rotor_positions[order],
        rotor_yaw_signs=log.rotor_yaw_signs[order],
        rotor_commands=Signal(log.rotor_commands.time, log.rotor_commands.value[:, order]),
    )
    ardupilot.write_ardupilot(other, tmp_path / "log.bin")
    read = read_log(tmp_path / "log.bin").rotor_commands
    np.testing.assert_allclose(read.value, log.rotor_commands.at(read.time), atol=0.002)


def test_a_frame_that_ardupilot_lacks_is_refused(tmp_path):
    log = dataclasses.replace(flown(), rotor_yaw_signs=np.ones(ROTORS))
    with pytest.raises(ValueError, match="no frame of 6 rotors at these places"):
        ardupilot.write_ardupilot(log, tmp_path / "log.bin")


def test_a_torque_in_newton_metres_becomes_shares_of_the_commands(tmp_path):
    log = dataclasses.replace(flown(), torque_unit="N m")
    px4.write_px4(log, tmp_path / "log.ulg")
    read, commands = read_log(tmp_path / "log.ulg"), log.rotor_commands
    yaw = commands.value @ log.rotor_yaw_signs / ROTORS
    np.testing.assert_allclose(
        read.torque_command.value[:, 2], np.interp(read.torque_command.time, commands.time, yaw), atol=1e-6
    )


def test_samples_without_a_reading_are_left_out(tmp_path):
    log, gone = flown(), slice(2000, 3000)
    log.gyros[""].value[gone] = np.nan
    ardupilot.write_ardupilot(log, tmp_path / "log.bin")
    read = read_log(tmp_path / "log.bin").gyros[""]
    assert not np.any((read.time > 5.0) & (read.time < 7.5))
    assert np.isfinite(read.value).all()


@pytest.mark.parametrize("writer", [DataflashWriter(), UlogWriter()])
def test_a_name_has_one_format(writer):
    stamp = "TimeUS" if isinstance(writer, DataflashWriter) else "uint64_t timestamp"
    letters = ("Qf",) if isinstance(writer, DataflashWriter) else ()
    writer.add("X", *letters, {stamp: [1], "float a": [1.0]})
    with pytest.raises(ValueError, match="X: expected the fields"):
        writer.add("X", *letters, {stamp: [2], "float b": [1.0]})
