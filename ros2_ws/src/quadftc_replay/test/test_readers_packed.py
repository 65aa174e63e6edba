"""What a file is called that is no log, logs that are packed, and the limits of a reader."""

from __future__ import annotations

import gzip
import io
import os
import struct
import subprocess
import sys
import time
import zipfile

import numpy as np
import psutil
import pytest
import zstandard

from quadftc_bags.bag import BagError
from quadftc_replay.readers import LogChoice, Reader, bounded, find_reader, read_log
from quadftc_replay.readers.bounded import read_bounded

ROWS = "".join(f"{0.01 * k:.3f},{k % 7},{k % 5},{k % 3},9.8\n" for k in range(400))
TABLE = f"t,gx,gy,gz,az\n{ROWS}"
MAPPING = """
[time]
column = "t"
[[signal]]
quantity = "gyro"
columns = ["gx", "gy", "gz"]
unit = "deg/s"
"""


@pytest.fixture
def mapping(tmp_path):
    path = tmp_path / "mapping.toml"
    path.write_text(MAPPING)
    return LogChoice(mapping=path)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"", "an empty file"),
        (b"\xff\xd8\xff\xe0\0\x10JFIF", "a JPEG picture"),
        (b"GIF89a", "a GIF picture"),
        (b"\x7fELF\x02", "a program or a library (ELF)"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "a MATLAB file"),
        (bytes(300), "a file of zeros"),
        (bytes(range(1, 200)), "a file that begins with 01 02 03 04 05 06 07 08"),
        (b"name".ljust(257, b"\0") + b"ustar", "a tar archive, which has to be unpacked"),
        (b"hello\nworld\n", "a text file"),
        ((b"\xfe\x09" + bytes(15)) * 3, "MAVLink without times of receipt; a .tlog has them"),
        (TABLE.encode(), "a text file, perhaps a table, whose columns --mapping FILE explains"),
    ],
)
def test_what_is_no_log_is_named(tmp_path, content, name):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(BagError) as caught:
        find_reader(path)
    assert str(caught.value).startswith(f"{path}: {name}; expected a log of one of the formats ROS 2 bag")


def test_option_that_a_format_does_not_take_is_refused(tmp_path, mapping):
    path = tmp_path / "flight.csv"
    path.write_text(TABLE)
    with pytest.raises(BagError, match=r"--system 1: .*flight.csv is a CSV log, which takes no --system"):
        find_reader(path, mapping._replace(system=1))


def test_packed_log_is_the_log_that_was_packed(tmp_path, mapping):
    plain, packed = tmp_path / "flight.csv", tmp_path / "packed"
    plain.write_text(TABLE)
    expected = read_log(plain, mapping)
    halves = [gzip.compress(part.encode()) for part in (TABLE[:2000], TABLE[2000:])]
    for data in (b"".join(halves), zstandard.compress(TABLE.encode()), in_archive(TABLE.encode())):
        packed.write_bytes(data)
        log = read_log(packed, mapping)
        assert log.path == packed
        np.testing.assert_array_equal(log.gyros[""].value, expected.gyros[""].value)


def in_archive(data: bytes) -> bytes:
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("picture.jpg", b"\xff\xd8\xff\xe0")
        archive.writestr("flight.csv", data)
    return target.getvalue()


def test_packed_log_that_is_cut_is_read_up_to_the_cut(tmp_path, mapping):
    noise = np.random.default_rng(1).normal(size=(20_000, 3))
    rows = "".join(f"{0.01 * k:.2f},{x:.6f},{y:.6f},{z:.6f}\n" for k, (x, y, z) in enumerate(noise))
    path = tmp_path / "packed"
    for pack in (gzip.compress, zstandard.compress, in_archive):
        whole = pack(f"t,gx,gy,gz\n{rows}".encode())
        path.write_bytes(whole[: len(whole) // 2])
        log = read_log(path, mapping)
        assert log.notes[0].startswith("cut or damaged where it is packed: ")
        assert 2000 < len(log.gyros[""]) < 15_000, pack


def test_archive_of_several_logs_asks_which(tmp_path, mapping):
    path = tmp_path / "logs.zip"
    with zipfile.ZipFile(path, "w") as target:
        for number in (1, 2):
            target.writestr(
                f"{number}.csv", TABLE.replace(",9.8", f",{number}").replace(",0,", f",{number}00,")
            )
    with pytest.raises(BagError, match=r"2 logs in the archive; choose one with --log: 1 1.csv, 2 2.csv"):
        read_log(path, mapping)
    with pytest.raises(BagError, match=r"log 3 of 2 in the archive"):
        read_log(path, mapping._replace(log=3))
    log = read_log(path, mapping._replace(log=2))
    assert log.gyros[""].value.max() == pytest.approx(np.radians(200.0))
    assert log.notes == ("2.csv in the archive",)


def test_archive_without_a_log_says_what_it_holds(tmp_path):
    path = tmp_path / "logs.zip"
    with zipfile.ZipFile(path, "w") as target:
        target.writestr("notes.txt", "nothing")
    with pytest.raises(BagError, match=r"a ZIP archive without a log that can be read; it holds notes.txt"):
        read_log(path)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(BagError, match=r"the list of files at the end of the archive is missing, and no log"):
        read_log(path)


def test_archive_with_other_compression_is_refused(tmp_path, mapping):
    path = tmp_path / "logs.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as target:
        target.writestr("flight.csv", TABLE)
    with pytest.raises(BagError, match=r"a ZIP archive without a log that can be read; it holds flight.csv"):
        read_log(path, mapping)


def test_bomb_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("quadftc_replay.readers.unpacking.FREE", 1 << 20)
    path = tmp_path / "bomb.gz"
    path.write_bytes(gzip.compress(bytes(50 << 20)))
    with pytest.raises(BagError, match=r"more than \d+ MiB unpacked; expected a log"):
        read_log(path)


READS = {
    "loops": "while True: pass",
    "fills": "x = bytes(1 << 33)",
    "crashes": "os.kill(os.getpid(), signal.SIGSEGV)",
    "fails": "raise KeyError(mapping.suffix)",
}
SAID = {
    "loops": "was stopped: more than 1 s of processor time for 0.00",
    "fills": "was stopped: more than 2048 MiB of memory for 0.00",
    "crashes": "crashed (SIGSEGV)",
    "fails": "failed: KeyError: '.toml'",
}


@pytest.mark.parametrize("what", READS)
def test_reader_that_misbehaves_is_stopped_and_named(tmp_path, monkeypatch, mapping, what):
    # a module that takes the place of a reader in the process
    (tmp_path / "broken.py").write_text(f"import os, signal\ndef read(path, mapping):\n    {READS[what]}\n")
    (tmp_path / "sitecustomize.py").write_text(
        "import sys, broken\nsys.modules['quadftc_replay.readers.table'] = broken\n"
    )
    monkeypatch.setitem(bounded.SETTINGS, "PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    monkeypatch.setattr(bounded, "processor_time", lambda _reader, _size: 1)
    path = tmp_path / "flight.csv"
    path.write_text(TABLE)
    with pytest.raises(BagError) as caught:
        read_bounded(path, mapping)
    assert f"{path}: the reader of a CSV log {SAID[what]}" in str(caught.value)


def looping_log(path):
    # a ULog with many formats, and then a message whose length leads back to the first of them
    def message(kind: bytes, body: bytes, length: int | None = None) -> bytes:
        return struct.pack("<H", len(body) if length is None else length) + kind + body

    text = b"char[4] a"
    data = b"ULog\x01\x12\x35\x01" + bytes(8)
    while len(data) < 12_100:
        data += message(b"I", bytes([len(text)]) + text + b"abcd")
    path.write_bytes(data + message(b"\x01", b"xx", len(data) - 13))
    return path


def test_log_that_makes_the_library_loop_is_refused(tmp_path, monkeypatch):
    path = looping_log(tmp_path / "log.ulg")
    monkeypatch.setattr(bounded, "processor_time", lambda _reader, _size: 1)
    with pytest.raises(BagError) as caught:
        read_bounded(path)
    assert str(caught.value) == (
        f"{path}: the reader of a PX4 ULog log was stopped: more than 1 s of processor time for 0.0121 MB"
    )


def test_reader_ends_with_whom_it_reads_for(tmp_path):
    path = looping_log(tmp_path / "log.ulg")
    run = (
        "import sys, pathlib, quadftc_replay.readers.bounded as b; b.read_bounded(pathlib.Path(sys.argv[1]))"
    )
    asking = subprocess.Popen([sys.executable, "-c", run, path])
    children: list[psutil.Process] = []
    deadline = time.monotonic() + 30.0
    while not children and time.monotonic() < deadline:
        time.sleep(0.1)
        children = psutil.Process(asking.pid).children()
    time.sleep(0.5)  # until it has begun
    asking.kill()
    asking.wait(10.0)
    _, alive = psutil.wait_procs(children, 10.0)
    assert children
    assert alive == []


def test_bounded_reader_gives_the_same_log_and_the_same_error(tmp_path, mapping):
    path = tmp_path / "flight.csv"
    path.write_text(TABLE)
    np.testing.assert_array_equal(
        read_bounded(path, mapping).gyros[""].value, read_log(path, mapping).gyros[""].value
    )
    path.write_text(TABLE.replace("gx", "wx"))
    for read in (read_log, read_bounded):
        with pytest.raises(BagError, match=r"mapping.toml: signal 1 \(gyro\): no column 'gx' in flight.csv"):
            read(path, mapping)


def test_cost_bounds_the_time_in_proportion_to_the_file():
    reader = Reader("any", bool, "table", 0.5)
    times = [bounded.processor_time(reader, size) for size in (0, 10_000_000, 20_000_000)]
    assert times[1] - times[0] == times[2] - times[1] == 50
