"""A MAVLink telemetry log (``.tlog``) as a flight log.

| signal | message: fields |
|---|---|
| gyros, accelerometers | ``HIGHRES_IMU`` [rad/s, m/s²], ``SCALED_IMU``, 2, 3 [mrad/s, mg] |
| the same of ArduPilot | ``RAW_IMU`` [mrad/s, mg] |
| magnetometers | those of them [gauss, mgauss] |
| barometers | ``SCALED_PRESSURE``, 2, 3 [hPa] |
| satellites | ``GPS_RAW_INT``, ``GPS2_RAW`` [1e-7 deg, mm, cm/s, cdeg]; height alone without vertical speed |
| attitude | ``ATTITUDE_QUATERNION`` or ``ATTITUDE`` [rad], whichever there is more of |
| body rate | ``ATTITUDE`` [rad/s], without a gyro |
| position, velocity | ``LOCAL_POSITION_NED`` [m, m/s], else ``GLOBAL_POSITION_INT`` [1e-7 deg, mm, cm/s] |
| rotor speeds | ``ESC_TELEMETRY_1_TO_4`` and more [rpm] |
| rotor commands | ``SERVO_OUTPUT_RAW`` [µs] and parameters, as in ArduPilot's logs |
| battery | ``SYS_STATUS`` [mV] |
| what the autopilot said | ``STATUSTEXT`` |

The frames are north-east-down and forward-right-down; `frames` turns them. The attitude is the autopilot's
own estimate, to which these gyros have contributed.

Stamps are those of the vehicle, which count from its start, where the message has one. They come onto the
clock of the ground station by the median of what lies between the two, anew whenever the vehicle's clock goes
back: it was started again, or the counter was full. Messages without a stamp have the time of receipt.

Source: mavlink.io/en/messages/common.html, ardupilotmega.html; ArduPilot, GCS_MAVLink/GCS_Common.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_bags.bag import BagError
from quadftc_model.arrays import AnyArray
from quadftc_model.frames import enu_flu_from_ned_frd, enu_flu_from_ned_frd_angles, enu_from_ned, flu_from_frd
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.dataflash import text_of
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.mavlink import RECEIVED, read_telemetry
from quadftc_replay.readers.ardupilot_tables import OUTPUTS, add_rotors
from quadftc_replay.readers.positioning import Fixes, add_receiver, pressure_height
from quadftc_replay.readers.signals import DEGREE, MILLI, Signals, Stamps, columns, sound

FORMAT = "MAVLink tlog"
Table = Mapping[str, AnyArray]

# message -> (gyro [rad/s], accelerometer [m/s²]) of one; its name among several
IMUS = {
    "HIGHRES_IMU": ((1.0, 1.0), ""),
    "SCALED_IMU": ((MILLI, MILLI * STANDARD_GRAVITY), ""),
    "RAW_IMU": ((MILLI, MILLI * STANDARD_GRAVITY), ""),
    "SCALED_IMU2": ((MILLI, MILLI * STANDARD_GRAVITY), "2"),
    "SCALED_IMU3": ((MILLI, MILLI * STANDARD_GRAVITY), "3"),
}
PRESSURES = {"SCALED_PRESSURE": "", "SCALED_PRESSURE2": "2", "SCALED_PRESSURE3": "3"}
RECEIVERS = {"GPS_RAW_INT": "", "GPS2_RAW": "2"}
ESCS = {"ESC_TELEMETRY_1_TO_4": 0, "ESC_TELEMETRY_5_TO_8": 4, "ESC_TELEMETRY_9_TO_12": 8}  # first output
NAMES = (
    *("HEARTBEAT", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"),
    *("SERVO_OUTPUT_RAW", "SYS_STATUS", "PARAM_VALUE", "STATUSTEXT", *IMUS, *ESCS),
    *PRESSURES,
    *RECEIVERS,
)
MOVING = ("ATTITUDE", "ATTITUDE_QUATERNION", "SERVO_OUTPUT_RAW", *IMUS)  # what only a vehicle sends
ARDUPILOT = 3  # MAV_AUTOPILOT
STEP_BACK = 1_000_000  # µs; a clock that goes back by more was set anew
RADIUS = 6_371_000.0  # m, of the earth
NO_VOLTAGE = 65535  # mV
NOT_KNOWN = 65535  # of a speed
HECTOPASCAL = 100.0  # Pa


def read(path: Path, system: int = 0) -> FlightLog:
    """Read what a vehicle sent; BagError if there are several and none is chosen, or nothing can be used."""
    log = read_telemetry(path, NAMES)
    messages, note = _choose(log.messages, path, system)
    signals = Signals(path, FORMAT)
    signals.notes += [*note, *log.notes]
    _add_imus(signals, messages)
    _add_navigation(signals, messages)
    _add_states(signals, messages)
    if table := messages.get("STATUSTEXT"):
        for stamp, text in zip(stamps_of(table).tolist(), table["text"].tolist(), strict=True):
            signals.say(stamp, "STATUSTEXT", text_of(text))
    layout = add_rotors(signals, _tables(messages), sound(_parameters(messages)))
    return signals.flight_log(layout, is_own=True)


def _choose(
    messages: Mapping[int, Mapping[str, Table]], path: Path, wanted: int
) -> tuple[Mapping[str, Table], list[str]]:
    """Return the messages of a vehicle, and which one it is of several."""
    vehicles = {
        number: sum(len(kinds[name][RECEIVED]) for name in MOVING if name in kinds)
        for number, kinds in sorted(messages.items())
    }
    vehicles = {number: count for number, count in vehicles.items() if count}
    there = ", ".join(f"{number} ({count} messages)" for number, count in vehicles.items())
    if not vehicles:
        raise BagError(f"{path}: no message of a vehicle's attitude, IMU or outputs in it")
    if wanted and wanted not in vehicles:
        raise BagError(f"{path}: no vehicle is system {wanted}; there are {there}")
    if not wanted and len(vehicles) > 1:
        raise BagError(f"{path}: {len(vehicles)} vehicles; choose one with --system: {there}")
    chosen = wanted or next(iter(vehicles))
    return messages[chosen], [f"system {chosen}, of {there}"] if len(vehicles) > 1 else []


def stamps_of(table: Table) -> Stamps:
    """Time of each message [ns] (n,), on the clock of the ground station."""
    received = table[RECEIVED].astype(np.int64)
    if "time_boot_ms" in table:
        own = table["time_boot_ms"].astype(np.int64) * 1000
    elif "time_usec" in table:
        own = table["time_usec"].astype(np.int64)
    else:
        return received * 1000
    starts = np.flatnonzero(np.diff(own) < -STEP_BACK) + 1
    stamps = [
        each + np.int64(np.median(heard - each))
        for each, heard in zip(np.split(own, starts), np.split(received, starts), strict=True)
        if len(each)
    ]
    return np.concatenate([np.zeros(0, np.int64), *stamps]) * 1000


def _add_imus(signals: Signals, messages: Mapping[str, Table]) -> None:
    """Add every IMU; of the messages of the first one that with most samples."""
    beats = messages.get("HEARTBEAT")
    is_ardupilot = beats is not None and bool(np.any(beats["autopilot"] == ARDUPILOT))
    there = [name for name in IMUS if name in messages and (name != "RAW_IMU" or is_ardupilot)]
    for name in sorted(there, key=lambda each: -len(messages[each][RECEIVED])):
        table, ((rate, force), key) = messages[name], IMUS[name]
        if signals.has("gyros") and key in signals.names("gyros"):
            continue
        stamp_ns = stamps_of(table)
        for field, begin, unit in (("gyros", "gyro", rate), ("accelerometers", "acc", force)):
            value = unit * flu_from_frd(columns(table, [f"{axis}{begin}" for axis in "xyz"]))
            if np.any(value):
                signals.add(field, stamp_ns, value, name, key)
        field = flu_from_frd(columns(table, ("xmag", "ymag", "zmag")))
        if np.any(field):
            unit = 1.0 / MILLI if name == "HIGHRES_IMU" else 1.0
            signals.add("magnetometers", stamp_ns, unit * field, name, key)


def _add_navigation(signals: Signals, messages: Mapping[str, Table]) -> None:
    for name, key in PRESSURES.items():
        if (table := messages.get(name)) and np.any(table["press_abs"]):
            height = pressure_height(HECTOPASCAL * table["press_abs"].astype(np.float64))
            signals.add("barometers", stamps_of(table), height, name, key)
    for name, key in RECEIVERS.items():
        if not (table := messages.get(name)):
            continue
        latitude, longitude, height, speed, course = columns(table, ("lat", "lon", "alt", "vel", "cog")).T
        speed, course = 0.01 * np.where(speed < NOT_KNOWN, speed, np.nan), 0.01 * DEGREE * course
        flat = [speed * np.sin(course), speed * np.cos(course), np.full(len(speed), np.nan)]
        claimed = MILLI * table["h_acc"].astype(np.float64) if "h_acc" in table else np.zeros(len(speed))
        said = Fixes(
            *(1e-7 * latitude, 1e-7 * longitude, MILLI * height),
            velocity=np.stack(flat, axis=-1),
            fix=table["fix_type"].astype(np.float64),
            satellites=table["satellites_visible"].astype(np.float64),
            accuracy=np.where(claimed > 0.0, claimed, np.nan),
        )
        add_receiver(signals, stamps_of(table), said, name, key)


def _add_states(signals: Signals, messages: Mapping[str, Table]) -> None:
    there = [name for name in ("ATTITUDE", "ATTITUDE_QUATERNION") if name in messages]
    if name := max(there, key=lambda each: len(messages[each][RECEIVED]), default=""):
        table = messages[name]
        if name == "ATTITUDE":
            value = enu_flu_from_ned_frd_angles(columns(table, ("roll", "pitch", "yaw")))
        else:
            value = enu_flu_from_ned_frd(columns(table, ("q1", "q2", "q3", "q4")))
        signals.add("attitude", stamps_of(table), value, name)
        if not signals.has("gyros"):
            rate = flu_from_frd(columns(table, ("rollspeed", "pitchspeed", "yawspeed")))
            signals.add("body_rate", stamps_of(table), rate, name)
    if table := messages.get("LOCAL_POSITION_NED"):
        for field, names in (("position", ("x", "y", "z")), ("velocity", ("vx", "vy", "vz"))):
            signals.add(field, stamps_of(table), enu_from_ned(columns(table, names)), "LOCAL_POSITION_NED")
    elif table := messages.get("GLOBAL_POSITION_INT"):
        stamp_ns, name = stamps_of(table), "GLOBAL_POSITION_INT"
        velocity = enu_from_ned(0.01 * columns(table, ("vx", "vy", "vz")))
        latitude, longitude = 1e-7 * DEGREE * columns(table, ("lat", "lon")).T
        if np.any(latitude) and np.any(longitude):
            east = RADIUS * np.cos(latitude[:1]) * (longitude - longitude[:1])
            north = RADIUS * (latitude - latitude[:1])
            up = MILLI * table["relative_alt"].astype(np.float64)
            signals.add("position", stamp_ns, np.stack([east, north, up], axis=-1), name)
            signals.add("velocity", stamp_ns, velocity, name)
    if table := messages.get("SYS_STATUS"):
        voltage = table["voltage_battery"].astype(np.float64)
        voltage[voltage == NO_VOLTAGE] = np.nan
        if np.nanmax(voltage, initial=0.0) > 0.0:
            signals.add("battery", stamps_of(table), MILLI * voltage, "SYS_STATUS")


def _parameters(messages: Mapping[str, Table]) -> dict[str, float]:
    """Parameters by name; of those that come again the last counts."""
    table = messages.get("PARAM_VALUE")
    if table is None:
        return {}
    names = map(text_of, table["param_id"].tolist())
    return dict(zip(names, table["param_value"].astype(np.float64).tolist(), strict=True))


def _tables(messages: Mapping[str, Table]) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Outputs and speeds as ArduPilot logs them: ``RCOU`` and ``ESC``."""
    tables: dict[str, dict[str, NDArray[np.float64]]] = {}
    if outputs := messages.get("SERVO_OUTPUT_RAW"):
        main = outputs["port"] == 0
        pulses = {f"C{k + 1}": outputs[f"servo{k + 1}_raw"][main].astype(np.float64) for k in range(OUTPUTS)}
        tables["RCOU"] = {"TimeUS": stamps_of(outputs)[main] / 1000.0, **pulses}
    time, instance, rpm = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for name, first in ESCS.items():
        if table := messages.get(name):
            for k in range(table["rpm"].shape[1]):
                time.append(stamps_of(table) / 1000.0)
                instance.append(np.full(len(time[-1]), float(first + k)))
                rpm.append(table["rpm"][:, k].astype(np.float64))
    order = np.argsort(np.concatenate(time), kind="stable")
    if len(order):
        speeds = {"TimeUS": time, "Instance": instance, "RPM": rpm}
        tables["ESC"] = {field: np.concatenate(parts)[order] for field, parts in speeds.items()}
    return tables
