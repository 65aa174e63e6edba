"""A flight log as ArduCopter writes it with its default ``LOG_BITMASK``.

| message | rate [Hz] | fields |
|---|---|---|
| ``IMU`` | 25, of each | ``GyrX`` ... [rad/s], ``AccX`` ... [m/s²] |
| ``ATT`` | 10 | ``Roll``, ``Pitch``, ``Yaw`` [deg] |
| ``RATE`` | 10 | ``R``, ``P``, ``Y`` [deg/s]; ``ROut`` ... ``AOut``: shares of the greatest |
| ``RCOU`` | 10 | ``C1`` ... [µs], by ``MOT_THST_EXPO`` and ``MOT_SPIN_*`` at their defaults |
| ``GPS``, ``GPA``, ``BARO``, ``BAT``, ``VIBE`` | 5 | as `readers.ardupilot` says |
| ``MAG``, ``XKF1``, ``ESC`` | 3.3, 2.5, 0.5 | the same |
| ``MSG`` | | what the autopilot said |

A message has the fields that the log knows; one of which it knows none is left out. Rates are those of
ArduCopter 4.7 (logs of its simulation). The frame is the one of ArduPilot whose rotors are nearest to those
of the vehicle: ``FRAME_CLASS``, ``FRAME_TYPE``, and ``SERVOn_FUNCTION``, as they may count in another order.

`quadftc_replay.dataflash` shows the bytes: formats of the messages come first, then all messages by time.

Source: ArduPilot, libraries/AP_Logger/LogStructure.h, ArduCopter/Log.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from pymavlink.DFReader import FORMAT_TO_STRUCT  # type: ignore[import-untyped]

from quadftc_model.arrays import AnyArray
from quadftc_model.frames import enu_from_ned, flu_from_frd
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay.dataflash import BEGIN, FORMAT, FORMAT_TYPE, HEAD, numpy_type
from quadftc_replay.flight_log import FlightLog, Floats, Signal
from quadftc_replay.readers.ardupilot_tables import CLASSES, FRAMES, MOTOR_FUNCTIONS
from quadftc_replay.readers.layouts import frame_layout
from quadftc_replay.writers.sampling import (
    RPM,
    degrees_from,
    heading,
    microseconds,
    status_at,
    thin,
    throttle_of_thrust,
    torque_and_thrust,
)

TYPES = cast("dict[str, tuple[str, float | None, object]]", FORMAT_TO_STRUCT)  # letter: code, factor, class
FORMAT_LETTERS, FORMAT_FIELDS = "BBnNZ", "Type,Length,Name,Format,Columns"
STAMP = "TimeUS"
RATES = {
    "IMU": 25.0,
    **dict.fromkeys(("ATT", "RATE", "RCOU"), 10.0),
    **dict.fromkeys(("GPS", "BARO", "BAT", "VIBE"), 5.0),
    "MAG": 10.0 / 3.0,
    "XKF1": 2.5,
    "ESC": 0.5,
}  # Hz
DEFAULTS = {
    "MOT_PWM_MIN": 1000.0,
    "MOT_PWM_MAX": 2000.0,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "MOT_THST_EXPO": 0.65,
    "LOG_BITMASK": 180222.0,
}  # of 4.7
IN_THE_ORDER = {motor: function for function, motor in MOTOR_FUNCTIONS.items()}  # SERVOn_FUNCTION by motor


class DataflashWriter:
    """Collects the messages of a log; `write` puts them into a file."""

    def __init__(self) -> None:
        self._formats = {"FMT": (FORMAT_TYPE, FORMAT_LETTERS, FORMAT_FIELDS)}  # name: type, letters, fields
        self._rows: list[tuple[int, bytes]] = []  # stamp [µs], message

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the messages, in the order in which they were added first."""
        return tuple(self._formats)[1:]

    def add(self, name: str, letters: str, fields: Mapping[str, ArrayLike]) -> None:
        """Add messages; ``fields`` are (n,) or one value, ``TimeUS`` [µs] (n,) the first of them.

        Numbers are in the unit of the field; what is beyond the range of its type becomes the nearest end. A
        name has one format; another one is a ValueError.
        """
        kind, *known = self._formats.setdefault(name, (len(self._formats), letters, ",".join(fields)))
        if known != [letters, ",".join(fields)]:
            raise ValueError(f"{name}: expected the fields {known[1]} of the types {known[0]}")
        stamps = np.atleast_1d(np.asarray(fields[STAMP], np.int64))
        codes = [TYPES[letter] for letter in letters]
        pairs = [(field, numpy_type(code[0])) for field, code in zip(fields, codes, strict=True)]
        table = np.zeros(len(stamps), np.dtype([("head", "S2"), ("kind", "u1"), *pairs]))
        table["head"], table["kind"] = HEAD, kind
        for (_, factor, _), (field, values) in zip(codes, fields.items(), strict=True):
            table[field] = _encode(np.asarray(values), factor, table.dtype[field])
        self._rows += [(int(stamp), row.tobytes()) for stamp, row in zip(stamps, table, strict=True)]

    def write(self, path: Path) -> None:
        """Write the log: its formats, then its messages by time; those of one time in the order of `add`."""
        begin: list[bytes] = []
        for name, (kind, letters, fields) in self._formats.items():
            texts = (each.encode() for each in (name, letters, fields))
            begin.append(HEAD + bytes([FORMAT_TYPE]) + FORMAT.pack(kind, _length(letters), *texts))
        rows = (row for _, row in sorted(self._rows, key=lambda each: each[0]))
        path.write_bytes(b"".join([*begin, *rows]))


def _length(letters: str) -> int:
    return BEGIN + sum(np.dtype(numpy_type(TYPES[letter][0])).itemsize for letter in letters)


def _encode(values: AnyArray, factor: float | None, kind: np.dtype) -> AnyArray:
    if kind.kind == "S":
        return values
    scaled = values / factor if factor else values
    if kind.kind == "f":
        return scaled
    ends = np.iinfo(kind)
    return np.clip(np.rint(scaled), ends.min, ends.max)


def write_ardupilot(log: FlightLog, path: Path) -> tuple[str, ...]:
    """Write a log; return the names of its messages. ValueError if ArduPilot has no such frame."""
    writer = DataflashWriter()
    parameters = DEFAULTS | _frame(log)
    names = np.array([name.encode() for name in parameters])
    value = np.array(list(parameters.values()))
    writer.add("PARM", "QNf", {STAMP: microseconds(np.zeros(len(names))), "Name": names, "Value": value})
    writer.add("MSG", "QZ", {STAMP: microseconds(np.zeros(1)), "Message": b"quadftc export"})
    _add_imus(writer, log)
    _add_attitude(writer, log)
    _add_rotors(writer, log)
    _add_navigation(writer, log)
    for event in log.events:
        text = event.text if event.source == "MSG" else f"{event.source}: {event.text}"
        writer.add("MSG", "QZ", {STAMP: microseconds(np.array([event.time])), "Message": text.encode()})
    writer.write(path)
    return writer.names


def _frame(log: FlightLog) -> dict[str, float]:
    """Parameters of the frame; none where the log does not know the rotors' places."""
    places, signs = log.rotor_positions, log.rotor_yaw_signs
    if places is None or signs is None:
        return {}
    rotors = len(signs)
    kind = next((each for each, count in CLASSES.items() if count == rotors), 0)
    found: list[tuple[float, bool, int, list[int]]] = []  # cosine, in this order, FRAME_TYPE, motors
    for form, name in FRAMES.items():
        if (layout := frame_layout(rotors, name)) is None:
            continue
        directions = places / np.linalg.norm(places, axis=1, keepdims=True)
        near = directions @ layout.positions.T
        motors = near.argmax(axis=1)
        if len({*motors.tolist()}) == rotors and np.all(layout.yaw_signs[motors] == signs):
            order = motors.tolist()
            found.append((round(float(near.max(axis=1).min()), 6), order == sorted(order), form, order))
    if not found:
        raise ValueError(f"{log.path}: ArduPilot has no frame of {rotors} rotors at these places; try px4")
    _, _, form, motors = max(found, key=lambda each: each[:2])
    servos = {f"SERVO{k + 1}_FUNCTION": float(IN_THE_ORDER[motor]) for k, motor in enumerate(motors)}
    return {"FRAME_CLASS": float(kind), "FRAME_TYPE": float(form), **servos}


def _put(
    writer: DataflashWriter, name: str, letters: str, signal: Signal, fields: Mapping[str, ArrayLike]
) -> None:
    """Add messages of a signal that has been thinned; ``letters`` without that of the stamp."""
    if len(signal):
        writer.add(name, f"Q{letters}", {STAMP: microseconds(signal.time), **fields})


def _axes(begin: str, value: Floats) -> dict[str, Floats]:
    return {f"{begin}{axis}": value[:, k] for k, axis in enumerate("XYZ")}


def _add_imus(writer: DataflashWriter, log: FlightLog) -> None:
    """Add what gyros and accelerometers of a name measure together."""
    for number, (name, gyro) in enumerate(log.gyros.items()):
        force = log.accelerometers.get(name)
        rate = thin(gyro, RATES["IMU"])
        measured = np.zeros_like(rate.value) if force is None else force.at(rate.time)
        fields = _axes("Gyr", flu_from_frd(rate.value)) | _axes("Acc", flu_from_frd(measured))
        _put(writer, "IMU", "Bffffff", rate, {"I": number, **fields})
    if log.vibration is not None:
        level = thin(log.vibration, RATES["VIBE"])
        clips = np.zeros((len(level), 1)) if log.clips is None else log.clips.at(level.time)
        each = np.broadcast_to(level.value, (len(level), 3))
        _put(writer, "VIBE", "BfffI", level, {"IMU": 0, **_axes("Vibe", each), "Clip": clips[:, 0]})


def _add_attitude(writer: DataflashWriter, log: FlightLog) -> None:
    if log.attitude is not None:
        attitude = thin(log.attitude, RATES["ATT"])
        roll, pitch, yaw = np.degrees(euler_from_quaternion(attitude.value)).T
        angles = {"Roll": roll, "Pitch": -pitch, "Yaw": (90.0 - yaw) % 360.0}
        _put(writer, "ATT", "fff", attitude, angles)
    torque, thrust = torque_and_thrust(log)
    gyro = next(iter(log.gyros.values()), log.body_rate)
    if torque is not None and thrust is not None and gyro is not None:
        asked = thin(torque, RATES["RATE"])
        rate = np.degrees(flu_from_frd(gyro.at(asked.time)))
        share = flu_from_frd(asked.value)
        columns = {
            f"{letter}{what}": each[:, k]
            for what, each in (("", rate), ("Out", share))
            for k, letter in enumerate("RPY")
        }
        _put(writer, "RATE", "fffffff", asked, {**columns, "AOut": thrust.at(asked.time)[:, 0]})


def _add_rotors(writer: DataflashWriter, log: FlightLog) -> None:
    if log.rotor_commands is not None:
        commands = thin(log.rotor_commands, RATES["RCOU"])
        throttle = throttle_of_thrust(np.clip(commands.value, 0.0, 1.0), DEFAULTS["MOT_THST_EXPO"])
        least, most = DEFAULTS["MOT_SPIN_MIN"], DEFAULTS["MOT_SPIN_MAX"]
        share = np.where(commands.value > 0.0, least + (most - least) * throttle, 0.0)
        low, high = DEFAULTS["MOT_PWM_MIN"], DEFAULTS["MOT_PWM_MAX"]
        pulses = low + (high - low) * share
        fields = {f"C{k + 1}": pulse for k, pulse in enumerate(pulses.T)}
        _put(writer, "RCOU", "H" * len(fields), commands, fields)
    if log.rotor_speeds is not None:
        speeds = thin(log.rotor_speeds, RATES["ESC"])
        for number, speed in enumerate(speeds.value.T):
            _put(writer, "ESC", "Bf", speeds, {"Instance": number, "RPM": RPM * speed})


def _add_navigation(writer: DataflashWriter, log: FlightLog) -> None:
    if log.velocity is not None and log.position is not None:
        velocity = thin(log.velocity, RATES["XKF1"])
        state = {"V": enu_from_ned(velocity.value), "P": enu_from_ned(log.position.at(velocity.time))}
        fields = {
            f"{letter}{axis}": value[:, k] for letter, value in state.items() for k, axis in enumerate("NED")
        }
        _put(writer, "XKF1", "Bffffff", velocity, {"C": 0, **fields})
    for number, (name, receiver) in enumerate(log.gps_velocities.items()):
        if (places := log.gps_positions.get(name)) is None:
            continue
        velocity = thin(receiver, RATES["GPS"])
        latitude, longitude, height = degrees_from(places.at(velocity.time)).T
        said = status_at(log, name, velocity.time)
        fields = {"Status": said[:, 0], "NSats": said[:, 1], "Lat": latitude, "Lng": longitude, "Alt": height}
        fields |= {"Spd": np.hypot(*velocity.value[:, :2].T), "GCrs": heading(velocity.value)}
        _put(writer, "GPS", "BBBLLefff", velocity, {"I": number, **fields, "VZ": -velocity.value[:, 2]})
        if np.isfinite(said[:, 2]).all():
            _put(writer, "GPA", "Bf", velocity, {"I": number, "HAcc": said[:, 2]})
    for number, sensor in enumerate(log.magnetometers.values()):
        field = thin(sensor, RATES["MAG"])
        if log.field_unit == "mG":
            fields = {"I": number, **_axes("Mag", flu_from_frd(field.value)), "Health": 1}
            _put(writer, "MAG", "BhhhB", field, fields)
    for number, sensor in enumerate(log.barometers.values()):
        height = thin(sensor, RATES["BARO"])
        _put(writer, "BARO", "BfB", height, {"I": number, "Alt": height.value[:, 0], "H": 1})
    if log.battery is not None:
        battery = thin(log.battery, RATES["BAT"])
        _put(writer, "BAT", "Bf", battery, {"Inst": 0, "Volt": battery.value[:, 0]})
