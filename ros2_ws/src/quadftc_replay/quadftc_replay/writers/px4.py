"""A flight log as PX4 writes it with its default ``SDLOG_PROFILE``.

| topic | rate [Hz] | fields |
|---|---|---|
| ``sensor_combined`` | 200 | ``gyro_rad``, ``accelerometer_m_s2`` of the first IMU |
| ``vehicle_torque_setpoint``, ``vehicle_thrust_setpoint`` | 50 | ``xyz``: shares of the greatest |
| ``vehicle_attitude`` | 20 | ``q`` |
| ``vehicle_local_position``, ``actuator_motors`` | 10 | ``x`` ... ``vz``; ``control`` |
| ``vehicle_gps_position``, ``vehicle_air_data``, ``vehicle_magnetometer``, ``battery_status`` | 5 | |
| ``esc_status``, ``vehicle_imu_status`` | 4, 1 | ``esc_rpm`` of each; vibration, clips |

A topic has the fields that the log knows; a topic without any is left out. So is every sensor but the first
of its kind: PX4 logs spot checks of the others alone. ``CA_ROTOR*`` tell the rotors.

    file: "ULog" 01 12 35 | version u8 | start u64 [µs] | messages
    message: size u16 | type char | content
    F format | P parameter | A a topic gets a number | D a sample of a topic | L what the autopilot said

All is little-endian. The log describes itself; samples and texts come by time.

Source: PX4-Autopilot, src/modules/logger/logged_topics.cpp, msg/*.msg; PX4 documentation, "ULog File Format".
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from quadftc_model.frames import enu_from_ned, flu_from_frd, ned_frd_from_enu_flu
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.readers.ulog import FIRST_MOTOR, INVALID_TIME, MAX_MOTORS, ROTORS_OF_TYPE
from quadftc_replay.readers.ulog_navigation import MILLIGAUSS
from quadftc_replay.writers.sampling import (
    RPM,
    degrees_from,
    microseconds,
    status_at,
    thin,
    torque_and_thrust,
)

MAGIC, VERSION = b"ULog\x01\x12\x35", 1
HEADER, FLAGS = struct.Struct("<7sBQ"), bytes(40)  # no flag is set, nothing is appended
TYPES = {
    "uint64_t": "<u8",
    "uint32_t": "<u4",
    "int32_t": "<i4",
    "uint8_t": "<u1",
    "float": "<f4",
    "double": "<f8",
}
STAMP = "uint64_t timestamp"
INFO = b"6"  # level of what the autopilot says, as in the kernel of Linux
RATES = {
    "sensor_combined": 200.0,
    "vehicle_torque_setpoint": 50.0,
    "vehicle_attitude": 20.0,
    **dict.fromkeys(("vehicle_local_position", "actuator_motors"), 10.0),
    **dict.fromkeys(("vehicle_gps_position", "vehicle_air_data"), 5.0),
    **dict.fromkeys(("vehicle_magnetometer", "battery_status"), 5.0),
    "esc_status": 4.0,
    "vehicle_imu_status": 1.0,
}  # Hz
KM = 0.05  # CA_ROTORn_KM by default, of either sign


class UlogWriter:
    """Collects the samples of a log; `write` puts them into a file."""

    def __init__(self) -> None:
        self._parameters: list[bytes] = []
        self._formats: dict[str, bytes] = {}
        self._types = {name: np.dtype(code) for name, code in TYPES.items()}
        self._topics: dict[str, int] = {}  # topic: number
        self._rows: list[tuple[int, bytes]] = []  # stamp [µs], message

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the topics, in the order in which they were added first."""
        return tuple(self._topics)

    def set(self, name: str, value: float) -> None:
        """Note a parameter, whole numbers as such."""
        kind, packed = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
        key = f"{kind} {name}".encode()
        self._parameters.append(_message("P", bytes([len(key)]) + key + struct.pack(packed, value)))

    def add(self, topic: str, fields: Mapping[str, ArrayLike]) -> None:
        """Add samples: ``fields`` are "type name" or "type[k] name" to (n,), (n, k) or one value.

        The first is ``uint64_t timestamp`` [µs]. A type may be one of `define`. A topic has one format;
        another one is a ValueError.
        """
        self._define(topic, list(fields))
        number = self._topics.setdefault(topic, len(self._topics))
        stamps = np.asarray(fields[STAMP], np.int64)
        table = np.zeros(len(stamps), [self._column(each) for each in fields])
        for each, values in fields.items():
            is_whole = np.issubdtype(table.dtype[each].base, np.integer)
            table[each] = np.rint(values) if is_whole else values
        begin = struct.pack("<H", number)
        self._rows += [
            (int(stamp), _message("D", begin + row.tobytes()))
            for stamp, row in zip(stamps, table, strict=True)
        ]

    def define(self, name: str, fields: Sequence[str]) -> np.dtype:
        """Define a type out of fields; return what holds one of it in NumPy."""
        self._define(name, fields)
        self._types[name] = np.dtype([self._column(each) for each in fields])
        return self._types[name]

    def say(self, stamp: int, text: str) -> None:
        """Add what the autopilot says at a time [µs]."""
        self._rows.append((stamp, _message("L", INFO + struct.pack("<Q", stamp) + text.encode())))

    def write(self, path: Path) -> None:
        """Write the log: what describes it, then samples and texts by time."""
        start = min((stamp for stamp, _ in self._rows), default=0)
        begin = [HEADER.pack(MAGIC, VERSION, start), _message("B", FLAGS)]
        rows = (row for _, row in sorted(self._rows, key=lambda each: each[0]))
        topics = (
            _message("A", struct.pack("<BH", 0, number) + topic.encode())
            for topic, number in self._topics.items()
        )
        described = [*begin, *self._formats.values(), *self._parameters, *topics]
        path.write_bytes(b"".join([*described, *rows]))

    def _define(self, name: str, fields: Sequence[str]) -> None:
        form = _message("F", f"{name}:{''.join(f'{each};' for each in fields)}".encode())
        if self._formats.setdefault(name, form) != form:
            raise ValueError(f"{name}: expected the fields {self._formats[name][3:].decode()}")

    def _column(self, field: str) -> tuple[str, np.dtype, tuple[int, ...]]:
        """Column of NumPy for "type name" or "type[k] name"."""
        name, _, width = field.partition(" ")[0].partition("[")
        return field, self._types[name], (int(width.rstrip("]")),) if width else ()


def _message(kind: str, content: bytes) -> bytes:
    return struct.pack("<Hc", len(content), kind.encode()) + content


def write_px4(log: FlightLog, path: Path) -> tuple[str, ...]:
    """Write a log; return the names of its topics."""
    writer = UlogWriter()
    _set_rotors(writer, log)
    _add_imu(writer, log)
    _add_states(writer, log)
    _add_rotors(writer, log)
    _add_navigation(writer, log)
    for event in log.events:
        text = event.text if event.source == "message" else f"{event.source}: {event.text}"
        writer.say(int(microseconds(np.array([event.time]))[0]), text)
    writer.write(path)
    return writer.names


def _put(writer: UlogWriter, topic: str, signal: Signal, fields: Mapping[str, ArrayLike]) -> None:
    """Add samples of a signal that has been thinned."""
    if len(signal):
        writer.add(topic, {STAMP: microseconds(signal.time), **fields})


def _set_rotors(writer: UlogWriter, log: FlightLog) -> None:
    places, signs = log.rotor_positions, log.rotor_yaw_signs
    if places is None or signs is None:
        return
    kind = next((kind for kind, count in ROTORS_OF_TYPE.items() if count == len(signs)), 0)
    writer.set("MAV_TYPE", kind)
    writer.set("CA_ROTOR_COUNT", len(signs))
    for k, ((x, y), sign) in enumerate(zip(places.tolist(), signs.tolist(), strict=True)):
        for name, value in (("PX", x), ("PY", -y), ("KM", -sign * KM)):
            writer.set(f"CA_ROTOR{k}_{name}", value)


def _add_imu(writer: UlogWriter, log: FlightLog) -> None:
    """Add the first IMU; a sample of the gyro without a new one of the accelerometer says so."""
    name = next(iter(log.gyros), None)
    if name is not None:
        rate = thin(log.gyros[name], RATES["sensor_combined"])
        relative = np.full(len(rate), INVALID_TIME)
        force = np.zeros_like(rate.value)
        if (sensor := log.accelerometers.get(name)) is not None:
            rows = np.clip(np.searchsorted(sensor.time, rate.time, side="right") - 1, 0, None)
            is_new = np.diff(rows, prepend=-1) > 0
            off = microseconds(sensor.time[rows]) - microseconds(rate.time)
            relative, force = np.where(is_new, off, INVALID_TIME), sensor.value[rows]
        fields = {
            "float[3] gyro_rad": flu_from_frd(rate.value),
            "int32_t accelerometer_timestamp_relative": relative,
            "float[3] accelerometer_m_s2": flu_from_frd(force),
        }
        _put(writer, "sensor_combined", rate, fields)
    if log.vibration is not None:
        level = thin(log.vibration, RATES["vehicle_imu_status"])
        clips = np.zeros((len(level), 3))
        clips[:, 0] = 0.0 if log.clips is None else log.clips.at(level.time)[:, 0]
        fields = {"float accel_vibration_metric": np.sqrt(3.0 * np.mean(level.value**2, axis=1))}
        _put(writer, "vehicle_imu_status", level, {**fields, "uint32_t[3] accel_clipping": clips})


def _add_states(writer: UlogWriter, log: FlightLog) -> None:
    if log.attitude is not None:
        attitude = thin(log.attitude, RATES["vehicle_attitude"])
        _put(writer, "vehicle_attitude", attitude, {"float[4] q": ned_frd_from_enu_flu(attitude.value)})
    if log.velocity is not None and log.position is not None:
        velocity = thin(log.velocity, RATES["vehicle_local_position"])
        names = ("x y z", "vx vy vz", "ax ay az")
        known = (log.position, velocity, log.acceleration)
        fields = {
            f"float {name}": column
            for group, state in zip(names, known, strict=True)
            if state is not None
            for name, column in zip(group.split(), enu_from_ned(state.at(velocity.time)).T, strict=True)
        }
        _put(writer, "vehicle_local_position", velocity, fields)
    if log.battery is not None:
        battery = thin(log.battery, RATES["battery_status"])
        _put(writer, "battery_status", battery, {"float voltage_v": battery.value[:, 0]})


def _add_rotors(writer: UlogWriter, log: FlightLog) -> None:
    torque, thrust = torque_and_thrust(log)
    if torque is not None and thrust is not None:
        asked = thin(torque, RATES["vehicle_torque_setpoint"])
        up = thrust.at(asked.time)
        along = np.column_stack([np.zeros((len(up), 2)), -up])
        _put(writer, "vehicle_torque_setpoint", asked, {"float[3] xyz": flu_from_frd(asked.value)})
        _put(writer, "vehicle_thrust_setpoint", asked, {"float[3] xyz": along})
    if log.rotor_commands is not None:
        commands = thin(log.rotor_commands, RATES["actuator_motors"])
        control = np.full((len(commands), MAX_MOTORS), np.nan)
        control[:, : commands.value.shape[1]] = commands.value
        _put(writer, "actuator_motors", commands, {f"float[{MAX_MOTORS}] control": control})
    if log.rotor_speeds is not None:
        speeds = thin(log.rotor_speeds, RATES["esc_status"])
        report = writer.define("esc_report", ["int32_t esc_rpm", "uint8_t actuator_function"])
        rotors = speeds.value.shape[1]
        reports = np.zeros((len(speeds), rotors), report)
        reports["int32_t esc_rpm"] = np.rint(RPM * speeds.value)
        reports["uint8_t actuator_function"] = FIRST_MOTOR + np.arange(rotors)
        fields = {"uint8_t esc_count": rotors, f"esc_report[{rotors}] esc": reports}
        _put(writer, "esc_status", speeds, fields)


def _add_navigation(writer: UlogWriter, log: FlightLog) -> None:
    name = next((name for name in log.gps_velocities if name in log.gps_positions), None)
    if name is not None:
        velocity = thin(log.gps_velocities[name], RATES["vehicle_gps_position"])
        latitude, longitude, height = degrees_from(log.gps_positions[name].at(velocity.time)).T
        said = status_at(log, name, velocity.time)
        north, east, down = enu_from_ned(velocity.value).T
        fields = {
            "double latitude_deg": latitude,
            "double longitude_deg": longitude,
            "double altitude_msl_m": height,
            "float eph": said[:, 2],
            "float vel_n_m_s": north,
            "float vel_e_m_s": east,
            "float vel_d_m_s": down,
            "uint8_t fix_type": said[:, 0],
            "uint8_t satellites_used": said[:, 1],
        }
        _put(writer, "vehicle_gps_position", velocity, fields)
    if log.magnetometers and log.field_unit == "mG":
        field = thin(next(iter(log.magnetometers.values())), RATES["vehicle_magnetometer"])
        gauss = flu_from_frd(field.value) / MILLIGAUSS
        _put(writer, "vehicle_magnetometer", field, {"float[3] magnetometer_ga": gauss})
    if log.barometers:
        height = thin(next(iter(log.barometers.values())), RATES["vehicle_air_data"])
        _put(writer, "vehicle_air_data", height, {"float baro_alt_meter": height.value[:, 0]})
