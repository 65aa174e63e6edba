"""Logs of ArduPilot as text: as ground stations write them, and as mavlogdump prints them."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary

from quadftc_replay import thinning
from quadftc_replay.readers import read_log
from quadftc_replay.readers.contents import is_dataflash_text
from recorded_logs import DATA, needs_data

COUNT = 200
FORMATS = {  # name: number, types, fields
    "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
    "MSG": (65, "QZ", "TimeUS,Message"),
    "IMU": (129, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (130, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "ESC": (132, "QBf", "TimeUS,Instance,RPM"),
    "RCOU": (133, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "OTHR": (135, "QZ", "TimeUS,Text"),
}


def rows() -> list[tuple[str, ...]]:
    parts: list[tuple[str, ...]] = [
        ("PARM", "5000000", name, value, "0")
        for name, value in (("FRAME_CLASS", "1"), ("FRAME_TYPE", "1.0"), ("MOT_SPIN_MIN", "0.1"))
    ]
    for k in range(COUNT):
        t = 5_000_000 + 2500 * k
        parts += [
            ("IMU", f"{t}", f"{i}", f"{0.01 * k}", "0.2", f"{i}", "0.5", "0.6", "-9.81") for i in (0, 1)
        ]
        parts.append(("ATT", f"{t}", "10.0", "5.0", "90.0"))
        parts += [("ESC", f"{t + 10 * i}", f"{i}", f"{6000 + i}") for i in range(4)]
        parts.append(("RCOU", f"{t}", "1100", "1900", "1500", "1300"))
        parts.append(("OTHR", f"{t}", "nothing, of interest"))
    parts.append(("MSG", f"{t}", "Potential Thrust Loss (1), landing"))
    return parts


def written(head: str = "ArduCopter V4.5.1 (abc)\nFree RAM: 1000\n") -> str:
    formats = [f"FMT, {n}, 99, {name}, {types}, {fields}" for name, (n, types, fields) in FORMATS.items()]
    return head + "\n".join([*formats, *(", ".join(row) for row in rows())]) + "\n"


def printed() -> str:
    lines = []
    for name, *values in rows():
        pairs = zip(FORMATS[name][2].split(","), values, strict=True)
        fields = ", ".join(f"{field} : {value}" for field, value in pairs)
        lines.append(f"2026-01-01 10:00:00.00: {name} {{{fields}}}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("write", [written, printed])
def test_units_axes_and_motors_are_those_of_the_interface(tmp_path, write):
    path = tmp_path / "flight.log"
    path.write_text(write())
    log = read_log(path)
    assert (log.format, log.notes) == ("ArduPilot log", ())
    assert set(log.gyros) == set(log.accelerometers) == {"", "1"}
    np.testing.assert_allclose(log.gyros[""].value[10], [0.1, -0.2, 0.0])
    np.testing.assert_allclose(log.gyros["1"].value[10], [0.1, -0.2, -1.0])
    np.testing.assert_allclose(log.gyros[""].time, 0.0025 * np.arange(COUNT), atol=1e-9)
    assert log.rotor_speeds is not None
    assert log.rotor_speeds.value.shape == (COUNT, 4)
    np.testing.assert_allclose(log.rotor_speeds.value[3], np.arange(6000, 6004) * np.pi / 30.0)
    assert log.rotor_positions is not None
    assert [event.text for event in log.events] == ["Potential Thrust Loss (1), landing"]


def test_log_that_is_cut_is_read_up_to_the_cut(tmp_path):
    path, text = tmp_path / "flight.log", written()
    path.write_text(text[: text.index("ATT, 5250000") + 15])
    log = read_log(path)
    assert len(log.gyros[""]) == 101
    assert "cut short: the last line is not whole" in log.notes


def test_damaged_lines_are_left_out(tmp_path):
    path, rng = tmp_path / "flight.log", np.random.default_rng(3)
    data = bytearray(written().encode())
    for place in rng.integers(600, len(data), 100).tolist():
        data[place] = int(rng.integers(256))
    path.write_bytes(data)
    log = read_log(path)
    assert any("lines make no sense; left out" in note for note in log.notes)
    assert 0.8 * COUNT < len(log.gyros[""]) <= COUNT


@pytest.mark.parametrize(("line", "harmed"), [("IMU, ", "IMU, x"), ("ATT, ", "ATT, x")])
def test_message_with_no_good_line_is_left_out(tmp_path, line, harmed):
    path = tmp_path / "flight.log"
    path.write_text(written().replace(line, harmed))
    log = read_log(path)
    assert (len(log.gyros) == 0, log.attitude is None) == (line == "IMU, ", line == "ATT, ")


def test_long_log_is_thinned(tmp_path, monkeypatch):
    path = tmp_path / "flight.log"
    path.write_text(written())
    monkeypatch.setattr(thinning, "MOST", 100)
    log = read_log(path)
    np.testing.assert_allclose(np.diff(log.gyros[""].time), 0.01, atol=1e-9)
    assert "IMU 0: long; of 200 samples one in 4 was read" in log.notes


def test_other_text_is_none(tmp_path):
    for text in ("time, FMT, 3\n", "2026-01-01 10:00:00: hello {there}\n", "FMT\n"):
        assert not is_dataflash_text(text.encode())


@needs_data
@pytest.mark.parametrize("by", ["hand", "mavlogdump"])
def test_real_log_as_text_is_the_log_itself(tmp_path, by):
    path, text = DATA / "ardupilot/sitl/d_windy_fast.BIN", tmp_path / "flight.log"
    if by == "mavlogdump":
        tool = Path(sysconfig.get_path("scripts"), "mavlogdump.py")
        with text.open("wb") as target:
            subprocess.run([sys.executable, tool, path], stdout=target, check=True)
    else:
        reader = DFReader_binary(str(path))
        with text.open("w") as target:
            while message := reader.recv_msg():
                values = [str(getattr(message, name)).rstrip("\0") for name in message.fmt.columns]
                target.write(f"{', '.join([message.fmt.name, *values])}\n")
        reader.close()
    ours, whole = read_log(text), read_log(path)
    assert ours.events == whole.events
    for field in ("gyros", "accelerometers"):
        for name, signal in getattr(whole, field).items():
            np.testing.assert_array_equal(getattr(ours, field)[name].value, signal.value)
            np.testing.assert_array_equal(getattr(ours, field)[name].time, signal.time)
    for field in ("attitude", "position", "rotor_commands", "torque_command", "battery", "rotor_positions"):
        np.testing.assert_allclose(
            np.asarray(getattr(getattr(ours, field), "value", getattr(ours, field))),
            np.asarray(getattr(getattr(whole, field), "value", getattr(whole, field))),
            atol=1e-12,
        )
