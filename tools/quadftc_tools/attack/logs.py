# pyright: basic
"""Flight logs of every format, built field by field, so that any field can hold what no sensor gives.

A `Flight` is a table of a short hover. A format's writer puts it into bytes as it stands: stamps keep their
order, numbers beyond the range of a field's type become its nearest end.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosbags.typesys import Stores, get_typestore

from quadftc_replay.dataflash import FORMAT, FORMAT_TYPE, HEAD
from quadftc_replay.writers.dataflash import TYPES as LETTERS

COUNT, PERIOD = 300, 0.04  # samples, s
START = 1_700_000_000.0  # s since 1970, where a format has such a clock
AXES, ROTORS = "xyz", "1234"
Flight = dict[str, NDArray[np.float64]]  # column to (COUNT,)
HOSTILE = (
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 3.4e38, 1e30, 1e18, 1e9, 1e4, -1e4, 5e-324),
    *(0.0, -0.0, 1.0, -1.0, 2.0**31, 2.0**63, -(2.0**63), 255.0, 65535.0, 32768.0, 0.1, 1e-9),
)
JUMPS = (-3600.0, 3600.0, -1e-6, -PERIOD, -2.5, 30.0, 86400.0, 1e9, -1e9, 1e12, float("nan"), float("inf"))
TEXTS = (
    "",
    "nan",
    "1e999",
    "-1",
    "0x7fc00000",
    "0",
    "9" * 400,
    "1,2",
    "2047,158",
    "\x00",
    "é",
    "Rotorflight",
)


def hover() -> Flight:
    """Return a hover of 12 s with noise."""
    noise = np.random.default_rng(1).normal(size=(COUNT, 16))
    time = PERIOD * np.arange(COUNT)
    flight = {"time": time}
    for k, axis in enumerate(AXES):
        flight[f"gyro.{axis}"] = 0.1 * np.cos(time + k) + 0.01 * noise[:, k]
        flight[f"force.{axis}"] = 0.05 * noise[:, 3 + k] + (9.81 if axis == "z" else 0.0)
        flight[f"angle.{axis}"] = 0.1 * np.sin(time + k) + 0.001 * noise[:, 6 + k]
        flight[f"position.{axis}"] = 0.01 * noise[:, 9 + k] + (2.0 if axis == "z" else 0.0)
    for k, rotor in enumerate(ROTORS):
        flight[f"rotor.{rotor}"] = 0.5 + 0.01 * noise[:, 12 + k]
    flight["battery"] = np.full(COUNT, 12.0)
    return flight


class Spoil(NamedTuple):
    """Rows of a column that get a value; of the time, which jumps by it."""

    column: str
    row: int
    length: int
    value: float


def spoils() -> st.SearchStrategy[list[Spoil]]:
    """Draw some fields that are no measurements, and jumps of time."""
    rows = (st.integers(0, COUNT - 1), st.sampled_from((1, 1, 2, 20, COUNT)))
    jump = st.builds(Spoil, st.just("time"), *rows, st.sampled_from(JUMPS))
    columns = st.sampled_from([name for name in hover() if name != "time"])
    field = st.builds(Spoil, columns, *rows, st.sampled_from(HOSTILE) | st.floats())
    return st.lists(field | field | jump, min_size=1, max_size=5)


def spoiled(spoils: Sequence[Spoil]) -> Flight:
    """Return the hover with some fields spoiled."""
    flight = hover()
    for column, row, length, value in spoils:
        part = flight[column][row : row + length]
        part[:] = part + value if column == "time" else value
    return flight


def _whole(values: NDArray[np.float64], kind: str) -> NDArray[Any]:
    """Whole numbers of a type; NaN becomes zero, what is beyond its range the nearest end."""
    ends = np.iinfo(kind)
    with np.errstate(invalid="ignore"):
        inside = np.nan_to_num(np.rint(values), nan=0.0, posinf=np.inf, neginf=-np.inf)
        cast = np.clip(inside, float(ends.min), float(ends.max) * (1.0 - 2.0**-52)).astype(kind)
    return np.where(inside >= float(ends.max), ends.max, cast)


def _rows(kind: Sequence[tuple[Any, ...]], columns: Mapping[str, Any]) -> list[bytes]:
    """Pack columns into rows of a packed type; those not given are zero."""
    table = np.zeros(COUNT, np.dtype(list(kind)))
    for name, values in columns.items():
        field = table.dtype[name]
        is_whole = isinstance(values, np.ndarray) and field.kind in "iu" and values.dtype.kind == "f"
        with np.errstate(over="ignore", invalid="ignore"):
            table[name] = _whole(values, field.str) if is_whole else values
    return [row.tobytes() for row in table]


def _braid(*streams: list[bytes]) -> bytes:
    return b"".join(row for rows in zip(*streams, strict=True) for row in rows)


def _vector(flight: Flight, name: str, factor: float = 1.0, signs: Sequence[float] = (1, 1, 1)) -> Any:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack(
            [sign * factor * flight[f"{name}.{a}"] for a, sign in zip(AXES, signs, strict=True)], 1
        )


def _rotors(flight: Flight) -> Any:
    return np.stack([flight[f"rotor.{number}"] for number in ROTORS], 1)


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
    gyro, force = _vector(flight, "gyro", 1.0, FRD), _vector(flight, "force", 1.0, FRD)
    angles = np.degrees(_vector(flight, "angle"))
    zero = np.zeros(COUNT)
    return {
        "IMU": [zero, *gyro.T, *force.T],
        "ATT": [*angles.T],
        "RCOU": [*(1000.0 + 1000.0 * _rotors(flight)).T],
        "BAT": [zero, flight["battery"]],
    }


def dataflash(flight: Flight, text: str = "hover", names: Mapping[str, str] | None = None) -> bytes:
    """Write an ArduPilot log (``.BIN``); ``text`` is what the autopilot says, ``names`` rename messages."""
    parts, streams, micro = list[bytes](), list[list[bytes]](), 1e6 * (5.0 + flight["time"])
    for name, (kind, letters, fields) in DATAFLASH.items():
        codes = [LETTERS[letter][0] for letter in letters]
        packed = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
        length = 3 + np.dtype([(str(k), code) for k, code in enumerate(packed)]).itemsize
        said = (names or {}).get(name, name).encode()
        parts.append(
            HEAD + bytes([FORMAT_TYPE]) + FORMAT.pack(kind, length, said, letters.encode(), fields.encode())
        )
        layout = [("head", "S2"), ("kind", "u1"), *((str(k), code) for k, code in enumerate(packed))]
        begin = {"head": HEAD, "kind": kind, "0": micro}
        if name == "PARM":
            for parameter, value in PARAMETERS.items():
                parts.append(_rows(layout, {**begin, "1": parameter.encode(), "2": value})[0])
        elif name == "MSG":
            streams.append([b""] * (COUNT - 1) + _rows(layout, {**begin, "1": text.encode()[:64]})[-1:])
        else:
            columns = zip(letters[1:], _dataflash_columns(flight)[name], strict=True)
            scaled = {str(k): v / (LETTERS[a][1] or 1.0) for k, (a, v) in enumerate(columns, 1)}
            streams.append(_rows(layout, {**begin, **scaled}))
    return b"".join(parts) + _braid(*streams)


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


def ulog(flight: Flight, text: str = "hover", names: Mapping[str, str] | None = None) -> bytes:
    """Write a PX4 log; ``text`` is what the autopilot says, ``names`` rename topics."""
    micro = 1e6 * (5.0 + flight["time"])
    half = 0.5 * _vector(flight, "angle", 1.0, FRD)
    columns = {
        "sensor_combined": [_vector(flight, "gyro", 1.0, FRD), _vector(flight, "force", 1.0, FRD)],
        "vehicle_attitude": [np.column_stack([np.ones(COUNT), half])],
        "actuator_motors": [_rotors(flight)],
        "battery_status": [flight["battery"]],
    }
    parts = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", 5_000_000), _message("B", bytes(40))]
    said = {name: (names or {}).get(name, name) for name in ULOG}
    parts += [_message("F", f"{said[name]}:{fields}".encode()) for name, (fields, _) in ULOG.items()]
    parts += [_message("A", struct.pack("<BH", 0, k) + said[name].encode()) for k, name in enumerate(ULOG)]
    streams = list[list[bytes]]()
    for number, (name, (_, codes)) in enumerate(ULOG.items()):
        layout = [
            (str(k), code[-3:], (int(code[0]),) if len(code) > 3 else ())
            for k, code in enumerate(codes.split())
        ]
        fields = {"topic": number, "0": micro, **{str(k): each for k, each in enumerate(columns[name], 1)}}
        streams.append([_message("D", row) for row in _rows([("topic", "<u2"), *layout], fields)])
    last = _message("L", b"6" + struct.pack("<Q", 5_000_000 + int(1e6 * PERIOD * COUNT)) + text.encode())
    return b"".join(parts) + _braid(*streams) + last


def _imu(flight: Flight) -> dict[str, Any]:
    """Fields of `sensor_msgs/Imu` that follow the header."""
    half = 0.5 * _vector(flight, "angle")
    return {
        "q": np.column_stack([half, np.ones(COUNT)]),
        "w": _vector(flight, "gyro"),
        "a": _vector(flight, "force"),
    }


IMU_FIELDS = [
    ("q", "<f8", 4),
    ("qc", "<f8", 9),
    ("w", "<f8", 3),
    ("wc", "<f8", 9),
    ("a", "<f8", 3),
    ("ac", "<f8", 9),
]
STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_JAZZY)}
KINDS = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState")


def _joint_names(version: int) -> bytes:
    end = "\0" if version == 2 else ""
    texts = [f"rotor_{number}{end}".encode() for number in ROTORS]
    return struct.pack("<I", len(texts)) + b"".join(struct.pack("<I", len(text)) + text for text in texts)


def _ros_messages(flight: Flight, version: int) -> dict[str, list[bytes]]:
    """Messages of each topic, in CDR (2) or as ROS 1 has them; the sum of their fields' sizes has no gap."""
    clock = START + flight["time"]
    clock = np.where(np.isfinite(clock), clock, 0.0)
    stamp = {"sec": np.floor(clock), "nsec": 1e9 * (clock - np.floor(clock))}
    if version == 2:
        begin = [("cdr", "<u4"), ("sec", "<i4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S8")]
        stamp |= {"cdr": 0x0100, "length": 5, "frame": b"base"}
        pad = [("pad", "<u4")]  # numbers of 8 bytes begin at multiples of 8
    else:
        begin = [("seq", "<u4"), ("sec", "<u4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S4")]
        stamp |= {"length": 4, "frame": b"base"}
        pad = list[tuple[str, str]]()
    names = _joint_names(version)
    joints = [
        ("names", f"V{len(names)}"),
        ("none", "<u4"),
        ("count", "<u4"),
        ("speed", "<f8", 4),
        ("last", "<u4"),
    ]
    table = {"names": np.void(names), "count": 4, "speed": 1000.0 * _rotors(flight)}
    return {
        "/imu/data": _rows([*begin, *pad, *IMU_FIELDS], {**stamp, **_imu(flight)}),
        "/rotors/speed": _rows([*begin, *joints], {**stamp, **table}),
    }


def mcap(flight: Flight, topics: Mapping[str, str] | None = None) -> bytes:
    """Write a ROS 2 bag; ``topics`` rename topics."""
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    channels = dict[str, int]()
    messages = _ros_messages(flight, 2)
    for topic, kind in zip(messages, KINDS, strict=True):
        text = STORES[2].generate_msgdef(kind, ros_version=2)[0].encode()
        schema = writer.register_schema(kind, "ros2msg", text)
        channels[topic] = writer.register_channel((topics or {}).get(topic, topic), "cdr", schema)
    for k in range(COUNT):
        time = int(1e9 * (START + k * PERIOD))
        for topic, rows in messages.items():
            writer.add_message(channels[topic], time, rows[k], time)
    writer.finish()
    return out.getvalue()


def _record(fields: Mapping[str, bytes], data: bytes) -> bytes:
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def ros1(flight: Flight) -> bytes:
    """Write a ROS 1 bag of one chunk, with the records that a reader of its index asks for."""
    messages, parts, number = _ros_messages(flight, 1), list[bytes](), dict[str, bytes]()
    links = list[bytes]()
    for k, (topic, kind) in enumerate(zip(messages, KINDS, strict=True)):
        number[topic] = struct.pack("<I", k)
        text, digest = STORES[1].generate_msgdef(kind)
        about = {"topic": topic.encode(), "type": kind.replace("/msg", "").encode()}
        about |= {"md5sum": digest.encode(), "message_definition": text.encode()}
        body = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
            for name, value in about.items()
        )
        links.append(_record({"op": b"\x07", "conn": number[topic], "topic": topic.encode()}, body))
    for k in range(COUNT):
        time = struct.pack("<II", int(START + k * PERIOD), int(1e9 * k * PERIOD) % 10**9)
        for topic, rows in messages.items():
            parts.append(_record({"op": b"\x02", "conn": number[topic], "time": time}, rows[k]))
    inner = b"".join([*links, *parts])
    chunk = _record({"op": b"\x05", "compression": b"none", "size": struct.pack("<I", len(inner))}, inner)
    magic = b"#ROSBAG V2.0\n"
    where = {"index_pos": struct.pack("<Q", len(magic) + 4096 + len(chunk))}
    where |= {"conn_count": struct.pack("<I", len(links)), "chunk_count": struct.pack("<I", 1)}
    head = _record({"op": b"\x03", **where}, b"")
    head = _record({"op": b"\x03", **where}, b" " * (4096 - len(head)))
    span = {"ver": struct.pack("<I", 1), "chunk_pos": struct.pack("<Q", len(magic) + 4096)}
    span |= {"start_time": bytes(8), "end_time": bytes(8), "count": struct.pack("<I", 0)}
    return magic + head + chunk + b"".join(links) + _record({"op": b"\x06", **span}, b"")


def crazyflie(flight: Flight) -> bytes:
    """Write a log of a Crazyflie's uSD card, with its check sum."""
    gyro, force = np.degrees(_vector(flight, "gyro")), _vector(flight, "force", 1.0 / 9.81)
    half, rotors = 0.5 * _vector(flight, "angle"), 65535.0 * _rotors(flight)
    columns = {f"gyro.{a}(f)": gyro[:, k] for k, a in enumerate(AXES)}
    columns |= {f"acc.{a}(f)": force[:, k] for k, a in enumerate(AXES)}
    columns |= {f"stateEstimate.q{a}(f)": half[:, k] for k, a in enumerate(AXES)}
    columns |= {"stateEstimate.qw(f)": np.ones(COUNT), "pm.vbat(f)": flight["battery"] / 3.0}
    columns |= {f"motor.m{k}(H)": rotors[:, k - 1] for k in range(1, 5)}
    head = struct.pack("<BHHH", 0xBC, 2, 1, 65535) + b"fixedFrequency\0" + struct.pack("<H", len(columns))
    head += b"".join(f"{name}\0".encode() for name in columns)
    kinds = {"f": "<f4", "H": "<u2"}
    layout = [("id", "<u2"), ("time", "<u8"), *((name, kinds[name[-2]]) for name in columns)]
    data = head + _braid(_rows(layout, {"id": 65535, "time": 1e6 * (5.0 + flight["time"]), **columns}))
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
    table = np.stack([_whole(values, "<i4") for values in columns.values()], 1).astype(np.int64)
    body = [b"I" + b"".join(_unsigned(value << 1 ^ value >> 63) for value in row) for row in table.tolist()]
    head = "".join(f"H {name}:{value}\n" for name, value in lines.items())
    return head.encode("latin-1", "replace") + b"".join(body) + b"E\xffEnd of log\0"


def telemetry(flight: Flight) -> bytes:
    """Write a MAVLink telemetry log."""
    link, parts = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), list[bytes]()
    milli = 1000.0 * (5.0 + flight["time"])
    stamp = _whole(milli, "<u4").tolist()
    received = _whole(1e6 * (START + flight["time"]), "<u8").tolist()
    rate = _whole(1000.0 * _vector(flight, "gyro", 1.0, FRD), "<i2").tolist()
    force = _whole(1000.0 / 9.81 * _vector(flight, "force", 1.0, FRD), "<i2").tolist()
    outputs = _whole(1000.0 + 1000.0 * _rotors(flight), "<u2").tolist()
    angles, volts = _vector(flight, "angle").tolist(), _whole(1000.0 * flight["battery"], "<u2").tolist()

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
    rows = zip(*(values.tolist() for values in flight.values()), strict=True)
    lines = [",".join(flight), *(",".join(map(repr, row)) for row in rows)]
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
