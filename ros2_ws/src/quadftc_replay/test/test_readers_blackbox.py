"""Blackbox logs: every encoding and prediction written by hand, several logs in a file, damage."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from quadftc_bags.bag import BagError
from quadftc_model.rotations import euler_from_quaternion
from quadftc_replay import blackbox, thinning
from quadftc_replay.blackbox import read_blackbox
from quadftc_replay.readers import LogChoice, read_log
from quadftc_replay.readers.layouts import FRAMES, frame_layout, mixer_layout
from recorded_logs import DATA, needs_data

START = "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
HEADER = """H Firmware revision:Betaflight 4.5.1 (abc) STM32F7X2
H gyro_scale:0x3f800000
H acc_1G:2048
H motorOutput:158,2047
H vbatref:2466
H minthrottle:1070
H motor_poles:14
"""
FIELDS = {  # name -> I predictor, I encoding, P predictor, P encoding
    "loopIteration": (0, 1, 6, 9),
    "time": (0, 1, 2, 0),
    "axisP[0]": (0, 0, 1, 7),
    "axisP[1]": (0, 0, 1, 7),
    "axisP[2]": (0, 0, 1, 7),
    "rcCommand[0]": (0, 0, 1, 8),
    "rcCommand[1]": (0, 0, 1, 8),
    "rcCommand[2]": (0, 0, 1, 8),
    "rcCommand[3]": (0, 1, 1, 8),
    "vbatLatest": (9, 3, 1, 6),
    "gyroADC[0]": (0, 0, 3, 6),
    "gyroADC[1]": (0, 0, 3, 6),
    "gyroADC[2]": (0, 0, 3, 6),
    "accSmooth[0]": (0, 10, 1, 10),
    "accSmooth[1]": (0, 10, 1, 10),
    "accSmooth[2]": (0, 10, 1, 10),
    "motor[0]": (11, 1, 3, 0),
    "motor[1]": (5, 0, 3, 0),
    "motor[2]": (5, 0, 3, 0),
    "motor[3]": (5, 0, 3, 0),
    "eRPM[0]": (0, 1, 1, 0),
    "eRPM[1]": (0, 1, 1, 0),
    "eRPM[2]": (0, 1, 1, 0),
    "eRPM[3]": (0, 1, 1, 0),
    "imuQuaternion[0]": (0, 0, 1, 0),
    "imuQuaternion[1]": (0, 0, 1, 0),
    "imuQuaternion[2]": (0, 0, 1, 0),
}
CONSTANTS = {0: 0, 4: 1070, 8: 1500, 9: 2466, 11: 158}
COUNT, PERIOD_US, WHOLE = 600, 500, 32


def uvb(value: int) -> bytes:
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def svb(value: int) -> bytes:
    return uvb(value << 1 ^ value >> 31)


def three_wide(values: list[int]) -> bytes:
    """The fourth choice of both encodings of three fields: 1 to 4 bytes each."""
    widths = [next(n for n in (1, 2, 3, 4) if -(1 << 8 * n - 1) <= v < 1 << 8 * n - 1) for v in values]
    lead = 0xC0 | sum(width - 1 << 2 * k for k, width in enumerate(widths))
    parts = [(v & (1 << 8 * n) - 1).to_bytes(n, "little") for v, n in zip(values, widths, strict=True)]
    return bytes([lead]) + b"".join(parts)


def fits(values: list[int], bits: list[int]) -> bool:
    return all(-(1 << n - 1) <= value < 1 << n - 1 for value, n in zip(values, bits, strict=True))


def packed(selector: int, values: list[int], bits: list[int]) -> bytes:
    """Two bits that select, then the values."""
    word = selector
    for value, n in zip(values, bits, strict=True):
        word = word << n | value & (1 << n) - 1
    return word.to_bytes((2 + sum(bits) + 7) // 8, "big")


def tag2_3s32(values: list[int]) -> bytes:
    if fits(values, [2] * 3):
        return packed(0, values, [2] * 3)
    if fits(values, [4] * 3):
        first, *others = (value & 0xF for value in values)
        return bytes([0x40 | first, others[0] << 4 | others[1]])
    if fits(values, [6] * 3):
        first, *others = (value & 0x3F for value in values)
        return bytes([0x80 | first, *others])
    return three_wide(values)


def tag2_3svariable(values: list[int]) -> bytes:
    for selector, bits in enumerate(([2, 2, 2], [5, 5, 4], [8, 7, 7])):
        if fits(values, bits):
            return packed(selector, values, bits)
    return three_wide(values)


def tag8_4s16(values: list[int]) -> bytes:
    tag, nibbles = 0, list[int]()
    for k, value in enumerate(values):
        choice = (
            0 if value == 0 else next(n for n, bits in ((1, 4), (2, 8), (3, 16)) if fits([value], [bits]))
        )
        tag |= choice << 2 * k
        count = (0, 1, 2, 4)[choice]
        nibbles += [value >> 4 * n & 0xF for n in reversed(range(count))]
    nibbles += [0] * (len(nibbles) % 2)
    pairs = zip(nibbles[::2], nibbles[1::2], strict=True)
    return bytes([tag, *(high << 4 | low for high, low in pairs)])


def tag8_8svb(values: list[int]) -> bytes:
    if len(values) == 1:
        return svb(values[0])
    tag = sum(1 << k for k, value in enumerate(values) if value)
    return bytes([tag]) + b"".join(svb(value) for value in values if value)


SINGLE = {0: svb, 1: uvb, 3: lambda value: uvb(-value & 0x3FFF), 9: lambda _value: b""}
GROUPS = {6: (8, tag8_8svb), 7: (3, tag2_3s32), 8: (4, tag8_4s16), 10: (3, tag2_3svariable)}


def encode(values: list[int], encodings: list[int]) -> bytes:
    out, at = b"", 0
    while at < len(values):
        most, write = GROUPS.get(encodings[at], (1, None))
        count = 1
        while count < most and encodings[at + count : at + count + 1] == [encodings[at]]:
            count += 1
        group = values[at : at + count]
        out += write(group) if write else SINGLE[encodings[at]](group[0])
        at += count
    return out


def predict(predictor: int, before: list[list[int]], k: int, row: list[int]) -> int:
    if predictor in CONSTANTS:
        return CONSTANTS[predictor]
    if predictor == 5:
        return row[list(FIELDS).index("motor[0]")]
    one, two = before[-1][k], before[-2][k]
    return {1: one, 2: 2 * one - two, 3: int((one + two) / 2), 6: one + 1}[predictor]


def header(more: str = HEADER) -> bytes:
    names, rows = ",".join(FIELDS), list(zip(*FIELDS.values(), strict=True))
    lines = [f"H Field I name:{names}"]
    for what, row in zip(("I predictor", "I encoding", "P predictor", "P encoding"), rows, strict=True):
        lines.append(f"H Field {what}:{','.join(map(str, row))}")
    lines += [
        "H Field S name:flightModeFlags,stateFlags",
        "H Field S predictor:0,0",
        "H Field S encoding:1,1",
    ]
    return (START + more + "\n".join(lines) + "\n").encode()


def signals(count: int = COUNT, start_us: int = 5_000_000, seed: int = 1) -> dict[str, list[int]]:
    """Values that use every choice of the encodings."""
    rng, columns = np.random.default_rng(seed), dict[str, list[int]]()
    for name in FIELDS:
        size = 10.0 ** rng.uniform(0.0, 3.5, count)
        columns[name] = np.rint(rng.normal(size=count) * size).astype(int).tolist()
    columns["loopIteration"] = list(range(count))
    columns["time"] = [start_us + k * PERIOD_US + int(rng.integers(3)) for k in range(count)]
    columns["vbatLatest"] = (2466 - np.arange(count) // 10).tolist()
    columns["gyroADC[0]"] = np.rint(100 * np.sin(np.arange(count) / 40)).astype(int).tolist()
    for k in range(4):
        columns[f"motor[{k}]"] = (500 + 100 * k + np.arange(count) % 7).tolist()
        columns[f"eRPM[{k}]"] = [70 + k] * count
    for k, value in enumerate((0.0, 0.0, np.sin(np.radians(15.0)))):
        columns[f"imuQuaternion[{k}]"] = [round(value * 32767)] * count
    columns["rcCommand[3]"] = [1500] * count
    return columns


def frames(columns: dict[str, list[int]], every: int = WHOLE) -> list[bytes]:
    found, before = list[bytes](), list[list[int]]()
    for number, row in enumerate(map(list, zip(*columns.values(), strict=True))):
        is_whole = number % every == 0
        before = [row, row] if is_whole else before
        which = 0 if is_whole else 2
        predictors, encodings = ([field[which + part] for field in FIELDS.values()] for part in (0, 1))
        rest = [value - predict(predictors[k], before, k, row) for k, value in enumerate(row)]
        found.append((b"I" if is_whole else b"P") + encode(rest, encodings))
        before = [before[-1], row]
    return found


SLOW, EVENT = b"S" + uvb(3) + uvb(1), b"E\x1e" + uvb(1) + uvb(300)
ADJUSTED = b"E\x0d\x83" + struct.pack("<f", 1.5)
END = b"E\xffEnd of log\0"


def log_bytes(columns: dict[str, list[int]] | None = None, more: str = HEADER) -> bytes:
    body = frames(columns or signals())
    body[100:100] = [SLOW, EVENT]
    body[200:200] = [ADJUSTED, SLOW]
    return header(more) + b"".join(body) + END


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "LOG00001.BFL"
    file.write_bytes(log_bytes())
    return file


def test_every_field_comes_back_as_it_was_written(path):
    log, columns = read_blackbox(path, 0, [""]), signals()
    assert log.notes == ()
    assert log.columns.keys() == columns.keys() - {"loopIteration"}
    for name, values in log.columns.items():
        np.testing.assert_array_equal(values, columns[name], name)


def test_blocks_make_no_difference(path, monkeypatch):
    whole = read_blackbox(path, 0, [""])
    monkeypatch.setattr(blackbox, "BLOCK", 3000)
    parts = read_blackbox(path, 0, [""])
    assert parts.notes == ()
    for name, values in whole.columns.items():
        np.testing.assert_array_equal(parts.columns[name], values, name)


def test_long_log_is_thinned(path, monkeypatch):
    whole = read_blackbox(path, 0, [""]).columns["time"]
    monkeypatch.setattr(blackbox, "BLOCK", 3000)
    monkeypatch.setattr(thinning, "MOST", 200)
    log = read_blackbox(path, 0, [""])
    np.testing.assert_array_equal(log.columns["time"], whole[::4])
    assert log.notes == ("frames: long; of 600 samples one in 4 was read",)


def test_units_axes_and_motors_are_those_of_the_interface(path):
    log = read_log(path)
    assert log.format == "Betaflight blackbox"
    columns = signals()
    np.testing.assert_allclose(log.gyros[""].value[:, 0], np.radians(columns["gyroADC[0]"]))
    np.testing.assert_allclose(
        log.accelerometers[""].value[:, 2], np.array(columns["accSmooth[2]"]) * 9.80665 / 2048
    )
    assert log.attitude is not None  # heading of the firmware: 30 deg to the left of north
    np.testing.assert_allclose(
        np.degrees(euler_from_quaternion(log.attitude.value[0])), [0.0, 0.0, 120.0], atol=0.01
    )
    assert log.rotor_commands is not None
    np.testing.assert_allclose(log.rotor_commands.value[0], (np.arange(500, 900, 100) - 158) / (2047 - 158))
    assert log.rotor_speeds is not None
    np.testing.assert_allclose(log.rotor_speeds.value[0], np.arange(70, 74) * 100 / 7 * np.pi / 30)
    assert log.battery is not None
    assert log.battery.value[0, 0] == pytest.approx(24.66)
    assert log.rotor_positions is not None  # motor 1 is the rear right one
    assert log.rotor_positions[0, 0] < 0.0
    assert log.rotor_positions[0, 1] < 0.0


def test_attitude_and_navigation_of_inav(tmp_path, monkeypatch):
    names = {"imuQuaternion": "attitude", "eRPM": "navPos"}
    renamed = {
        next((name.replace(old, new) for old, new in names.items() if name.startswith(old)), name): row
        for name, row in FIELDS.items()
    }
    monkeypatch.setitem(globals(), "FIELDS", renamed)
    columns = dict(zip(renamed, signals_of_inav(), strict=True))
    path = tmp_path / "log.bbl"
    path.write_bytes(log_bytes(columns, HEADER.replace("Betaflight 4.5.1", "INAV 7.1.0")))
    log = read_log(path)
    assert log.format == "INAV blackbox"
    assert log.attitude is not None
    np.testing.assert_allclose(
        np.degrees(euler_from_quaternion(log.attitude.value[0])), [10.0, 5.0, 0.0], atol=1e-9
    )
    assert log.position is not None
    np.testing.assert_allclose(log.position.value[0], [2.0, 1.0, 3.0])


def signals_of_inav() -> list[list[int]]:
    columns = {name: [1] * COUNT for name in FIELDS}
    columns["loopIteration"] = list(range(COUNT))
    columns["time"] = [k * PERIOD_US for k in range(COUNT)]
    columns |= {f"attitude[{k}]": [value] * COUNT for k, value in enumerate((100, 50, 900))}
    columns |= {f"navPos[{k}]": [value] * COUNT for k, value in enumerate((100, 200, 300))}
    return list(columns.values())


def test_several_logs_in_a_file_are_asked_for(tmp_path):
    path = tmp_path / "flash.bbl"
    path.write_bytes(b"\xff" * 5 + log_bytes() + log_bytes(signals(seed=2)) + b"\xff" * 300)
    with pytest.raises(BagError, match=r"flash.bbl: 2 logs in the file; choose one with --log: 1 \(0.0"):
        read_log(path)
    with pytest.raises(BagError, match="no log 3; 2 logs in the file"):
        read_log(path, LogChoice(log=3))
    log = read_log(path, LogChoice(log=2))
    assert log.notes[0] == "log 2 of 2 in the file"
    np.testing.assert_allclose(log.gyros[""].value[:, 1], np.radians(signals(seed=2)["gyroADC[1]"]))


def test_only_log_has_no_second(path):
    with pytest.raises(BagError, match="no log 2; the file has one"):
        read_log(path, LogChoice(log=2))


def test_log_that_is_cut_is_read_up_to_the_cut(path):
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    log = read_log(path)
    assert "cut short: the log has no end mark" in log.notes
    assert 100 < len(log.gyros[""]) < 500


def test_damage_costs_the_frames_up_to_the_next_whole_one(path):
    body = frames(signals())
    body[70] = b"\xf7" * 20  # frame 64 is whole, 96 the next; frame 69 has no frame behind it
    path.write_bytes(header() + b"".join(body) + END)
    log = read_blackbox(path, 0, [""])
    columns, rows = signals(), [*range(69), *range(96, COUNT)]
    np.testing.assert_array_equal(log.columns["time"], np.array(columns["time"])[rows])
    np.testing.assert_array_equal(log.columns["motor[3]"], np.array(columns["motor[3]"])[rows])
    assert log.notes == (
        f"{20 + len(body[69])} bytes are no frames; left out",
        "25 frames whose predecessors are damaged or missing left out",
    )


def test_any_damage_is_read_or_refused_in_one_line(path):
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for trial in range(60):
        data = bytearray(whole)
        begin = len(header()) if trial % 2 else 70
        for place in rng.integers(begin, len(data), 1 + trial).tolist():
            data[place] = int(rng.integers(256))
        path.write_bytes(data)
        problem = ""
        try:
            log = read_log(path)
            assert all(np.all(np.diff(each.time) > 0.0) for each in log.gyros.values())
        except BagError as error:
            problem = str(error)
        assert "\n" not in problem


def test_clock_that_wraps_goes_on(tmp_path):
    path = tmp_path / "log.bbl"
    path.write_bytes(log_bytes(signals(start_us=2**32 - 100_000)))
    log = read_log(path)
    assert len(log.gyros[""]) == COUNT
    assert log.end == pytest.approx(COUNT * PERIOD_US * 1e-6, abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Data version:2", "Data version:1", "log 1: data version 1; expected 2"),
        ("Field P encoding:9", "Field P encoding:77", "not known in, Field P name, encoding, predictor"),
        (
            "name:loopIteration,time",
            "name:loopIteration,tame",
            "no field 'time'; fields: loopIteration, tame",
        ),
    ],
)
def test_header_that_makes_no_sense_is_named(path, old, new, problem):
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    with pytest.raises(BagError) as caught:
        read_log(path)
    assert problem in str(caught.value)


@needs_data
def test_real_logs_turn_as_their_rotor_does():
    # strongest vibration of the roll gyro of helicopters in flight: once per turn of the main rotor
    for truth in json.loads((DATA / "blackbox/ground-truth.json").read_text()):
        path = DATA / "blackbox" / truth["file"]
        if not path.exists():
            continue
        gyro = read_log(path).gyros[""]
        assert gyro.rate == pytest.approx(truth["sampleRateHz"], rel=0.01)
        value = gyro.value[:, 0][gyro.time > 0.5 * gyro.time[-1]]
        power = np.abs(np.fft.rfft(np.diff(value) * np.hanning(len(value) - 1)))
        frequency = np.fft.rfftfreq(len(value) - 1, 1.0 / gyro.rate)
        near = (frequency > 20.0) & (frequency < 60.0)
        peak = frequency[near][np.argmax(power[near])]
        assert peak == pytest.approx(truth["expectedMainRotorPeakHz"], abs=1.0)


def test_mixer_tells_where_the_rotors_are():
    rng = np.random.default_rng(8)
    torques = 0.05 * rng.normal(size=(2000, 3))
    for rotors, frame in FRAMES:
        layout = frame_layout(rotors, frame)
        assert layout is not None
        x, y = layout.positions.T
        mixer = np.stack([y, -x, layout.yaw_signs])
        commands = np.clip(rng.uniform(0.3, 0.5, (2000, 1)) + torques @ mixer, 0.0, 1.0)
        found = mixer_layout(commands + 0.002 * rng.normal(size=commands.shape), torques)
        assert found is not None
        np.testing.assert_array_equal(found.yaw_signs, layout.yaw_signs)
        np.testing.assert_allclose(found.positions, layout.positions, atol=0.02)
    assert mixer_layout(rng.uniform(0.3, 0.5, (2000, 4)), torques) is None
    assert mixer_layout(np.zeros((2000, 4)), torques) is None
