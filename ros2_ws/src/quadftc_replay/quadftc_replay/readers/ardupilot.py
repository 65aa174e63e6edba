"""A log of ArduPilot (DataFlash, ``.BIN``, or ``.log`` as text) as a flight log.

| signal | message: fields |
|---|---|
| gyros | ``IMU`` or ``GYR``, whichever has more samples: ``GyrX`` to ``GyrZ`` [rad/s] of each instance |
| accelerometers | ``IMU`` or ``ACC``: ``AccX`` to ``AccZ`` [m/s²] of each instance |
| magnetometers | ``MAG``, ``MAG2``, ``MAG3``: ``MagX`` to ``MagZ`` [mGauss] |
| barometers | ``BARO``, ``BAR2``, ``BAR3``: ``Alt`` [m] |
| attitude | ``ATT`` or ``ANG``, whichever has more samples: ``Roll``, ``Pitch``, ``Yaw`` [deg] |
| body rate | ``RATE``: ``R``, ``P``, ``Y`` [deg/s], without a gyro |
| position, velocity | ``XKF1``, ``NKF1`` or ``EKF1``: ``PN`` ... [m], ``VN`` ... [m/s] of the primary core |
| satellites | ``GPS``, ``GPS2``: ``Lat``, ``Lng`` [deg], ``Alt`` [m], ``Spd``, ``VZ`` [m/s], ``GCrs`` [deg] |
| their status | ``GPS``: ``Status``, ``NSats``; ``GPA``, ``GPA2``: ``HAcc`` [m] |
| rotor speeds | ``ESC``: ``RPM`` of each instance |
| rotor commands | ``RCOU``: ``C1`` to ``C14`` [µs] |
| torque, thrust command | ``RATE``: ``ROut``, ``POut``, ``YOut``, ``AOut``, shares of the greatest |
| battery | ``BAT``: ``Volt`` [V] |
| vibration, clips | ``VIBE``: ``VibeX`` to ``VibeZ`` [m/s²], ``Clip`` of the first IMU |
| limits | ``XKF4`` or ``NKF4``: ``SV``, ``SP``, ``SH``, ``SM``; ``POWR``: ``Vcc``; ``PM``; ``DSF`` |
| flown position, acceleration | ``PSCN``, ``PSCE``, ``PSCD``; before 4.2 ``PSC``, ``PSCZ`` [m, m/s²] |
| events | ``MSG``; ``ERR`` and ``EV`` in words |
| layout of the rotors | ``PARM``: ``FRAME_CLASS``, ``FRAME_TYPE``, of a quadplane with ``Q_`` |

`ardupilot_tables` says how rotors are told.

The frames are north-east-down and forward-right-down; `frames` turns them. The attitude is ArduPilot's own
estimate, to which these gyros have contributed. Since version 4.0 one message tells sensors apart by a field;
before, each had a message of its own. What the autopilot holds of their health goes to the events.

Source: ArduPilot, libraries/AP_Logger/LogStructure.h, AP_InertialSensor, AP_AHRS, AP_NavEKF3, AP_ESC_Telem,
AP_BattMonitor (LogStructure.h each), AP_Motors/AP_MotorsMulticopter.cpp, SRV_Channel/SRV_Channel.h.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from quadftc_model.frames import enu_flu_from_ned_frd_angles, enu_from_ned, flu_from_frd
from quadftc_replay.dataflash import DataflashLog, read_dataflash, text_of
from quadftc_replay.dataflash_text import read_dataflash_text
from quadftc_replay.flight_log import FlightLog
from quadftc_replay.readers.ardupilot_tables import (
    INSTANCES,
    Table,
    add_rotors,
    at,
    first_of,
    instances_of,
    stamps_of,
)
from quadftc_replay.readers.positioning import Fixes, add_receiver
from quadftc_replay.readers.signals import DEGREE, Signals, columns, sound

MAGNETOMETERS, BAROMETERS = ("MAG", "MAG2", "MAG3"), ("BARO", "BAR2", "BAR3")
RECEIVERS, ACCURACIES = ("GPS", "GPS2"), ("GPA", "GPA2")
_FIELD, _MOTION = ("MagX", "MagY", "MagZ"), ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ")
FORMAT, FORMAT_TEXT = "ArduPilot BIN", "ArduPilot log"

ESTIMATES = ("XKF1", "NKF1", "EKF1")
_GYRO, _FORCE = ([f"{begin}{axis}" for axis in "XYZ"] for begin in ("Gyr", "Acc"))
# innovation over what the estimator accepts
_RATIOS = {"SV": "velocity", "SP": "position", "SH": "height", "SM": "magnetic field"}
BOARD_VOLTAGE = 4.3  # V; ArduPilot's arming check
BUSY, LATE = 0.95, 0.1  # 1; of the processor's time; of its loops
_FIELDS = {
    **dict.fromkeys(("IMU", "IMU2", "IMU3"), (*_GYRO, *_FORCE)),
    "GYR": ("SampleUS", *_GYRO),
    "ACC": ("SampleUS", *_FORCE),
    **dict.fromkeys(("MAG", "MAG2", "MAG3"), ("MagX", "MagY", "MagZ", "Health")),
    **dict.fromkeys(("BARO", "BAR2", "BAR3"), ("Alt", "H", "Health")),
    **dict.fromkeys(("ATT", "ANG"), ("Roll", "Pitch", "Yaw")),
    **dict.fromkeys(("GPS", "GPS2"), ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ", "Status", "NSats")),
    **dict.fromkeys(("GPA", "GPA2"), ("HAcc",)),
    "MSG": ("Message",),
    "ERR": ("Subsys", "ECode"),
    "EV": ("Id",),
    "RATE": ("R", "P", "Y", "ROut", "POut", "YOut", "AOut"),
    "ESC": ("RPM",),
    "RCOU": tuple(f"C{k + 1}" for k in range(14)),
    "BAT": ("Volt",),
    **dict.fromkeys(("XKF4", "NKF4"), (*_RATIOS, "PI")),
    "PM": ("NLon", "NL", "Load"),
    "POWR": ("Vcc",),
    "DSF": ("Dp",),
    "VIBE": ("VibeX", "VibeY", "VibeZ", "Clip"),
    "PSC": ("PX", "PY", "AX", "AY"),
    "PSCZ": ("PZ",),
    **{f"PSC{axis}": (f"P{axis}", f"A{axis}") for axis in "NED"},
    **dict.fromkeys(ESTIMATES, ("PN", "PE", "PD", "VN", "VE", "VD")),
}
SENSORS = {"gyros": ("GYR", _GYRO), "accelerometers": ("ACC", _FORCE)}  # message other than IMU, fields
NAMES = {name: ("TimeUS", *INSTANCES, *fields) for name, fields in _FIELDS.items()}
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
_SUBSYSTEMS = (
    *("main loop", "radio", "compass", "optical flow", "radio failsafe", "battery failsafe"),
    *("GPS failsafe", "GCS failsafe", "fence failsafe", "flight mode", "GPS", "crash check", "flip"),
    *("autotune", "parachute", "EKF check", "EKF failsafe", "barometer", "CPU", "ADSB failsafe"),
    *("terrain", "navigation", "terrain failsafe", "EKF primary", "thrust loss check"),
    *("sensors failsafe", "leak failsafe", "pilot input", "vibration failsafe", "internal error"),
    "dead reckoning failsafe",
)
SUBSYSTEMS = dict(enumerate(_SUBSYSTEMS, 1))


def read(path: Path) -> FlightLog:
    """Read a log; BagError if it is none, or if nothing in it can be used."""
    return _flight_log(path, FORMAT, read_dataflash(path, NAMES, INSTANCES))


def read_text(path: Path) -> FlightLog:
    """Read a log as text; BagError if nothing in it can be used."""
    return _flight_log(path, FORMAT_TEXT, read_dataflash_text(path, NAMES, INSTANCES))


def _flight_log(path: Path, name: str, log: DataflashLog) -> FlightLog:
    signals = Signals(path, name)
    signals.notes += log.notes
    if log.lacks_chunk and _ends_armed(log.messages):
        signals.notes.append("cut short: the log ends within a message, with the vehicle armed")
    for field, (fast, fields) in SENSORS.items():
        _add_sensors(signals, log.messages, field, fast, fields)
    _add_states(signals, log.messages)
    add_navigation(signals, log.messages)
    _add_events(signals, log.messages)
    layout = add_rotors(signals, log.messages, sound(log.parameters))
    return signals.flight_log(layout, is_own=True, torque_unit="1")


def _ends_armed(messages: Mapping[str, Table]) -> bool:
    """Whether the vehicle was armed, and not disarmed again before the log ends."""
    numbers = messages.get("EV", {}).get("Id", ())
    said = [word for number in numbers if (word := EVENTS.get(int(number))) in ("armed", "disarmed")]
    return said[-1:] == ["armed"]


def _add_sensors(
    signals: Signals, messages: Mapping[str, Table], field: str, fast: str, fields: list[str]
) -> None:
    """Add a sensor of every IMU, from the message that has more samples of it."""
    found = instances_of(messages.get("IMU"), *fields)
    for number, name in ((1, "IMU2"), (2, "IMU3")):  # older logs
        if number not in found and (table := first_of(messages.get(name), *fields)):
            found[number] = table
    for number, table in instances_of(messages.get(fast), *fields).items():
        if number not in found or len(table["TimeUS"]) > len(found[number]["TimeUS"]):
            found[number] = table
    for number, table in sorted(found.items()):
        value = flu_from_frd(columns(table, fields))
        name = "" if number == min(found) else str(number)
        if np.any(value):
            signals.add(field, stamps_of(table), value, f"{field} {number}", name)


def _add_states(signals: Signals, messages: Mapping[str, Table]) -> None:
    attitudes = (first_of(messages.get(name), "Roll", "Pitch", "Yaw") for name in ("ATT", "ANG"))
    if table := max(filter(None, attitudes), key=lambda each: len(each["TimeUS"]), default=None):
        attitude = enu_flu_from_ned_frd_angles(DEGREE * columns(table, ("Roll", "Pitch", "Yaw")))
        signals.add("attitude", stamps_of(table), attitude, "attitude")
    for name in ESTIMATES:
        if table := _of_primary(messages, name, "PN", "PE", "PD", "VN", "VE", "VD"):
            for field, letter in (("position", "P"), ("velocity", "V")):
                value = columns(table, [f"{letter}{axis}" for axis in "NED"])
                signals.add(field, stamps_of(table), enu_from_ned(value), name)
            break
    if table := first_of(messages.get("RATE"), "ROut", "POut", "YOut", "AOut"):
        value = flu_from_frd(columns(table, ("ROut", "POut", "YOut")))
        signals.add("torque_command", stamps_of(table), value, "RATE")
        signals.add("thrust_command", stamps_of(table), table["AOut"], "RATE")
    table = first_of(messages.get("RATE"), "R", "P", "Y")
    if table and not signals.has("gyros"):
        value = DEGREE * flu_from_frd(columns(table, ("R", "P", "Y")))
        signals.add("body_rate", stamps_of(table), value, "RATE")
    if table := first_of(messages.get("BAT"), "Volt"):
        signals.add("battery", stamps_of(table), table["Volt"], "BAT")
    if table := first_of(messages.get("VIBE"), "VibeX", "VibeY", "VibeZ"):
        signals.add("vibration", stamps_of(table), columns(table, ("VibeX", "VibeY", "VibeZ")), "VIBE")
        if "Clip" in table:
            signals.add("clips", stamps_of(table), table["Clip"], "VIBE")
    _add_flown(signals, messages)
    _watch(signals, messages)


def _of_primary(messages: Mapping[str, Table], name: str, *fields: str) -> Table | None:
    """Return what an estimator's message says of the core that the autopilot flies by at each time."""
    cores = instances_of(messages.get(name), *fields)
    switch = next(filter(None, (first_of(messages.get(each), "PI") for each in ("XKF4", "NKF4"))), None)
    if switch is None or len(cores) < 2:
        return cores[min(cores)] if cores else None
    stamp_ns, primary = stamps_of(switch), switch["PI"]
    parts = [
        {
            field: values[
                primary[np.maximum(np.searchsorted(stamp_ns, stamps_of(table), "right") - 1, 0)] == core
            ]
            for field, values in table.items()
        }
        for core, table in cores.items()
    ]
    order = np.argsort(np.concatenate([each["TimeUS"] for each in parts]), kind="stable")
    return {field: np.concatenate([each[field] for each in parts])[order] for field in parts[0]}


def _watch(signals: Signals, messages: Mapping[str, Table]) -> None:
    ratios = (instances_of(messages.get(name), *_RATIOS) for name in ("XKF4", "NKF4"))
    if cores := next(filter(None, ratios), None):
        table = cores[min(cores)]
        primary = int(np.median(table["PI"])) if "PI" in table else min(cores)
        table = cores.get(primary, table)
        for field, name in _RATIOS.items():
            signals.watch(f"EKF innovation of the {name}", stamps_of(table), table[field], 1.0)
    if table := first_of(messages.get("POWR"), "Vcc"):
        used = table["Vcc"] > 0.0
        voltage = table["Vcc"][used]
        signals.watch("board voltage", stamps_of(table)[used], voltage, BOARD_VOLTAGE, "V", True)
    if table := first_of(messages.get("PM"), "NLon", "NL"):
        late = table["NLon"] / np.maximum(table["NL"], 1.0)
        signals.watch("share of loops that are late", stamps_of(table), late, LATE)
    if table := first_of(messages.get("PM"), "Load"):
        signals.watch("load of the processor", stamps_of(table), 0.001 * table["Load"], BUSY)
    if table := first_of(messages.get("DSF"), "Dp"):
        lost = np.diff(table["Dp"], prepend=table["Dp"][:1])
        signals.watch("messages that the logger lost", stamps_of(table), np.maximum(lost, 0.0), 0.0)


def _add_flown(signals: Signals, messages: Mapping[str, Table]) -> None:
    north, east, down = (first_of(messages.get(f"PSC{axis}"), f"P{axis}", f"A{axis}") for axis in "NED")
    old, old_up = first_of(messages.get("PSC"), "PX", "PY", "AX", "AY"), first_of(messages.get("PSCZ"), "PZ")
    if north and east:
        stamp_ns = stamps_of(north)
        position = [at(stamp_ns, east, "PE"), north["PN"]]
        acceleration = [at(stamp_ns, east, "AE"), north["AN"]]
        height = -at(stamp_ns, down, "PD") if down else None
    elif old:
        stamp_ns = stamps_of(old)
        position, acceleration = [old["PY"], old["PX"]], [old["AY"], old["AX"]]
        height = at(stamp_ns, old_up, "PZ") if old_up else None
    else:
        return
    height = np.full(len(stamp_ns), np.nan) if height is None else height
    signals.add("flown_position", stamp_ns, np.stack([*position, height], axis=-1), "PSC")
    signals.add("flown_acceleration", stamp_ns, np.stack(acceleration, axis=-1), "PSC")


def _add_events(signals: Signals, messages: Mapping[str, Table]) -> None:
    said: list[tuple[int, str, str]] = []
    if (table := messages.get("MSG")) and {"TimeUS", "Message"} <= table.keys():
        texts = map(text_of, table["Message"])  # type: ignore
        said += [(int(stamp), "MSG", text) for stamp, text in zip(stamps_of(table), texts, strict=True)]
    if (table := messages.get("ERR")) and {"TimeUS", "Subsys", "ECode"} <= table.keys():
        for stamp, part, code in zip(stamps_of(table), table["Subsys"], table["ECode"], strict=True):
            name = SUBSYSTEMS.get(int(part), f"subsystem {part:g}")
            said.append((int(stamp), "ERR", f"{name}: {'resolved' if code == 0 else f'error {code:g}'}"))
    if (table := messages.get("EV")) and {"TimeUS", "Id"} <= table.keys():
        known = zip(stamps_of(table), [EVENTS.get(int(number)) for number in table["Id"]], strict=True)
        said += [(int(stamp), "EV", name) for stamp, name in known if name]
    for stamp, source, text in sorted(said):
        signals.say(stamp, source, text)


def add_navigation(signals: Signals, messages: Mapping[str, Table]) -> None:
    """Add every magnetometer, barometer and satellite receiver."""
    for name, source, table in _each(messages, MAGNETOMETERS, *_FIELD):
        field = flu_from_frd(columns(table, _FIELD))
        if np.any(field):
            signals.add("magnetometers", stamps_of(table), field, source, name)
            _add_health(signals, table, source)
    for name, source, table in _each(messages, BAROMETERS, "Alt"):
        signals.add("barometers", stamps_of(table), table["Alt"], source, name)
        _add_health(signals, table, source)
    accuracies = {name: table for name, _, table in _each(messages, ACCURACIES, "HAcc")}
    for name, source, table in _each(messages, RECEIVERS, *_MOTION):
        latitude, longitude, height, speed, course, down = columns(table, _MOTION).T
        stamp_ns, course = stamps_of(table), np.radians(course)
        unknown = np.full(len(stamp_ns), np.nan)
        claims = accuracies.get(name)
        said = Fixes(
            *(latitude, longitude, height),
            velocity=np.stack([speed * np.sin(course), speed * np.cos(course), -down], axis=-1),
            fix=np.asarray(table.get("Status", unknown), np.float64),
            satellites=np.asarray(table.get("NSats", unknown), np.float64),
            accuracy=at(stamp_ns, claims, "HAcc") if claims else unknown,
        )
        add_receiver(signals, stamp_ns, said, source, name)


def _each(messages: Mapping[str, Table], names: Sequence[str], *fields: str) -> list[tuple[str, str, Table]]:
    """Every sensor of a kind: its name (the first has none), its name in the log, its samples."""
    found = instances_of(messages.get(names[0]), *fields)
    for number, name in enumerate(names[1:], 1):
        if number not in found and (table := instances_of(messages.get(name), *fields).get(0)):
            found[number] = table
    order = sorted(found.items())
    return [
        ("" if number == order[0][0] else str(number), f"{names[0]} {number}", table)
        for number, table in order
    ]


def _add_health(signals: Signals, table: Table, source: str) -> None:
    """Say when the autopilot takes a sensor for unhealthy, and when no more."""
    health = next((table[name] for name in ("Health", "H") if name in table), None)
    if health is None:
        return
    stamp_ns, healthy = stamps_of(table), health > 0
    for row in np.flatnonzero(np.diff(healthy, prepend=True)).tolist():
        signals.say(int(stamp_ns[row]), source, "healthy" if healthy[row] else "unhealthy")
