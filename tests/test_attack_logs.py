"""Logs of every format with wrong fields or bytes: refused in a line, or judged in finite numbers."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from attack.flight_table import TEXTS, hover, spoiled, spoils
from attack.inputs import bad_bytes
from attack.logs import MAPPING, WRITERS, blackbox
from quadftc_bags import storage
from quadftc_bags.bag import BagError
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.readers import LogChoice, read_log

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers that overflow on the way
EXAMPLES = settings().max_examples // 4  # 10; with --examples 4000 a thousand
HEADER = (
    *("gyro_scale", "acc_1G", "motorOutput", "vbatref", "motor_poles", "Firmware revision", "Data version"),
    *("minthrottle", "Field I name", "Field I predictor", "Field P encoding", "Field S encoding"),
)
BOMB = 32 << 20  # bytes
# formats read here: damage may make a library loop, and of a table it is the mapping's fault
OWN_READERS = [name for name in WRITERS if name not in ("PX4 ULog", "CSV")]
MARKED = ("ROS 2 bag (MCAP)", "ROS 1 bag", "Crazyflie uSD", "blackbox")  # formats that mark their end


def choice_for(name: str, folder: Path) -> LogChoice:
    if name != "CSV":
        return LogChoice()
    mapping = folder / "mapping.toml"
    mapping.write_text(MAPPING)
    return LogChoice(mapping=mapping)


def signals_of(log: FlightLog):
    for value in vars(log).values():
        if isinstance(value, Signal):
            yield value
        elif isinstance(value, dict):
            yield from value.values()


def judge(path: Path, choice: LogChoice) -> None:
    """Hold a log to what every reader and every verdict promise."""
    refusal = ""
    try:
        log = read_log(path, choice)
    except BagError as error:
        refusal = str(error)
    if refusal:
        assert str(path) in refusal
        assert "\n" not in refusal
        return
    for signal in signals_of(log):
        assert np.isfinite(signal.time).all()
        assert (np.diff(signal.time) > 0.0).all()
        assert not np.isinf(signal.value).any()
    verdict = inspect(log).verdict
    json.loads(verdict.model_dump_json(), parse_constant=pytest.fail)  # NaN and Infinity are no JSON
    json.dumps(verdict.model_dump(mode="json"), allow_nan=False)


@pytest.mark.parametrize("name", WRITERS)
def test_fields_that_no_sensor_gives_are_refused_or_judged(name, tmp_path):
    path, choice = tmp_path / "log", choice_for(name, tmp_path)

    @settings(max_examples=EXAMPLES)
    @given(spoils())
    def survives(spoils):
        path.write_bytes(WRITERS[name](spoiled(spoils)))
        judge(path, choice)

    survives()


@pytest.mark.parametrize("name", OWN_READERS)
def test_damaged_bytes_are_refused_or_judged(name, tmp_path):
    path, whole = tmp_path / "log", WRITERS[name](hover())

    @settings(max_examples=EXAMPLES)
    @given(st.composite(lambda draw: bad_bytes(draw, whole))())
    def survives(data):
        path.write_bytes(data)
        judge(path, LogChoice())

    survives()


@pytest.mark.parametrize("name", MARKED)
def test_log_without_the_end_of_its_format_is_not_whole(name, tmp_path):
    path, whole = tmp_path / "log", WRITERS[name](hover())
    for missing in (0, 1, 8, 20):
        path.write_bytes(whole[: len(whole) - missing])
        assert bool(read_log(path).incomplete) == (missing > 0), missing


def test_bag_without_its_index_is_not_whole(tmp_path):
    path, whole = tmp_path / "log", WRITERS["ROS 1 bag"](hover())
    index = struct.unpack_from("<Q", whole, whole.index(b"index_pos=") + 10)[0]
    path.write_bytes(whole[:index])
    assert read_log(path).incomplete


def test_header_of_a_blackbox_may_hold_anything(tmp_path):
    path, texts = tmp_path / "log", st.sampled_from(TEXTS) | st.text(max_size=20)

    @settings(max_examples=EXAMPLES)
    @given(st.dictionaries(st.sampled_from(HEADER), texts, max_size=3))
    def survives(lines):
        header = {name: " ".join(text.split("\n")) for name, text in lines.items()}
        path.write_bytes(blackbox(hover(), header))
        judge(path, LogChoice())

    survives()


def packed_chunk(how: str, unpacked: int, stated: int) -> bytes:
    """Return a bag with one chunk of zeros."""
    if how == "zstd":
        packer = zstandard.ZstdCompressor().compressobj(size=unpacked)
        data = packer.compress(bytes(unpacked)) + packer.flush()
    else:
        data = lz4.frame.compress(bytes(unpacked))
    head = struct.pack("<QQQI", 1, 2, stated, 0) + struct.pack("<I", len(how)) + how.encode()
    body = head + struct.pack("<Q", len(data)) + data
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize("stated", [1000, BOMB, 2**64 - 1])
@pytest.mark.parametrize("how", ["zstd", "lz4"])
def test_chunk_that_unpacks_to_more_than_it_may_is_damage(how, stated, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_LARGEST", 1 << 20)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(packed_chunk(how, BOMB, stated))
    tracemalloc.start()
    try:
        (damage, *_) = storage.read_records(path)
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert isinstance(damage, storage.Damage)
    assert most < BOMB


def test_many_chunks_are_no_way_around_the_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_LARGEST", 1 << 20)
    path, chunk = tmp_path / "bomb.mcap", packed_chunk("zstd", 1 << 20, 1 << 20)
    path.write_bytes(chunk + 60 * chunk[8:])
    with pytest.raises(BagError, match="more than 100 bytes unpacked for each byte of the file"):
        list(storage.read_records(path))


NESTED = "float64 x\n" + "=" * 80 + "\nMSG: sensor_msgs/"
SCHEMAS = {
    "itself": b"sensor_msgs/Imu again\n",
    "each other": f"sensor_msgs/B b\n{NESTED[10:]}B\nsensor_msgs/Imu a\n".encode(),
    "3000 deep": "".join(f"sensor_msgs/T{k + 1} a\n{NESTED[10:]}T{k + 1}\n" for k in range(3000)).encode(),
    "1000 to the tenth": "".join(
        f"sensor_msgs/T{k + 1}[1000] a\n{NESTED[10:]}T{k + 1}\n" for k in range(10)
    ).encode()
    + b"float64 x\n",
    "4e9 numbers": b"float64[4000000000] x\n",
    "no fields": b"sensor_msgs/E[] x\n" + f"{NESTED[10:]}E\n".encode(),
}


@pytest.mark.parametrize("name", SCHEMAS)
def test_type_that_holds_itself_or_too_much_is_refused_in_a_line(name, tmp_path):
    out, path = io.BytesIO(), tmp_path / "log.mcap"
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", SCHEMAS[name])
    channel = writer.register_channel("/imu/data", "cdr", schema)
    for k in range(50):
        writer.add_message(channel, k, b"\0\1\0\0" + b"\xff" * 320, k)
    writer.finish()
    path.write_bytes(out.getvalue())
    with pytest.raises(BagError, match="log without a usable signal"):
        read_log(path)
