"""A log of ArduPilot (DataFlash, ``.BIN``) as a flight log.

| signal | message: fields |
|---|---|
| gyros | ``IMU`` or ``GYR``, whichever has more samples: ``GyrX`` to ``GyrZ`` [rad/s] of each instance |
| accelerometers | ``IMU`` or ``ACC``: ``AccX`` to ``AccZ`` [m/s²] of each instance |
| magnetometer | ``MAG``: ``MagX`` to ``MagZ`` [mGauss] of the first instance |
| attitude | ``ATT`` or ``ANG``, whichever has more samples: ``Roll``, ``Pitch``, ``Yaw`` [deg] |
| body rate | ``RATE``: ``R``, ``P``, ``Y`` [deg/s], without a gyro |
| position, velocity | ``XKF1``, ``NKF1`` or ``EKF1``: ``PN`` ... [m], ``VN`` ... [m/s] of the first core |
| velocity by satellites | ``GPS``: ``Spd`` [m/s], ``GCrs`` [deg], ``VZ`` [m/s] of the first receiver |
| rotor speeds | ``ESC``: ``RPM`` of each instance |
| rotor commands | ``RCOU``: ``C1`` to ``C14`` [µs] |
| torque, thrust command | ``RATE``: ``ROut``, ``POut``, ``YOut``, ``AOut``, shares of the greatest |
| battery | ``BAT``: ``Volt`` [V] |
| events | ``MSG``; ``ERR`` and ``EV`` in words |
| layout of the rotors | ``PARM``: ``FRAME_CLASS``, ``FRAME_TYPE``, of a quadplane with ``Q_`` |

``SERVOn_FUNCTION`` says which output drives which motor; without it output n drives motor n. Commands are the
pulses as shares of ``MOT_PWM_MIN`` to ``MOT_PWM_MAX`` (0: of ``RC3_MIN`` to ``RC3_MAX``), and of
``MOT_SPIN_MIN`` to ``MOT_SPIN_MAX`` of that; what ``MOT_THST_EXPO`` did to make the thrust linear is undone,
without the part that depends on the voltage. Speeds of ESCs that report within a few milliseconds make one
sample.

The frames are north-east-down and forward-right-down; `frames` turns them. The attitude is ArduPilot's own
estimate, to which these gyros have contributed.

Source: ArduPilot, libraries/AP_Logger/LogStructure.h, AP_InertialSensor, AP_AHRS, AP_NavEKF3, AP_ESC_Telem,
AP_BattMonitor (LogStructure.h each), AP_Motors/AP_MotorsMulticopter.cpp, SRV_Channel/SRV_Channel.h.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_model.frames import enu_from_ned, flu_from_frd
from quadftc_model.rotations import quaternion_from_euler
from quadftc_replay.dataflash import read_dataflash
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers.layouts import Layout, frame_layout
from quadftc_replay.readers.signals import Signals, Stamps, columns, sound, thrust_of_throttle

FORMAT = "ArduPilot BIN"
Table = Mapping[str, NDArray[np.float64]]  # field to (n,)

ESTIMATES = ("XKF1", "NKF1", "EKF1")
LEAST_SHARE = 0.01  # of the messages of the most frequent instance
MAX_TIME = 2.0**62 / 1000.0  # µs
INSTANCES = ("I", "Instance", "Inst", "C", "IMU")  # field that tells instances apart
_GYRO, _FORCE = ([f"{begin}{axis}" for axis in "XYZ"] for begin in ("Gyr", "Acc"))
_FIELDS = {
    **dict.fromkeys(("IMU", "IMU2", "IMU3"), (*_GYRO, *_FORCE)),
    "GYR": ("SampleUS", *_GYRO),
    "ACC": ("SampleUS", *_FORCE),
    "MAG": ("MagX", "MagY", "MagZ"),
    **dict.fromkeys(("ATT", "ANG"), ("Roll", "Pitch", "Yaw")),
    "GPS": ("Spd", "GCrs", "VZ"),
    "MSG": ("Message",),
    "ERR": ("Subsys", "ECode"),
    "EV": ("Id",),
    "RATE": ("R", "P", "Y", "ROut", "POut", "YOut", "AOut"),
    "ESC": ("RPM",),
    "RCOU": tuple(f"C{k + 1}" for k in range(14)),
    "BAT": ("Volt",),
    **dict.fromkeys(ESTIMATES, ("PN", "PE", "PD", "VN", "VE", "VD")),
}
SENSORS = {"gyros": ("GYR", _GYRO), "accelerometers": ("ACC", _FORCE)}  # message other than IMU, fields
NAMES = {name: ("TimeUS", *INSTANCES, *fields) for name, fields in _FIELDS.items()}
DEGREE = math.pi / 180.0  # rad
RPM = 2.0 * math.pi / 60.0  # rad/s
TOGETHER = 0.005e9  # ns; reports of ESCs within this time are one sample
MOTOR_FUNCTIONS = {33 + k: k for k in range(8)} | {
    82 + k: 8 + k for k in range(4)
}  # SERVOn_FUNCTION -> motor
LEAST_RANGE = 50.0  # µs; the pulses of a motor in flight differ by more
OUTPUTS = 14  # in RCOU; SERVOn_FUNCTION of each is one of these
# what a pilot or an autopilot did, of ``EV``; what failed, of ``ERR`` (LogEvent, LogErrorSubsystem)
EVENTS = {
    10: "armed",
    11: "disarmed",
    15: "armed",
    17: "landed",
    18: "landed",
    28: "not landed",
    62: "EKF yaw reset",
}
SUBSYSTEMS = {
    2: "radio",
    3: "compass",
    5: "radio failsafe",
    6: "battery failsafe",
    8: "GCS failsafe",
    11: "GPS",
    12: "crash check",
    16: "EKF check",
    17: "EKF failsafe",
    18: "barometer",
    19: "CPU",
    24: "EKF primary",
    25: "thrust loss check",
    26: "sensors failsafe",
    28: "pilot input",
    29: "vibration failsafe",
}
CLASSES = {1: 4, 2: 6, 3: 8}  # FRAME_CLASS -> rotors
# FRAME_TYPE -> frame; 2 is a V, whose rotors turn as those of an X
_X = {1: "x", 2: "x", 12: "betaflight x", 13: "dji x", 14: "clockwise x", 18: "betaflight x reversed"}
FRAMES = {0: "plus", 3: "h", 6: "plus reversed"} | _X


def read(path: Path) -> FlightLog:
    """Read a log; BagError if it is none, or if nothing in it can be used."""
    log = read_dataflash(path, NAMES, INSTANCES)
    signals = Signals(path, FORMAT)
    signals.notes += log.notes
    for field, (fast, fields) in SENSORS.items():
        _add_sensors(signals, log.messages, field, fast, fields)
    _add_states(signals, log.messages)
    _add_events(signals, log.messages)
    parameters = sound(log.parameters)
    layout, note = _layout(parameters, log.messages.get("RCOU"))
    signals.notes += note
    motors = _motors(parameters, layout)
    _add_commands(signals, log.messages, parameters, motors)
    _add_speeds(signals, log.messages, motors)
    return signals.flight_log(
        attitude_from_gyro=True if signals.has("attitude") else None,
        torque_unit="1",
        rotor_positions=layout and layout.positions,
        rotor_yaw_signs=layout and layout.yaw_signs,
    )


def _instances(table: Table | None, *fields: str) -> dict[int, Table]:
    """Split a message by its instance, if it has some fields; all is of instance 0 if it has no instance."""
    if table is None or not {"TimeUS", *fields} <= table.keys():
        return {}
    key = next((name for name in INSTANCES if name in table), None)
    if key is None:
        return {0: table}
    numbers, counts = np.unique(table[key], return_counts=True)
    real = numbers[counts > LEAST_SHARE * counts.max()]  # others are damaged
    return {
        int(number): {name: values[table[key] == number] for name, values in table.items()}
        for number in real.tolist()
    }


def _first(table: Table | None, *fields: str) -> Table | None:
    """Return the first instance of a message; None if there is none with some fields."""
    found = _instances(table, *fields)
    return found[min(found)] if found else None


def _stamps(table: Table) -> Stamps:
    """Time of each message [ns] (n,): when it was sampled, else when it was logged."""
    return np.clip(table.get("SampleUS", table["TimeUS"]), 0.0, MAX_TIME).astype(np.int64) * 1000


def _add_sensors(
    signals: Signals, messages: Mapping[str, Table], field: str, fast: str, fields: list[str]
) -> None:
    """Add a sensor of every IMU, from the message that has more samples of it."""
    found = _instances(messages.get("IMU"), *fields)
    for number, name in ((1, "IMU2"), (2, "IMU3")):  # older logs
        if number not in found and (table := _first(messages.get(name), *fields)):
            found[number] = table
    for number, table in _instances(messages.get(fast), *fields).items():
        if number not in found or len(table["TimeUS"]) > len(found[number]["TimeUS"]):
            found[number] = table
    for number, table in sorted(found.items()):
        value = flu_from_frd(columns(table, fields))
        name = "" if number == min(found) else str(number)
        if np.any(value):
            signals.add(field, _stamps(table), value, f"{field} {number}", name)


def _add_states(signals: Signals, messages: Mapping[str, Table]) -> None:
    """Add attitude, position, velocity, rates and torques, magnetometer and battery."""
    attitudes = (_first(messages.get(name), "Roll", "Pitch", "Yaw") for name in ("ATT", "ANG"))
    if table := max(filter(None, attitudes), key=lambda each: len(each["TimeUS"]), default=None):
        roll, pitch, yaw = DEGREE * columns(table, ("Roll", "Pitch", "Yaw")).T
        angles = np.stack([roll, -pitch, math.pi / 2 - yaw], axis=-1)
        signals.add("attitude", _stamps(table), quaternion_from_euler(angles), "attitude")
    if table := _first(messages.get("GPS"), "Spd", "GCrs", "VZ"):
        speed, course, down = columns(table, ("Spd", "GCrs", "VZ")).T
        value = np.stack([speed * np.sin(DEGREE * course), speed * np.cos(DEGREE * course), -down], axis=-1)
        signals.add("gps_velocity", _stamps(table), value, "GPS")
    for name in ESTIMATES:
        if table := _first(messages.get(name), "PN", "PE", "PD", "VN", "VE", "VD"):
            for field, letter in (("position", "P"), ("velocity", "V")):
                value = columns(table, [f"{letter}{axis}" for axis in "NED"])
                signals.add(field, _stamps(table), enu_from_ned(value), name)
            break
    if table := _first(messages.get("RATE"), "ROut", "POut", "YOut", "AOut"):
        value = flu_from_frd(columns(table, ("ROut", "POut", "YOut")))
        signals.add("torque_command", _stamps(table), value, "RATE")
        signals.add("thrust_command", _stamps(table), table["AOut"], "RATE")
    table = _first(messages.get("RATE"), "R", "P", "Y")
    if table and not signals.has("gyros"):
        value = DEGREE * flu_from_frd(columns(table, ("R", "P", "Y")))
        signals.add("body_rate", _stamps(table), value, "RATE")
    if table := _first(messages.get("MAG"), "MagX", "MagY", "MagZ"):
        value = flu_from_frd(columns(table, ("MagX", "MagY", "MagZ")))
        signals.add("magnetometer", _stamps(table), value, "MAG")
    if table := _first(messages.get("BAT"), "Volt"):
        signals.add("battery", _stamps(table), table["Volt"], "BAT")


def _add_events(signals: Signals, messages: Mapping[str, Table]) -> None:
    """Add what the autopilot said: its messages as they are, errors and events in words."""
    said: list[tuple[int, str, str]] = []
    if (table := messages.get("MSG")) and {"TimeUS", "Message"} <= table.keys():
        texts = (bytes(each).split(b"\0")[0].decode("ascii", "replace") for each in table["Message"])  # type: ignore
        said += [(int(stamp), "MSG", text) for stamp, text in zip(_stamps(table), texts, strict=True)]
    if (table := messages.get("ERR")) and {"TimeUS", "Subsys", "ECode"} <= table.keys():
        for stamp, part, code in zip(_stamps(table), table["Subsys"], table["ECode"], strict=True):
            name = SUBSYSTEMS.get(int(part), f"subsystem {part:g}")
            said.append((int(stamp), "ERR", f"{name}: {'resolved' if code == 0 else f'error {code:g}'}"))
    if (table := messages.get("EV")) and {"TimeUS", "Id"} <= table.keys():
        known = (
            (stamp, EVENTS.get(int(number)))
            for stamp, number in zip(_stamps(table), table["Id"], strict=True)
        )
        said += [(int(stamp), "EV", name) for stamp, name in known if name]
    for stamp, source, text in sorted(said):
        signals.say(stamp, source, text)


def _layout(parameters: Mapping[str, float], outputs: Table | None) -> tuple[Layout | None, list[str]]:
    """Where the rotors are, and notes."""
    for prefix in ("", "Q_"):
        kind, form = (parameters.get(f"{prefix}FRAME_{each}") for each in ("CLASS", "TYPE"))
        if kind and form is not None:
            layout = frame_layout(CLASSES.get(int(kind), 0), FRAMES.get(int(form), ""))
            unknown = f"{prefix}FRAME_CLASS {kind:g}, {prefix}FRAME_TYPE {form:g}: this layout is not known"
            return layout, [] if layout else [unknown]
    if "FRAME" in parameters and outputs is not None:  # before Copter 3.5
        pulses = [outputs.get(f"C{k + 1}", np.zeros(1)) for k in range(OUTPUTS)]
        count = int(np.argmin([float(np.ptp(pulse)) > LEAST_RANGE for pulse in pulses]))
        if layout := frame_layout(count, FRAMES.get(int(parameters["FRAME"]), "")):
            return layout, [f"layout of the rotors: by FRAME, and {count} outputs that move"]
    return None, ["no FRAME_CLASS and FRAME_TYPE among the parameters: layout of the rotors not known"]


def _motors(parameters: Mapping[str, float], layout: Layout | None) -> dict[int, int]:
    """Motor of each output, both from 0; without parameters of outputs, as many as the layout has."""
    motors: dict[int, int] = {}
    for output in range(OUTPUTS):
        function = parameters.get(f"SERVO{output + 1}_FUNCTION", 0.0)
        if (motor := MOTOR_FUNCTIONS.get(int(function) if math.isfinite(function) else 0)) is not None:
            motors[output] = motor
    count = len(layout.yaw_signs) if layout else len(motors)
    if sorted(motors.values()) == list(range(count)):
        return motors
    return {output: output for output in range(count)}


def _add_commands(
    signals: Signals,
    messages: Mapping[str, Table],
    parameters: Mapping[str, float],
    motors: Mapping[int, int],
) -> None:
    """Add commands of the rotors, as shares of the greatest thrust."""
    outputs = [f"C{output + 1}" for output in sorted(motors, key=lambda each: motors[each])]
    table = _first(messages.get("RCOU"), *outputs)
    if not table or not motors:
        return

    def get(name: str, default: float) -> float:
        return next((parameters[f"{q}{name}"] for q in ("", "Q_") if f"{q}{name}" in parameters), default)

    ranges = [(get(f"{name}_MIN", 0.0), get(f"{name}_MAX", 0.0)) for name in ("MOT_PWM", "RC3")]
    low, high = next((each for each in ranges if 0.0 < each[0] < each[1]), (1000.0, 2000.0))
    spin_min, spin_max = get("MOT_SPIN_MIN", 0.15), get("MOT_SPIN_MAX", 0.95)
    if not 0.0 <= spin_min < spin_max <= 1.0:
        spin_min, spin_max = 0.0, 1.0
    share = (columns(table, outputs) - low) / (high - low)
    throttle = np.clip((share - spin_min) / (spin_max - spin_min), 0.0, 1.0)
    signals.add(
        "rotor_commands", _stamps(table), thrust_of_throttle(throttle, get("MOT_THST_EXPO", 0.65)), "RCOU"
    )


def _add_speeds(signals: Signals, messages: Mapping[str, Table], motors: Mapping[int, int]) -> None:
    """Add the speeds that the ESCs report, those of about the same time in one sample."""
    table = messages.get("ESC")
    if table is None or not _instances(table, "RPM") or not motors:
        return
    stamps, key = _stamps(table), next(name for name in INSTANCES if name in table)
    motor = np.array([motors.get(int(output), -1) for output in table[key].tolist()])
    used = np.flatnonzero(motor >= 0)
    stamps, motor, speed = stamps[used], motor[used], RPM * np.abs(columns(table, ["RPM"])[used, 0])
    rows = group_reports(stamps, motor)
    if not len(rows) or not np.any(speed):
        return
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    value = np.full((len(first), len(motors)), np.nan)
    value[rows, motor] = speed
    signals.add("rotor_speeds", stamps[first], value, "ESC")


def group_reports(stamp_ns: Stamps, motor: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the sample each report belongs to (n,): of different motors, within `TOGETHER`."""
    rows = np.empty(len(stamp_ns), np.int64)
    row, start, seen = -1, 0, set[int]()
    for k, (stamp, number) in enumerate(zip(stamp_ns.tolist(), motor.tolist(), strict=True)):
        if row < 0 or number in seen or not 0 <= stamp - start <= TOGETHER:
            row, start, seen = row + 1, stamp, set[int]()
        seen.add(number)
        rows[k] = row
    return rows
