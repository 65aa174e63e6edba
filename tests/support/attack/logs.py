"""Flight logs of every format, built field by field.

A format's writer puts a `Flight` into bytes as it stands: stamps keep their order, numbers beyond the range
of a field's type become its nearest end.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega

from attack.flight_table import AXES, COUNT, PERIOD, ROTORS, START, Flight, braid, rotors, rows, vector, whole
from attack.ros_logs import mcap, ros1
from quadftc_replay.dataflash import FORMAT, FORMAT_TYPE, HEAD
from quadftc_replay.writers.ardupilot import TYPES as LETTERS

mavlink: Any = ardupilotmega
FRD = (1.0, -1.0, -1.0)
DATAFLASH = {  # name: type, letters, fields
    "PARM": (64, "QNf", "TimeUS,Name,Value"),
    "IMU": (65, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (66, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "RCOU": (67, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "BAT": (68, "QBf", "TimeUS,Inst,Volt"),
    "MSG": (69, "QZ", "TimeUS,Message"),
}
PARAMETERS = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}


def _dataflash_columns(flight: Flight) -> dict[str, list[Any]]:
    """Columns of each message behind its stamp."""
    gyro, force = vector(flight, "gyro", 1.0, FRD), vector(flight, "force", 1.0, FRD)
    angles = np.degrees(vector(flight, "angle"))
    zero = np.zeros(COUNT)
    return {
        "IMU": [zero, *gyro.T, *force.T],
        "ATT": [*angles.T],
        "RCOU": [*(1000.0 + 1000.0 * rotors(flight)).T],
        "BAT": [zero, flight["battery"]],
    }


def dataflash(flight: Flight, text: str = "hover") -> bytes:
    """Write an ArduPilot log (``.BIN``); ``text`` is what the autopilot says."""
    parts, streams, micro = list[bytes](), list[list[bytes]](), 1e6 * (5.0 + flight["time"])
    for name, (kind, letters, fields) in DATAFLASH.items():
        codes = [LETTERS[letter][0] for letter in letters]
        packed = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
        length = 3 + np.dtype([(str(k), code) for k, code in enumerate(packed)]).itemsize
        texts = (name.encode(), letters.encode(), fields.encode())
        parts.append(HEAD + bytes([FORMAT_TYPE]) + FORMAT.pack(kind, length, *texts))
        layout = [("head", "S2"), ("kind", "u1"), *((str(k), code) for k, code in enumerate(packed))]
        begin = {"head": HEAD, "kind": kind, "0": micro}
        if name == "PARM":
            for parameter, value in PARAMETERS.items():
                parts.append(rows(layout, {**begin, "1": parameter.encode(), "2": value})[0])
        elif name == "MSG":
            streams.append([b""] * (COUNT - 1) + rows(layout, {**begin, "1": text.encode()[:64]})[-1:])
        else:
            columns = zip(letters[1:], _dataflash_columns(flight)[name], strict=True)
            scaled = {str(k): v / (LETTERS[a][1] or 1.0) for k, (a, v) in enumerate(columns, 1)}
            streams.append(rows(layout, {**begin, **scaled}))
    return b"".join(parts) + braid(*streams)


def dataflash_text(flight: Flight) -> bytes:
    """Write an ArduPilot log as text, in which numbers are those of the table."""
    lines = [
        f"FMT, {kind}, 99, {name}, {types}, {fields}" for name, (kind, types, fields) in DATAFLASH.items()
    ]
    lines += [f"PARM, 5000000, {name}, {value}" for name, value in PARAMETERS.items()]
    columns = _dataflash_columns(flight)
    for k, time in enumerate((1e6 * (5.0 + flight["time"])).tolist()):
        stamp = int(time) if np.isfinite(time) else time
        for name, values in columns.items():
            lines.append(", ".join([name, f"{stamp}", *(repr(float(value[k])) for value in values)]))
    return ("\n".join(lines) + "\n").encode()


ULOG = {
    "sensor_combined": ("uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;", "<u8 3<f4 3<f4"),
    "vehicle_attitude": ("uint64_t timestamp;float[4] q;", "<u8 4<f4"),
    "actuator_motors": ("uint64_t timestamp;float[4] control;", "<u8 4<f4"),
    "battery_status": ("uint64_t timestamp;float voltage_v;", "<u8 <f4"),
}


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(flight: Flight, text: str = "hover") -> bytes:
    """Write a PX4 log; ``text`` is what the autopilot says."""
    micro = 1e6 * (5.0 + flight["time"])
    half = 0.5 * vector(flight, "angle", 1.0, FRD)
    columns = {
        "sensor_combined": [vector(flight, "gyro", 1.0, FRD), vector(flight, "force", 1.0, FRD)],
        "vehicle_attitude": [np.column_stack([np.ones(COUNT), half])],
        "actuator_motors": [rotors(flight)],
        "battery_status": [flight["battery"]],
    }
    parts = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", 5_000_000), _message("B", bytes(40))]
    parts += [_message("F", f"{name}:{fields}".encode()) for name, (fields, _) in ULOG.items()]
    parts += [_message("A", struct.pack("<BH", 0, k) + name.encode()) for k, name in enumerate(ULOG)]
    streams = list[list[bytes]]()
    for number, (name, (_, codes)) in enumerate(ULOG.items()):
        layout = [
            (str(k), code[-3:], (int(code[0]),) if len(code) > 3 else ())
            for k, code in enumerate(codes.split())
        ]
        fields = {"topic": number, "0": micro, **{str(k): each for k, each in enumerate(columns[name], 1)}}
        streams.append([_message("D", row) for row in rows([("topic", "<u2"), *layout], fields)])
    last = _message("L", b"6" + struct.pack("<Q", 5_000_000 + int(1e6 * PERIOD * COUNT)) + text.encode())
    return b"".join(parts) + braid(*streams) + last


def crazyflie(flight: Flight) -> bytes:
    """Write a log of a Crazyflie's uSD card, with its check sum."""
    gyro, force = np.degrees(vector(flight, "gyro")), vector(flight, "force", 1.0 / 9.81)
    half, outputs = 0.5 * vector(flight, "angle"), 65535.0 * rotors(flight)
    columns = {f"gyro.{a}(f)": gyro[:, k] for k, a in enumerate(AXES)}
    columns |= {f"acc.{a}(f)": force[:, k] for k, a in enumerate(AXES)}
    columns |= {f"stateEstimate.q{a}(f)": half[:, k] for k, a in enumerate(AXES)}
    columns |= {"stateEstimate.qw(f)": np.ones(COUNT), "pm.vbat(f)": flight["battery"] / 3.0}
    columns |= {f"motor.m{k}(H)": outputs[:, k - 1] for k in range(1, 5)}
    head = struct.pack("<BHHH", 0xBC, 2, 1, 65535) + b"fixedFrequency\0" + struct.pack("<H", len(columns))
    head += b"".join(f"{name}\0".encode() for name in columns)
    kinds = {"f": "<f4", "H": "<u2"}
    layout = [("id", "<u2"), ("time", "<u8"), *((name, kinds[name[-2]]) for name in columns)]
    data = head + braid(rows(layout, {"id": 65535, "time": 1e6 * (5.0 + flight["time"]), **columns}))
    return data + struct.pack("<I", zlib.crc32(data))


def _unsigned(value: int) -> bytes:
    value, out = value & 0xFFFFFFFF, bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def blackbox(flight: Flight, header: Mapping[str, str] | None = None) -> bytes:
    """Write a blackbox log of whole frames; ``header`` replaces lines of its header."""
    columns = {"loopIteration": np.arange(float(COUNT)), "time": 1e6 * (5.0 + flight["time"])}
    columns["vbatLatest"] = 100.0 * flight["battery"]
    for k, axis in enumerate(AXES):
        columns[f"gyroADC[{k}]"] = np.degrees(flight[f"gyro.{axis}"])
        columns[f"accSmooth[{k}]"] = 2048.0 / 9.81 * flight[f"force.{axis}"]
        columns[f"imuQuaternion[{k}]"] = 0.5 * 32767.0 * flight[f"angle.{axis}"]
        columns[f"axisP[{k}]"] = 100.0 * flight[f"angle.{axis}"]
    for k, rotor in enumerate(ROTORS):
        columns[f"motor[{k}]"] = 158.0 + 1889.0 * flight[f"rotor.{rotor}"]
        columns[f"eRPM[{k}]"] = 100.0 * flight[f"rotor.{rotor}"]
    count = len(columns)
    lines = {
        "Product": "Blackbox flight data recorder by Nicholas Sherlock",
        "Data version": "2",
        "Firmware revision": "Betaflight 4.5.1 (abc) STM32F7X2",
        "gyro_scale": "0x3f800000",
        "acc_1G": "2048",
        "motorOutput": "158,2047",
        "vbatref": "2466",
        "motor_poles": "14",
        "Field I name": ",".join(columns),
        "Field I predictor": ",".join(["0"] * count),
        "Field I encoding": ",".join(["0"] * count),
        "Field P predictor": ",".join(["1"] * count),
        "Field P encoding": ",".join(["0"] * count),
        **(header or {}),
    }
    table = np.stack([whole(values, "<i4") for values in columns.values()], 1).astype(np.int64)
    body = [b"I" + b"".join(_unsigned(value << 1 ^ value >> 63) for value in row) for row in table.tolist()]
    head = "".join(f"H {name}:{value}\n" for name, value in lines.items())
    return head.encode("latin-1", "replace") + b"".join(body) + b"E\xffEnd of log\0"


def telemetry(flight: Flight) -> bytes:
    """Write a MAVLink telemetry log."""
    link, parts = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), list[bytes]()
    milli = 1000.0 * (5.0 + flight["time"])
    stamp = whole(milli, "<u4").tolist()
    received = whole(1e6 * (START + flight["time"]), "<u8").tolist()
    rate = whole(1000.0 * vector(flight, "gyro", 1.0, FRD), "<i2").tolist()
    force = whole(1000.0 / 9.81 * vector(flight, "force", 1.0, FRD), "<i2").tolist()
    outputs = whole(1000.0 + 1000.0 * rotors(flight), "<u2").tolist()
    angles, volts = vector(flight, "angle").tolist(), whole(1000.0 * flight["battery"], "<u2").tolist()

    def add(k: int, message: Any) -> None:
        parts.append(struct.pack(">Q", received[k]) + message.pack(link))

    for name, value in PARAMETERS.items():
        add(0, mavlink.MAVLink_param_value_message(name.encode(), value, 9, 4, 0))
    for k in range(COUNT):
        if k % 10 == 0:
            add(k, mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3))
            add(k, mavlink.MAVLink_sys_status_message(0, 0, 0, 0, volts[k], 0, 0, 0, 0, 0, 0, 0, 0))
        with np.errstate(over="ignore"):
            three = [float(np.float32(value)) for value in angles[k]]
        add(k, mavlink.MAVLink_attitude_message(stamp[k], *three, 0.0, 0.0, 0.0))
        add(k, mavlink.MAVLink_scaled_imu_message(stamp[k], *force[k], *rate[k], 1, 2, 3))
        add(k, mavlink.MAVLink_servo_output_raw_message(stamp[k], 0, *outputs[k], 0, 0, 0, 0))
    return b"".join(parts)


MAPPING = '[time]\ncolumn = "time"\n' + "".join(
    f'[[signal]]\nquantity = "{quantity}"\ncolumns = {names}\nunit = "{unit}"\n'
    for quantity, unit, names in (
        ("gyro", "rad/s", [f"gyro.{axis}" for axis in AXES]),
        ("accelerometer", "m/s^2", [f"force.{axis}" for axis in AXES]),
        ("position", "m", [f"position.{axis}" for axis in AXES]),
        ("battery", "V", ["battery"]),
    )
)


def table(flight: Flight) -> bytes:
    """Write a table, for the mapping `MAPPING`."""
    table = zip(*(values.tolist() for values in flight.values()), strict=True)
    lines = [",".join(flight), *(",".join(map(repr, row)) for row in table)]
    return ("\n".join(lines) + "\n").encode()


WRITERS: Mapping[str, Callable[[Flight], bytes]] = {
    "ArduPilot .BIN": dataflash,
    "ArduPilot text": dataflash_text,
    "PX4 ULog": ulog,
    "ROS 2 bag (MCAP)": mcap,
    "ROS 1 bag": ros1,
    "Crazyflie uSD": crazyflie,
    "blackbox": blackbox,
    "MAVLink tlog": telemetry,
    "CSV": table,
}
