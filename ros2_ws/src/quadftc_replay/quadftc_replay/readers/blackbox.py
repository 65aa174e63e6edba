"""A blackbox log of Betaflight, INAV or Rotorflight as a flight log.

| signal | fields |
|---|---|
| gyro | ``gyroADC``, else ``gyroUnfilt``, ``gyroData`` [``gyro_scale`` deg/s, a tenth in high resolution] |
| accelerometer | ``accSmooth`` [1 / ``acc_1G`` g] |
| magnetometer | ``magADC`` |
| attitude | ``imuQuaternion`` [1 / 32767] (Betaflight), ``attitude`` [0.1 deg] (INAV, Rotorflight) |
| position, velocity | ``navPos``, ``navVel`` [cm, cm/s] (INAV) |
| rotor speeds | ``eRPM`` [100 / pairs of poles rpm] |
| rotor commands | ``motor``, shares of ``motorOutput``, else of ``minthrottle`` to ``maxthrottle`` |
| torque command | ``axisP`` + ``axisI`` + ``axisD`` + ``axisF`` [1 / 1000] |
| thrust command | ``setpoint[3]`` [1 / 1000], else ``rcCommand[3]`` [µs] |
| battery | ``vbatLatest``, ``vbat`` [0.01 V; 0.1 V before Betaflight 4] |

The body frame is forward-left-up, as the firmware's attitude estimator has it: at rest the accelerometer
reads +1 g along z. Earth axes of the estimator are north-west-up, of the navigation north-east-up. How the
torques were mixed into the commands tells where the rotors are; else four motors are taken for Betaflight's
quad X. Those of a helicopter (Rotorflight) are no rotors in this sense. INAV was not proven on a real log.

Source: betaflight and iNavFlight/inav, src/main/blackbox/blackbox.c, src/main/flight/imu.c, mixer_init.c.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import quaternion_from_euler, quaternion_product
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.blackbox import BlackboxLog, read_blackbox, whole_number
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.layouts import Layout, frame_layout, mixer_layout
from quadftc_replay.readers.signals import DEGREE, Signals

GYROS = ("gyroADC", "gyroUnfilt", "gyroData")
TERMS = ("axisP", "axisI", "axisD", "axisF")
BATTERY = ("vbatLatest", "vbat")
OTHERS = ("accSmooth", "magADC", "imuQuaternion", "attitude", "navPos", "navVel", "eRPM", "motor")
WANTED = (*GYROS, *TERMS, *BATTERY, *OTHERS, "setpoint[3]", "rcCommand[3]")
Q_ENU_NWU = np.array([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])  # x, y, z, w
QUATERNION_UNIT = 32767.0
MOST_ROTORS = 12


def read(path: Path, log: int = 0) -> FlightLog:
    """Read a log, of several in the file one; BagError if nothing in it can be used."""
    content = read_blackbox(path, log, WANTED)
    header, stamp_ns = content.header, content.columns["time"] * 1000
    firmware, version = _firmware(header)
    signals = Signals(path, f"{firmware} blackbox")
    signals.notes += content.notes
    gyro = next((name for name in GYROS if f"{name}[0]" in content.columns), "")
    if (value := _vectors(content, gyro)) is not None:
        signals.add("gyros", stamp_ns, value * _gyro_scale(header), gyro)
    one_g = _number(header, "acc_1G")
    if (value := _vectors(content, "accSmooth")) is not None and one_g > 0.0 and np.any(value):
        signals.add("accelerometers", stamp_ns, value * (STANDARD_GRAVITY / one_g), "accSmooth")
    if (value := _vectors(content, "magADC")) is not None and np.any(value):
        signals.add("magnetometers", stamp_ns, value, "magADC")
    _add_states(signals, content, stamp_ns)
    layout = _add_rotors(signals, content, stamp_ns, firmware)
    _add_setpoints(signals, content, stamp_ns)
    unit = 0.01 if version >= 4 or firmware == "INAV" else 0.1
    for name in BATTERY:
        if name in content.columns and np.any(content.columns[name]):
            signals.add("battery", stamp_ns, unit * content.columns[name], name)
            break
    return signals.flight_log(layout, is_own=True, field_unit="", torque_unit="1")


def _firmware(header: Mapping[str, str]) -> tuple[str, int]:
    """Name of the firmware, and the first number of its version."""
    revision = header.get("Firmware revision", "")
    named = re.match(r"([A-Za-z]+) ", revision)
    version = re.search(r"(\d{1,9})\.\d", revision)
    name = named[1] if named else header.get("Firmware type", "unknown")
    return name, int(version[1]) if version else 0


def _number(header: Mapping[str, str], name: str) -> float:
    try:
        value = float(header.get(name, ""))
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


def _gyro_scale(header: Mapping[str, str]) -> float:
    """Unit of the gyro [rad/s]; ``gyro_scale`` has the bits of a float [deg/s]."""
    text = header.get("gyro_scale", "")
    bits = int(text, 16) if re.fullmatch(r"0x[0-9a-fA-F]{1,8}", text) else 0
    scale = struct.unpack("<f", struct.pack("<I", bits))[0]
    scale = scale if math.isfinite(scale) and scale > 0.0 else 1.0
    return scale * DEGREE / (10.0 if header.get("blackbox_high_resolution") == "1" else 1.0)


def _vectors(content: BlackboxLog, name: str, count: int = 3) -> Floats | None:
    """Elements of a field (n, count); None if they are not there."""
    names = [f"{name}[{k}]" for k in range(count)]
    if not names or not content.columns.keys() >= {*names}:
        return None
    return np.stack([content.columns[each] for each in names], axis=-1).astype(np.float64)


def _count(content: BlackboxLog, name: str) -> int:
    return next(k for k in range(MOST_ROTORS + 1) if f"{name}[{k}]" not in content.columns)


def _add_states(signals: Signals, content: BlackboxLog, stamp_ns: NDArray[np.int64]) -> None:
    if (value := _vectors(content, "imuQuaternion")) is not None and np.any(value):
        part = value / QUATERNION_UNIT
        w = np.sqrt(np.clip(1.0 - np.sum(part**2, axis=1), 0.0, 1.0))
        q_xyzw = np.concatenate([part, w[:, None]], axis=1)
        q_xyzw /= np.linalg.norm(q_xyzw, axis=1, keepdims=True)
        signals.add("attitude", stamp_ns, quaternion_product(Q_ENU_NWU, q_xyzw), "imuQuaternion")
    elif (value := _vectors(content, "attitude")) is not None and np.any(value):
        roll, pitch, heading = 0.1 * DEGREE * value.T
        angles = np.stack([roll, pitch, math.pi / 2.0 - heading], axis=-1)
        signals.add("attitude", stamp_ns, quaternion_from_euler(angles), "attitude")
    for field, name in (("position", "navPos"), ("velocity", "navVel")):
        if (value := _vectors(content, name)) is not None and np.any(value):
            signals.add(field, stamp_ns, 0.01 * value[:, [1, 0, 2]], name)


def _add_rotors(
    signals: Signals, content: BlackboxLog, stamp_ns: NDArray[np.int64], firmware: str
) -> Layout | None:
    header, count = content.header, _count(content, "motor")
    if firmware == "Rotorflight":
        signals.notes.append("of a helicopter: its motors are not judged")
        return None
    value = _vectors(content, "motor", count)
    if value is None:
        return None
    low, high = _output_range(header)
    commands = np.clip((value - low) / (high - low), 0.0, 1.0)
    signals.add("rotor_commands", stamp_ns, commands, "motor")
    signals.notes.append(f"rotor commands: motor, {low:g} to {high:g}")
    speeds, poles = _vectors(content, "eRPM", count), _number(header, "motor_poles")
    if speeds is not None and poles > 0.0 and np.any(speeds):
        signals.add("rotor_speeds", stamp_ns, speeds * (100.0 * 2.0 / poles * math.pi / 30.0), "eRPM")
    torques = _torques(content)
    if torques is not None and (layout := mixer_layout(commands, torques)):
        signals.notes.append("where the rotors are: by how the firmware mixed torques into their commands")
        return layout
    layout = frame_layout(count, "betaflight x")
    how = "taken as quad X of Betaflight" if layout else "not known"
    signals.notes.append(f"the log does not tell where its {count} rotors are; {how}")
    return layout


def _output_range(header: Mapping[str, str]) -> tuple[float, float]:
    pairs = [
        header.get("motorOutput", "").split(","),
        [header.get(f"{end}throttle", "") for end in ("min", "max")],
    ]
    for pair in pairs:
        ends = [whole_number(each) for each in pair]
        if len(ends) == 2 and 0 <= ends[0] < ends[1]:
            return float(ends[0]), float(ends[1])
    return 1000.0, 2000.0


def _torques(content: BlackboxLog) -> Floats | None:
    """Torques that the controller asked for (n, 3), as shares of the range of a motor."""
    if _vectors(content, TERMS[0]) is None:
        return None
    columns, absent = content.columns, np.zeros(len(content.columns["time"]), np.int64)
    sums = [sum((columns.get(f"{term}[{k}]", absent) for term in TERMS), absent) for k in range(3)]
    return np.stack(sums, axis=-1) / 1000.0


def _add_setpoints(signals: Signals, content: BlackboxLog, stamp_ns: NDArray[np.int64]) -> None:
    columns = content.columns
    if (torques := _torques(content)) is not None:
        signals.add("torque_command", stamp_ns, torques, ", ".join(TERMS))
    if "setpoint[3]" in columns:
        signals.add("thrust_command", stamp_ns, columns["setpoint[3]"] / 1000.0, "setpoint[3]")
    elif "rcCommand[3]" in columns:
        signals.add("thrust_command", stamp_ns, (columns["rcCommand[3]"] - 1000.0) / 1000.0, "rcCommand[3]")
