"""Logs of ArduPilot: the format byte by byte, checked against pymavlink; units, axes, motors, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary

from quadftc_bags.bag import BagError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay import thinning
from quadftc_replay.dataflash import CHUNK, read_dataflash
from quadftc_replay.readers import read_log
from quadftc_replay.readers.ardupilot_tables import group_reports

FORMATS = {  # as ArduPilot 4.5 has them
    "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
    "IMU": (129, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "ATT": (130, "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF"),
    "RCOU": (131, "QHHHHHHHHHHHHHH", "TimeUS," + ",".join(f"C{k}" for k in range(1, 15))),
    "ESC": (132, "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err"),
    "XKF1": (133, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "RATE": (134, "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut"),
    "OTHR": (135, "QZ", "TimeUS,Text"),
}
CODES = {"c": "h", "C": "H", "e": "i", "N": "16s", "Z": "64s"}
PACKING = {name: "<" + "".join(CODES.get(c, c) for c in types) for name, (_, types, _) in FORMATS.items()}
COUNT = 200
START_US = 5_000_000


def message(kind: int, body: bytes) -> bytes:
    return b"\xa3\x95" + bytes([kind]) + body


def packed(name: str, *values) -> bytes:
    return message(FORMATS[name][0], struct.pack(PACKING[name], *values))


def log_bytes(parameters: dict[str, float], count: int = COUNT) -> bytes:
    parts = []
    for name, (kind, types, fields) in FORMATS.items():
        texts = (name.encode(), types.encode(), fields.encode())
        parts.append(
            message(128, struct.pack("<BB4s16s64s", kind, 3 + struct.calcsize(PACKING[name]), *texts))
        )
    parts += [packed("PARM", START_US, name.encode(), value, 0.0) for name, value in parameters.items()]
    for k in range(count):
        t = START_US + k * 2500
        for instance in (0, 1):
            rate, force = (0.1 + 0.01 * k, 0.2, 0.3 + instance), (0.5, 0.6, -9.81)
            parts.append(packed("IMU", t, instance, *rate, *force, 0, 0, 40.0, 1, 1, 1000, 1000))
        parts.append(packed("ATT", t, 0, 1000, 0, 500, 0, 9000, 0, 0, 3))
        parts.append(packed("RCOU", t, 1100, 1900, 1500, 1300, *[0] * 10))
        parts += [packed("ESC", t + 10 * i, i, 6000.0 + i, *[0.0] * 3, 0, 0.0, 0, 0.0) for i in range(4)]
        parts.append(packed("XKF1", t, 0, 0, 0, 0, 1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 6.0, 0, 0, 0, 0))
        parts.append(packed("RATE", t, 0, 0, 0.1, 0, 0, 0.2, 0, 0, 0.3, 0, 0, 0.4))
        parts.append(packed("OTHR", t, b"nothing of interest"))
    return b"".join(parts)


PARAMETERS = {
    "FRAME_CLASS": 1.0,
    "FRAME_TYPE": 1.0,
    "MOT_PWM_MIN": 1100.0,
    "MOT_PWM_MAX": 1900.0,
    "MOT_SPIN_MIN": 0.0,
    "MOT_SPIN_MAX": 1.0,
    "MOT_THST_EXPO": 0.5,
    # motor 1 on output 4, 2 on 3, ...
    **{f"SERVO{k + 1}_FUNCTION": 36.0 - k for k in range(4)},
}


@pytest.fixture
def path(tmp_path) -> Path:
    file = tmp_path / "flight"
    file.write_bytes(log_bytes(PARAMETERS))
    return file


def test_bytes_are_read_as_pymavlink_reads_them(path):
    log = read_dataflash(path, {name: FORMATS[name][2].split(",") for name in ("IMU", "ATT", "XKF1")})
    theirs = DFReader_binary(str(path))
    for name in ("IMU", "ATT", "XKF1"):
        for row in range(3):
            message = theirs.recv_match(type=name)
            for field, column in log.messages[name].items():
                assert column[row] == pytest.approx(getattr(message, field)), (name, field)
        theirs.rewind()
    assert log.parameters["MOT_THST_EXPO"] == theirs.params["MOT_THST_EXPO"] == 0.5
    assert log.notes == ()
    theirs.close()


def test_units_axes_and_motors_are_those_of_the_interface(path):
    log = read_log(path)
    assert (log.format, log.notes) == ("ArduPilot BIN", ())
    assert set(log.gyros) == set(log.accelerometers) == {"", "1"}
    np.testing.assert_allclose(log.gyros[""].value[10], [0.2, -0.2, -0.3], rtol=1e-6)
    np.testing.assert_allclose(log.gyros["1"].value[10], [0.2, -0.2, -1.3], rtol=1e-6)
    np.testing.assert_allclose(log.accelerometers[""].value[0], [0.5, -0.6, 9.81], rtol=1e-6)
    np.testing.assert_allclose(log.gyros[""].time, 0.0025 * np.arange(COUNT), atol=1e-9)
    assert log.attitude is not None  # roll 10, pitch 5 deg up, heading east
    angles = euler_from_quaternion(log.attitude.value[0])
    np.testing.assert_allclose(np.degrees(angles), [10.0, -5.0, 0.0], atol=1e-9)
    assert log.position is not None
    assert log.velocity is not None
    np.testing.assert_allclose(log.position.value[0], [5.0, 4.0, -6.0])
    np.testing.assert_allclose(log.velocity.value[0], [2.0, 1.0, -3.0])
    throttle = np.array([0.25, 0.5, 1.0, 0.0])  # of motors 1 to 4
    assert log.rotor_commands is not None
    np.testing.assert_allclose(log.rotor_commands.value[0], 0.5 * throttle + 0.5 * throttle**2)
    assert log.rotor_speeds is not None
    assert len(log.rotor_speeds) == COUNT
    np.testing.assert_allclose(log.rotor_speeds.value[0] * 60.0 / (2.0 * np.pi), [6003, 6002, 6001, 6000])
    assert log.torque_command is not None
    assert log.torque_unit == "1"
    np.testing.assert_allclose(log.torque_command.value[0], [0.1, -0.2, -0.3], rtol=1e-6)
    assert log.rotor_positions is not None
    assert log.rotor_yaw_signs is not None
    assert np.sign(log.rotor_positions).tolist() == [[1, -1], [-1, 1], [1, 1], [-1, -1]]
    assert log.rotor_yaw_signs.tolist() == [-1.0, -1.0, 1.0, 1.0]


def test_long_log_is_thinned_out_sensor_by_sensor(path, monkeypatch):
    whole = read_log(path).gyros
    monkeypatch.setattr(thinning, "MOST", 64)
    few = read_log(path)
    for name in ("", "1"):
        np.testing.assert_array_equal(few.gyros[name].value, whole[name].value[::4])
    assert "IMU 1: long; of 200 samples one in 4 was read" in few.notes


def test_reports_of_escs_at_other_times_are_other_samples():
    stamps = np.array([0, 1, 2, 3, 20, 21, 40, 60]) * 1_000_000
    motor = np.array([0, 1, 2, 3, 0, 2, 1, 1])
    assert group_reports(stamps, motor).tolist() == [0, 0, 0, 0, 1, 1, 2, 3]


def test_damaged_message_costs_few_others(tmp_path, path):
    whole = path.read_bytes()
    data = bytearray(whole)
    begin = data.find(message(129, b""), len(data) // 2)
    data[begin + 2] ^= 0x40  # a type that does not exist
    path.write_bytes(data)
    log = read_log(path)
    assert len(log.gyros[""]) == COUNT - 1
    assert "bytes at 1 places are no messages" in log.notes[0]
    path.write_bytes(whole[:-400])
    cut = read_log(path)
    assert len(cut.gyros[""]) >= COUNT - 2


def test_log_without_a_layout_or_a_signal_says_so(tmp_path):
    path = tmp_path / "log"
    path.write_bytes(log_bytes({}))
    log = read_log(path)
    assert log.rotor_positions is None
    assert "no FRAME_CLASS and FRAME_TYPE" in log.notes[-1]
    path.write_bytes(log_bytes(PARAMETERS, count=0))
    with pytest.raises(BagError, match="without a usable signal; expected a gyro"):
        read_log(path)
    path.write_bytes(b"\xa3\x95" + bytes(500))
    with pytest.raises(BagError, match="no format of a message"):
        read_log(path)


def test_log_that_is_cut_is_read_up_to_the_cut(path):
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2 + 3])
    log = read_log(path)
    assert log.notes == ("cut short: the log ends within a message",)
    assert 0.4 * COUNT < len(log.gyros[""]) < 0.6 * COUNT


def test_log_that_is_cut_within_the_head_of_a_message_is_not_whole(path):
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.index(b"\xa3\x95", len(whole) // 2) + 2])
    assert read_log(path).incomplete == "cut short: the log ends within a message"


@pytest.mark.parametrize(
    ("events", "incomplete"),
    [
        ([10, 15], "cut short: the log ends within a message, with the vehicle armed"),
        ([10, 15, 11], ""),
        ([], ""),  # boards leave the last chunk out
    ],
)
def test_log_that_ends_with_a_chunk_is_cut_if_the_vehicle_is_still_armed(path, events, incomplete):
    form = message(128, struct.pack("<BB4s16s64s", 140, 12, b"EV", b"QB", b"TimeUS,Id"))
    said = b"".join(message(140, struct.pack("<QB", START_US, number)) for number in events)
    data = form + said + path.read_bytes()
    size = next(
        size for size in range(len(data) // 2 // CHUNK * CHUNK, 0, -CHUNK) if ends_within(data[:size])
    )
    path.write_bytes(data[:size])
    assert read_log(path).incomplete == incomplete


def ends_within(data: bytes) -> bool:
    """Whether the last head of a message is followed by less than the shortest of them."""
    return 0 < len(data) - data.rindex(b"\xa3\x95") < 12
