"""Repairing a bag: wherever it was cut or damaged, what is kept is right, and others read all of it."""

from __future__ import annotations

import functools
import io
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from geometry_msgs.msg import Vector3Stamped
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Footer, Header, Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML
from typer.testing import CliRunner

from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.bag_file import BagFile
from quadftc_bags.bag_format import describe_topic, offered_qos
from quadftc_bags.interfaces import load_interface
from quadftc_bags.repair import Repair, repair
from quadftc_bags.storage import read_records
from quadftc_cli.main import app

VECTOR = "geometry_msgs/msg/Vector3Stamped"
TOPICS = ("/plant/rate", "/torque/command", "/fault/estimate")
COUNT = 120
CHUNK = 1500  # bytes: about 30 messages
COMPRESSIONS = ("zstd", "lz4", "none")
PERIOD_NS = 4_000_000


def number_in(data: bytes) -> float:
    return deserialize_message(data, Vector3Stamped).vector.x


def written(directory: Path, compression: str) -> Path:
    """A bag of a few chunks: message k is on topic k % 3, at k periods."""
    bag = BagFile(directory, {"scenario.yaml": b"rate: 250\n"}, {"mode": "realtime"}, compression, CHUNK)
    for topic in TOPICS:
        bag.add_topic(describe_topic(topic, VECTOR, QoSProfile(depth=7)))
    for number in range(COUNT):
        message = Vector3Stamped()
        message.vector.x = float(number)
        time_ns = 1_000_000_000 + number * PERIOD_NS
        bag.write(1 + number % 3, time_ns, time_ns, serialize_message(message))
    bag.close()
    return directory


@pytest.fixture(scope="session")
def originals(tmp_path_factory) -> dict[str, Path]:
    return {kind: written(tmp_path_factory.mktemp(kind) / "run", kind) for kind in COMPRESSIONS}


def bytes_of(bag: Path) -> bytes:
    return (bag / f"{bag.name}_0.mcap").read_bytes()


def chunks_of(bag: Path) -> list[tuple[int, int, int]]:
    """Those of the records that hold messages."""
    return [record for record in records_of(bag) if record[2]]


def records_of(bag: Path) -> list[tuple[int, int, int]]:
    """Start, end and number of messages of each record of the file of a whole bag."""
    path = bag / "run_0.mcap"
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True)
        found, start = [], 8
        for record in reader.records:
            end = stream.tell() if not isinstance(record, Footer) else path.stat().st_size - 8
            inside = 0
            if isinstance(record, Chunk):
                with path.open("rb") as chunk_stream:
                    chunk_stream.seek(start)
                    inside = len(messages_from(chunk_stream.read(end - start)))
            found.append((start, end, inside))
            start = end
    return found


def messages_from(chunk_record: bytes) -> list[Message]:
    """The messages in the bytes of one chunk, read by the mcap library."""
    stream = StreamReader(io.BytesIO(chunk_record), skip_magic=True)
    records: Iterator = stream.records
    found = []
    try:
        found.extend(record for record in records if isinstance(record, Message))
    except Exception:  # there is nothing behind it
        return found
    return found


def damaged(folder: Path, data: bytes, metadata: bytes | None = None) -> Path:
    """A bag directory with a file of some bytes."""
    bag = folder / "run"
    bag.mkdir()
    (bag / "run_0.mcap").write_bytes(data)
    if metadata is not None:
        (bag / "metadata.yaml").write_bytes(metadata)
    return bag


Stored = list[tuple[str, int, float]]  # topic, log time [ns], number of the message


@functools.cache
def read_by_rosbags(name: str, data: bytes, metadata: bytes) -> tuple[Stored, dict[str, int]]:
    """What rosbags reads of a bag, and the messages that it counts; slow, and many repairs give the same."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, name)
        bag.mkdir()
        (bag / f"{name}_0.mcap").write_bytes(data)
        (bag / "metadata.yaml").write_bytes(metadata)
        with AnyReader([bag]) as reader:
            read = [
                (link.topic, time_ns, reader.deserialize(message, link.msgtype).vector.x)
                for link, time_ns, message in reader.messages()
            ]
            assert reader.message_count == len(read)
            return read, {link.topic: link.msgcount for link in reader.connections}


@functools.cache
def numbers_in(name: str, data: bytes, metadata: bytes) -> list[int]:
    """What rosbags and mcap read of a bag, both all of it and the same."""
    read, counts = read_by_rosbags(name, data, metadata)
    index = make_reader(io.BytesIO(data), validate_crcs=True)
    by_mcap = [(link.topic, m.log_time, number_in(m.data)) for _, link, m in index.iter_messages()]
    assert index.get_summary().statistics.message_count == len(by_mcap)
    assert by_mcap == read
    information = YAML(typ="safe").load(metadata)["rosbag2_bagfile_information"]
    told = {
        each["topic_metadata"]["name"]: each["message_count"]
        for each in information["topics_with_message_count"]
    }
    assert told == counts == {**dict.fromkeys(counts, 0), **Counter(topic for topic, _, _ in read)}
    assert information["message_count"] == len(read)
    assert all(
        (topic, time_ns) == (TOPICS[int(x) % 3], 1_000_000_000 + int(x) * PERIOD_NS)
        for topic, time_ns, x in read
    )
    assert information["custom_data"] == {"mode": "realtime"}
    return [int(x) for _, _, x in read]


def numbers_in_whole(bag: Path) -> list[int]:
    return numbers_in(bag.name, bytes_of(bag), (bag / "metadata.yaml").read_bytes())


def repaired(data: bytes) -> tuple[Repair, list[int]] | None:
    """Repair a file of some bytes; None if there is nothing to repair. The original stays as it is."""
    with tempfile.TemporaryDirectory() as folder:
        bag = damaged(Path(folder), data)
        try:
            done = repair(bag)
        except BagError:
            assert sorted(path.name for path in Path(folder).iterdir()) == ["run"]
            return None
        assert bytes_of(bag) == data
        assert done.out == bag.resolve().with_name("run-repaired")
        return done, numbers_in_whole(done.out)


@pytest.fixture(autouse=True)
def no_waiting_for_the_disk(monkeypatch):
    """Hundreds of bags are repaired here; each would wait for the disk."""
    monkeypatch.setattr("os.fsync", lambda _: None)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_bag_cut_in_any_record_keeps_every_chunk_before_the_cut(originals, compression):
    data = bytes_of(originals[compression])
    records, chunks = records_of(originals[compression]), chunks_of(originals[compression])
    assert len(chunks) > 3
    assert sum(row[2] for row in chunks) == COUNT
    rows = records if compression == "zstd" else chunks[:3]
    places = {place for start, end, _ in rows for place in (start, (start + end) // 2)}
    for place in sorted(places | {5, chunks[0][1] - 1, chunks[0][1] + 5, len(data) - 1}):
        kept = sum(inside for _, end, inside in chunks if end <= place)
        done = repaired(data[:place])
        if done is None:
            assert place < chunks[0][1]
        else:
            assert done[1] == list(range(kept)), place
            assert done[0].found.message_count == kept


@settings(max_examples=60)
@given(st.sampled_from(COMPRESSIONS), st.data())
def test_bytes_that_are_wrong_never_give_a_wrong_message(originals, compression, draw):
    data = bytearray(bytes_of(originals[compression]))
    for _ in range(draw.draw(st.integers(1, 3))):
        start = draw.draw(st.integers(0, len(data) - 1))
        length = draw.draw(st.integers(1, 40))
        data[start : start + length] = draw.draw(st.binary(min_size=length, max_size=length))
    with tempfile.TemporaryDirectory() as folder:
        bag = damaged(Path(folder), bytes(data))
        try:
            done = repair(bag, bag.with_name("new"))
        except BagError:
            return
        read, _ = read_by_rosbags("new", bytes_of(done.out), (done.out / "metadata.yaml").read_bytes())
    for topic, time_ns, number in read:
        assert (topic, time_ns) == (TOPICS[int(number) % 3], 1_000_000_000 + int(number) * PERIOD_NS)


@settings(max_examples=30)
@given(st.binary(max_size=400))
@example(b"")
@example(bytes(300))
def test_what_is_no_bag_is_refused_in_one_line(originals, tail):
    for head in (b"", b"\x89MCAP0\r\n", bytes_of(originals["zstd"])[:60]):
        assert repaired(head + tail) is None


def test_chunk_whose_sum_is_wrong_is_left_out_and_the_rest_kept(originals):
    data = bytearray(bytes_of(originals["none"]))
    chunks = chunks_of(originals["none"])
    start, end, inside = chunks[1]
    data[end - 40] ^= 1
    done, numbers = repaired(bytes(data))
    before = chunks[0][2]
    assert numbers == [*range(before), *range(before + inside, COUNT)]
    (damage,) = done.found.damages
    assert (damage.offset, damage.size, damage.is_end) == (start, end - start, False)
    first_ns = 1_000_000_000 + before * PERIOD_NS
    assert damage.span_ns == (first_ns, first_ns + (inside - 1) * PERIOD_NS)


def test_zeros_at_the_end_are_left_out(originals):
    data = bytes_of(originals["zstd"])
    chunks = chunks_of(originals["zstd"])
    done, numbers = repaired(data[: chunks[2][1]] + bytes(100_000))
    assert numbers == list(range(sum(row[2] for row in chunks[:3])))
    assert done.found.damages[-1].is_end


def test_attachments_and_metadata_records_are_kept(originals, tmp_path):
    data = bytes_of(originals["zstd"])
    done = repair(damaged(tmp_path, data[: len(data) // 2]))
    bag = read_bag(done.out)
    assert not bag.truncated
    assert bag.attachments == {"scenario.yaml": b"rate: 250\n"}
    assert bag.metadata["quadftc"] == {"mode": "realtime"}


def test_stale_metadata_are_made_anew_and_a_whole_bag_is_left_alone(originals, tmp_path):
    bag = tmp_path / "run"
    shutil.copytree(originals["zstd"], bag)
    assert repair(bag).out is None
    text = (bag / "metadata.yaml").read_text()
    for wrong in (
        text.replace(f"message_count: {COUNT}", "message_count: 90"),
        text.replace("run_0.mcap", "old_0.mcap"),
        text.replace("message_count: 40", "message_count: 39", 1),
        "{",
    ):
        (bag / "metadata.yaml").write_text(wrong)
        done = repair(bag, force=True)
        assert done.complaint.startswith("metadata.yaml ")
        assert done.out == bag.resolve()
        assert numbers_in_whole(bag) == list(range(COUNT))
        assert repair(bag).out is None


def test_bag_is_replaced_only_by_force(originals, tmp_path):
    data = bytes_of(originals["zstd"])
    bag = damaged(tmp_path, data[:-2000])
    (bag / "run_0.mcap").rename(bag / "other.mcap")
    (bag / "scenario.yaml").write_text("rate: 250\n")
    out = repair(bag).out
    with pytest.raises(BagError, match="exists; choose another --out, or --force"):
        repair(bag)
    with pytest.raises(BagError, match="is no bag of one file; not replaced"):
        repair(bag, tmp_path, force=True)
    with pytest.raises(BagError, match="give its directory"):
        repair(bag / "other.mcap", force=True)
    assert (bag / "other.mcap").read_bytes() == data[:-2000]
    assert repair(bag, out, force=True).out == out
    assert repair(bag, force=True).out == bag
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "run_0.mcap", "scenario.yaml"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run-repaired"]
    assert numbers_in_whole(bag) == numbers_in_whole(out)


def test_bag_that_is_being_recorded_is_copied_but_not_replaced(tmp_path):
    bag = tmp_path / "bag"
    recorder = BagFile(bag, {}, {}, "zstd", CHUNK)
    recorder.add_topic(describe_topic(TOPICS[0], VECTOR, QoSProfile(depth=7)))
    try:
        recorder.write(1, 1, 1, serialize_message(Vector3Stamped()))
        recorder.flush()
        for changes in ({"force": True}, {"out": bag, "force": True}):
            with pytest.raises(BagError, match="still being recorded"):
                repair(bag, **changes)
        result = CliRunner().invoke(app, ["repair", str(bag)])
        assert result.exit_code == 0
        assert "still being recorded" in result.output
        recorder.write(1, 2, 2, serialize_message(Vector3Stamped()))
    finally:
        recorder.close()
    for path, messages in ((tmp_path / "bag-repaired", 1), (bag, 2)):
        done = repair(path)  # nobody writes to it now, and nothing is wrong
        assert (done.out, done.recorded, done.found.message_count) == (None, False, messages)


def test_full_disk_while_repairing_is_one_line_and_leaves_nothing(originals, tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    bag = damaged(tmp_path, bytes_of(originals["zstd"])[:-2000])
    monkeypatch.setattr(BagFile, "write", full)
    with pytest.raises(BagError, match=r"run-repaired: No space left on device$"):
        repair(bag)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_quality_of_service_of_older_versions_is_put_into_words(originals, tmp_path):
    qos = offered_qos(QoSProfile(depth=7))
    old = qos.replace("keep_last", "1").replace("reliable", "1").replace("volatile", "2")
    old = old.replace("automatic", "1")
    path = tmp_path / "old.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema(VECTOR, "ros2msg", load_interface(VECTOR).text.encode())
        for topic, profile in zip(TOPICS, (old, "", qos), strict=True):
            metadata = {"offered_qos_profiles": profile} if profile else {}
            channel = writer.register_channel(topic, "cdr", schema, metadata)
            writer.add_message(channel, 5, serialize_message(Vector3Stamped()), 5)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-20])
    out = repair(path).out
    assert out == (tmp_path / "old-repaired").resolve()
    assert [topic.qos for topic in read_bag(out).topics.values()] == [qos, "", qos]
    with AnyReader([out]) as reader:
        assert len(list(reader.messages())) == 3


def write_foreign(path: Path, encoding: str, schema: bool) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        number = writer.register_schema("x", "jsonschema", b"{}") if schema else 0
        writer.add_message(writer.register_channel("/a", encoding, number), 1, b"1234", 1)
        writer.finish()
    return path


def test_bad_input_is_one_line_and_exit_code_2(originals, tmp_path):
    data = bytes_of(originals["zstd"])
    for name in ("none", "two"):
        (tmp_path / name).mkdir()
    for name in ("two/a.mcap", "two/b.mcap"):
        (tmp_path / name).write_bytes(data)
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "zeros.mcap").write_bytes(bytes(5000))
    (tmp_path / "head.mcap").write_bytes(data[:300])
    write_foreign(tmp_path / "schemaless.mcap", "cdr", schema=False)
    write_foreign(tmp_path / "json.mcap", "json", schema=True)
    for name, text in {
        "nowhere": "no such bag",
        "none": "no .mcap file in this directory; nothing to repair",
        "two": "2 .mcap files (a.mcap, b.mcap); repair one at a time, by its path",
        "empty.mcap": "empty file",
        "zeros.mcap": "not an MCAP file",
        "head.mcap": "nothing to repair: it ends or breaks at byte",
        "schemaless.mcap": "nothing to repair: topic '/a': the definition of its type is missing",
        "json.mcap": "nothing to repair: topic '/a': its messages are 'json', not cdr",
    }.items():
        result = CliRunner().invoke(app, ["repair", str(tmp_path / name)])
        assert isinstance(result.exception, BagError), name  # which the command makes exit code 2
        assert str(result.exception).startswith(f"{tmp_path / name}: {text}")
        assert "\n" not in str(result.exception)


def test_command_says_what_was_kept_and_lost(originals, tmp_path):
    data = bytes_of(originals["none"])
    chunks = chunks_of(originals["none"])
    start, end, _ = chunks[1]
    bag = damaged(tmp_path, data[: end - 10])
    result = CliRunner().invoke(app, ["repair", str(bag)])
    kept = chunks[0][2]
    assert result.exit_code == 0, result.output
    last_ns = 1_000_000_000 + (kept - 1) * PERIOD_NS
    lines = result.output.splitlines()
    assert f"kept: {kept} messages on 3 topics, {(kept - 1) * 0.004:.3f} s, last stamp {last_ns} ns" in lines
    assert any(
        line.startswith(f"lost: {end - 10 - start} bytes, cut off at the end, at byte {start}: a chunk of")
        for line in lines
    )
    assert "rebuilt: metadata.yaml (metadata.yaml is missing)" in lines
    assert lines[-1] == f"repaired bag: {bag}-repaired"
    again = CliRunner().invoke(app, ["repair", f"{bag}-repaired"])
    assert again.output.splitlines()[-1].endswith("nothing to repair")


def test_reading_goes_on_behind_a_damaged_chunk_only_if_asked(originals, tmp_path):
    data = bytearray(bytes_of(originals["none"]))
    chunks = chunks_of(originals["none"])
    data[chunks[1][1] - 40] ^= 1
    (tmp_path / "run.mcap").write_bytes(data)
    assert read_bag(tmp_path / "run.mcap").truncated
    kinds = [type(record) for record in read_records(tmp_path / "run.mcap")]
    assert kinds[0] is Header
    assert kinds.count(tuple) == COUNT - chunks[1][2]
