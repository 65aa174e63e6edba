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

Source: PX4-Autopilot, src/modules/logger/logged_topics.cpp, msg/*.msg.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from quadftc_model.frames import enu_flu_from_ned_frd, enu_from_ned, flu_from_frd
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
from quadftc_replay.writers.ulog import STAMP, UlogWriter

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
        turned = enu_flu_from_ned_frd(attitude.value[:, [3, 0, 1, 2]])  # its own way back
        _put(writer, "vehicle_attitude", attitude, {"float[4] q": turned[:, [3, 0, 1, 2]]})
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
