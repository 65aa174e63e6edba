"""The bag writers, by thread and by process: what readers find, and what is left when things go wrong."""

import json
import os
import random
import re
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from geometry_msgs.msg import Vector3Stamped
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

from quadftc_bags import writer_process
from quadftc_bags.bag_file import BagFile
from quadftc_bags.cdr.layout import PaddingCleaner
from quadftc_bags.interfaces import load_interface, load_message_class
from quadftc_bags.writer import FLUSH_PERIOD, BagWriter
from quadftc_bags.writer_process import BATCH, BagProcess
from quadftc_ros.topics import TOPICS

PERIOD_NS = 4_000_000
VECTOR = "geometry_msgs/msg/Vector3Stamped"
Writer = BagWriter | BagProcess


def vector(number: int) -> bytes:
    message = Vector3Stamped()
    message.header.frame_id = "base_link"
    message.vector.x = float(number)
    return serialize_message(message)


@pytest.fixture(params=[BagWriter, BagProcess])
def kind(request) -> type[Writer]:
    return request.param


def opened(kind: type[Writer], path: Path | str, **options) -> Writer:
    """A writer of a bag with one topic."""
    writer = kind(path, **options)
    writer.add_topic("/plant/rate", VECTOR, QoSProfile(depth=1))
    return writer


def write_numbers(writer: Writer, count: int, topic: str = "/plant/rate") -> None:
    for number in range(count):
        time_ns = 1_000_000_000 + number * PERIOD_NS
        writer.write(topic, vector(number), time_ns, time_ns)


def stored_messages(path: Path) -> list[Message]:
    """The messages in a file, by streaming to wherever it ends."""
    messages: list[Message] = []
    with path.open("rb") as stream, suppress(EndOfFile, struct.error):
        messages.extend(record for record in StreamReader(stream).records if isinstance(record, Message))
    return messages


def stored_numbers(path: Path) -> list[float]:
    return [deserialize_message(message.data, Vector3Stamped).vector.x for message in stored_messages(path)]


def test_rosbags_reads_every_topic_of_the_graph(tmp_path, kind):
    with kind(tmp_path / "run") as writer:
        for topic in TOPICS.values():
            # rosbags refuses the bytes that Fast DDS may leave behind a message's end
            message = serialize_message(load_message_class(topic.type_name)())
            data = PaddingCleaner(topic.type_name).clean(message)
            writer.add_topic(f"/{topic.name.strip('/')}", topic.type_name, qos_profile_sensor_data)
            for number in range(3):
                assert writer.write(f"/{topic.name.strip('/')}", data, number, number)

    with AnyReader([tmp_path / "run"]) as reader:  # refuses a type hash that does not fit the definition
        decoded = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages()]
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert len(decoded) == 3 * len(TOPICS)
    assert counts == {f"/{name.strip('/')}": 3 for name in TOPICS}


def test_mcap_reader_finds_what_rosbag2_writes(tmp_path, kind):
    with kind(tmp_path / "run", {"scenario.yaml": b"rate: 250\n"}, {"note": 'a "b"\n\\ é 😀'}) as writer:
        writer.add_topic("/plant/rate", VECTOR, qos_profile_sensor_data)
        write_numbers(writer, 10)

    information = YAML(typ="safe").load(tmp_path / "run" / "metadata.yaml")["rosbag2_bagfile_information"]
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        (channel,) = summary.channels.values()
        (schema,) = summary.schemas.values()
        (attachment,) = reader.iter_attachments()
        records = [item.metadata for item in reader.iter_metadata() if item.name == "rosbag2"]
        times = [(message.log_time, message.publish_time) for _, _, message in reader.iter_messages()]
        assert reader.get_header().profile == "ros2"
    assert times == [(1_000_000_000 + k * PERIOD_NS,) * 2 for k in range(10)]
    assert (schema.name, schema.encoding, channel.message_encoding) == (VECTOR, "ros2msg", "cdr")
    assert channel.metadata["topic_type_hash"] == load_interface(VECTOR).type_hash
    assert (attachment.name, attachment.media_type, attachment.data) == (
        "scenario.yaml",
        "application/yaml",
        b"rate: 250\n",
    )
    (topic,) = information["topics_with_message_count"]
    qos = YAML(typ="safe").load(channel.metadata["offered_qos_profiles"])
    assert topic["topic_metadata"]["offered_qos_profiles"] == qos
    assert (qos[0]["history"], qos[0]["depth"], qos[0]["reliability"]) == ("keep_last", 5, "best_effort")
    assert qos[0]["deadline"] == {"sec": 9223372036, "nsec": 854775807}
    assert (information["version"], information["message_count"], topic["message_count"]) == (9, 10, 10)
    assert information["starting_time"] == {"nanoseconds_since_epoch": 1_000_000_000}
    assert information["duration"] == {"nanoseconds": 9 * PERIOD_NS}
    assert information["custom_data"] == {"note": 'a "b"\n\\ é 😀'}
    assert [YAML(typ="safe").load(r["serialized_metadata"])["message_count"] for r in records] == [0, 10]
    assert YAML(typ="safe").load(records[1]["serialized_metadata"]) == information


def test_schema_text_holds_each_dependency_once_depth_first(tmp_path):
    text = load_interface("sensor_msgs/msg/Imu").text
    parts = re.findall(r"\n={80}\nMSG: (\S+)\n", text)
    assert parts == [
        "geometry_msgs/Quaternion",
        "geometry_msgs/Vector3",
        "std_msgs/Header",
        "builtin_interfaces/Time",
    ]
    assert re.findall(r"MSG: (\S+)", load_interface("diagnostic_msgs/msg/DiagnosticArray").text) == [
        "diagnostic_msgs/DiagnosticStatus",
        "diagnostic_msgs/KeyValue",
        "std_msgs/Header",
        "builtin_interfaces/Time",
    ]


@pytest.mark.parametrize("name", ["Imu", "sensor_msgs/Imu", "no_such_msgs/msg/Imu", "sensor_msgs/msg/NoSuch"])
def test_unknown_type_is_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        load_interface(name)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_compression_is_read_back(tmp_path, kind, compression):
    with opened(kind, tmp_path / "run", compression=compression) as writer:
        write_numbers(writer, 5000)
    assert stored_numbers(writer.path) == list(range(5000))


def test_bag_without_messages_is_read(tmp_path, kind):
    opened(kind, tmp_path / "run").close()
    with AnyReader([tmp_path / "run"]) as reader:
        assert [(connection.topic, connection.msgcount) for connection in reader.connections] == [
            ("/plant/rate", 0)
        ]


def test_existing_directory_is_refused(tmp_path, kind):
    with pytest.raises(FileExistsError, match=f"{tmp_path} exists already"):
        kind(tmp_path)


def test_bad_arguments_are_refused_before_anything_is_made(tmp_path, kind):
    with pytest.raises(ValueError, match="compression 'zip': expected one of zstd, lz4, none"):
        kind(tmp_path / "run", compression="zip")
    with pytest.raises(ValueError, match="queue_size: 0"):
        BagProcess(tmp_path / "run", queue_size=0)
    assert not (tmp_path / "run").exists()


def test_topic_twice_or_unknown_is_refused(tmp_path, kind):
    with opened(kind, tmp_path / "run") as writer:
        with pytest.raises(ValueError, match="in the bag already"):
            writer.add_topic("/plant/rate", VECTOR, QoSProfile(depth=1))
        with pytest.raises(KeyError):
            writer.write("/plant/attitude", b"", 0, 0)


@pytest.mark.parametrize("lockstep", [False, True])
def test_flushed_messages_are_in_the_file_while_recording(tmp_path, kind, lockstep):
    with opened(kind, tmp_path / "run", lockstep=lockstep) as writer:
        write_numbers(writer, 100)
        assert writer.flush()
        assert stored_numbers(writer.path) == list(range(100))
        information = YAML(typ="safe").load(tmp_path / "run" / "metadata.yaml")
    assert information["rosbag2_bagfile_information"]["message_count"] == 100
    assert not writer.flush()


CHILD = """
import sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
from test_bag_writer import opened, vector
from quadftc_bags.writer import BagWriter
writer = opened(BagWriter, sys.argv[1], lockstep=sys.argv[2] == "True")
while True:
    now = time.time_ns()
    writer.write("/plant/rate", vector(0), now, now)
    sys.stdout.write(f"{{now}}\\n")
    sys.stdout.flush()
    time.sleep(0.001)
"""


FULL_DISK = """
import json, resource, sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
from test_bag_writer import opened, vector
from quadftc_bags.{module} import {kind}
errors = []
resource.setrlimit(resource.RLIMIT_FSIZE, (700_000, 700_000))
said = {{"on_error": errors.append}} if {kind}.__name__ == "BagProcess" else {{}}
writer = opened({kind}, sys.argv[1], compression="none", lockstep=sys.argv[2] == "True", **said)
for number in range(12000):
    time_ns = 1_000_000_000 + number * 4_000_000
    writer.write("/plant/rate", vector(number), time_ns, time_ns)
    if number % 3000 == 0:
        time.sleep(0.1)
status = writer.close()
print(json.dumps([errors, status.counts, dict(status.dropped), status.lost, status.error]))
"""


@pytest.mark.parametrize("lockstep", [False, True])
def test_file_that_cannot_grow_stops_the_recording_not_the_caller(tmp_path, kind, lockstep):
    module = kind.__module__.rpartition(".")[2]
    code = FULL_DISK.format(here=str(Path(__file__).parent), module=module, kind=kind.__name__)
    arguments = [sys.executable, "-c", code, str(tmp_path / "run"), str(lockstep)]
    result = subprocess.run(arguments, check=True, capture_output=True, text=True, timeout=60)
    errors, counts, dropped, lost, error = json.loads(result.stdout)
    numbers = stored_numbers(tmp_path / "run" / "run_0.mcap")
    assert errors == ([error] if kind is BagProcess else [])
    assert "File too large" in error
    assert numbers == list(range(len(numbers)))
    assert counts == {"/plant/rate": len(numbers)}
    assert 1000 < len(numbers) < 10000
    assert lost == 12000 - len(numbers)
    assert dropped == {}
    assert result.stderr == ""
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["metadata.yaml", "run_0.mcap"]


def test_lockstep_file_does_not_depend_on_order_of_arrival_or_padding(tmp_path, kind):
    generator = random.Random(1)
    events = [(1_000_000_000 + k * PERIOD_NS, topic, k) for k in range(1000) for topic in ("/a", "/b", "/c")]
    files = []
    for run in ("first/run", "second/run"):
        # Each topic in its order, topics late by up to 0.1 s against each other.
        arrivals = []
        for topic in ("/a", "/b", "/c"):
            late = generator.randrange(100_000_000)
            arrivals += [(event[0] + late, event) for event in events if event[1] == topic]
        with kind(tmp_path / run, lockstep=True) as writer:
            for topic in ("/a", "/b", "/c"):
                writer.add_topic(topic, VECTOR, QoSProfile(depth=1))
            for number, (_, (time_ns, topic, k)) in enumerate(sorted(arrivals)):
                data = vector(k)
                soiled = data[:26] + generator.randbytes(2) + data[28:]  # padding behind "base_link"
                assert deserialize_message(soiled, Vector3Stamped).vector.x == k
                writer.write(topic, soiled, time_ns, time_ns)
                if number % 300 == 0:
                    time.sleep(generator.random() * 0.02)
        files.append([path.read_bytes() for path in sorted((tmp_path / run).iterdir())])
    assert len(files[0]) == 2
    assert files[0] == files[1]


def test_full_queue_makes_the_caller_wait_in_lockstep(tmp_path):
    with opened(BagProcess, tmp_path / "run", lockstep=True, queue_size=4) as writer:
        write_numbers(writer, 2000)
    assert writer.status.dropped == {}
    assert stored_numbers(writer.path) == list(range(2000))


def test_closed_writer_counts_what_it_refuses(tmp_path, kind):
    writer = opened(kind, tmp_path / "run")
    assert writer.close() == writer.close()
    assert not writer.write("/plant/rate", vector(0), 0, 0)
    assert writer.status.dropped == {"/plant/rate": 1}


def test_process_that_ends_stops_the_recording_not_the_caller(tmp_path):
    errors: list[str] = []
    writer = opened(BagProcess, tmp_path / "run", on_error=errors.append)
    write_numbers(writer, 300)
    assert writer.flush()
    os.kill(writer.process_id, signal.SIGKILL)
    write_numbers(writer, 2000)
    status = writer.close()
    assert errors == [status.error]
    assert status.error == f"{writer.path}: the process that writes it has ended"
    assert stored_numbers(writer.path) == list(range(300))
    assert status.lost + sum(status.counts.values()) + sum(status.dropped.values()) == 2300
    assert not writer.flush()


def test_process_closes_the_bag_when_the_one_that_flies_is_killed(tmp_path):
    code = CHILD.format(here=str(Path(__file__).parent)).replace("time.sleep(0.001)", "")
    code = code.replace("quadftc_bags.writer", "quadftc_bags.writer_process").replace(
        "BagWriter", "BagProcess"
    )
    arguments = [sys.executable, "-c", code, str(tmp_path / "run"), "False"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as child:
        written = [int(child.stdout.readline()) for _ in range(3 * BATCH)]
        child.send_signal(signal.SIGKILL)
        written += [int(line) for line in child.stdout if line.endswith("\n")]
    deadline = time.monotonic() + 30.0
    while not is_complete(tmp_path / "run" / "run_0.mcap") and time.monotonic() < deadline:
        time.sleep(0.05)
    stored = [message.log_time for message in stored_messages(tmp_path / "run" / "run_0.mcap")]
    assert is_complete(tmp_path / "run" / "run_0.mcap")
    assert stored == written[: len(stored)]
    # the batch that was being filled, and those not sent yet: a busy machine lets the sender wait
    assert len(written) - len(stored) <= 4 * BATCH


def is_complete(path: Path) -> bool:
    """Whether a file has the summary that closing it writes."""
    with path.open("rb") as stream, suppress(EndOfFile, struct.error, ValueError):
        return make_reader(stream).get_summary() is not None
    return False


def test_process_drops_and_counts_in_real_time_when_the_other_is_slow(tmp_path):
    writer = opened(BagProcess, tmp_path / "run", queue_size=4 * BATCH)
    assert writer.flush()
    os.kill(writer.process_id, signal.SIGSTOP)
    accepted = [writer.write("/plant/rate", vector(k), k, k) for k in range(20_000)]
    os.kill(writer.process_id, signal.SIGCONT)
    assert accepted.count(False) > 10_000  # the socket and the queue are full; the caller did not wait
    status = writer.close()
    assert sum(status.counts.values()) + sum(status.dropped.values()) == 20_000
    assert status.error is None
    numbers = stored_numbers(writer.path)
    assert len(numbers) == status.counts["/plant/rate"]
    assert set(numbers) <= {k for k in range(20_000) if accepted[k]}


@pytest.mark.parametrize("lockstep", [False, True])
def test_process_that_hangs_is_given_up_and_the_caller_goes_on(tmp_path, monkeypatch, lockstep):
    monkeypatch.setattr(writer_process, "PATIENCE", 0.5)
    errors: list[str] = []
    writer = opened(BagProcess, tmp_path / "run", lockstep=lockstep, on_error=errors.append)
    assert writer.flush()
    os.kill(writer.process_id, signal.SIGSTOP)
    begin = time.monotonic()
    write_numbers(writer, 20_000)
    status = writer.close()
    assert time.monotonic() - begin < 10.0
    assert errors == [status.error]
    assert status.error == f"{writer.path}: the process that writes it does not answer"
    assert status.lost + sum(status.counts.values()) + sum(status.dropped.values()) == 20_000


def test_slow_disk_does_not_delay_what_a_killed_recorder_leaves(tmp_path, monkeypatch):
    monkeypatch.setattr(BagFile, "sync", lambda file: time.sleep(1.0))
    writer = opened(BagWriter, tmp_path / "run")
    end, number, worst = time.monotonic() + 1.5, 0, 0.0
    while (now := time.monotonic()) < end:
        writer.write("/plant/rate", vector(number), time.time_ns(), 0)
        stored = stored_messages(writer.path)
        if number and stored:
            worst = max(worst, time.time() - stored[-1].log_time * 1e-9)
        number += 1
        time.sleep(max(0.0, now + 0.02 - time.monotonic()))
    assert writer.close().counts == {"/plant/rate": number}
    assert worst < 2 * FLUSH_PERIOD


def test_lockstep_stream_slower_than_real_time_is_held_no_longer_than_a_second(tmp_path):
    """At 0.2 of real time the messages that a cut waits for would be 1.5 s old."""
    writer = opened(BagWriter, tmp_path / "run", lockstep=True)
    begin, number, worst = time.monotonic(), 0, 0.0
    while time.monotonic() - begin < 3.0:
        log_time_ns = 1_000_000_000 + round(0.2e9 * (time.monotonic() - begin))
        writer.write("/plant/rate", vector(number), log_time_ns, log_time_ns)
        stored = stored_messages(writer.path)
        last = stored[-1].log_time if stored else 1_000_000_000
        worst = max(worst, (log_time_ns - last) / 0.2e9)
        number += 1
        time.sleep(0.02)
    assert writer.close().counts == {"/plant/rate": number}
    assert 0.6 < worst < 1.0


def test_no_memory_stops_the_recording_not_the_caller(tmp_path, monkeypatch):
    def no_memory(*_: object) -> None:
        raise MemoryError

    writer = opened(BagWriter, tmp_path / "run")
    write_numbers(writer, 100)
    assert writer.flush()
    monkeypatch.setattr(BagFile, "write", no_memory)
    write_numbers(writer, 100)
    status = writer.close()
    assert (status.counts, status.lost) == ({"/plant/rate": 100}, 100)
    assert status.error == f"{writer.path}: MemoryError()"
    assert stored_numbers(writer.path) == list(range(100))


def test_memory_is_bounded_while_nothing_can_be_written(tmp_path):
    """A minute of a graph, 0.5 kB a message, to a writer that does not write: 110 MB."""
    writer = opened(BagProcess, tmp_path / "run")
    assert writer.flush()
    os.kill(writer.process_id, signal.SIGSTOP)
    before, data, put = resident_memory(), vector(0), writer.input("/plant/rate")
    accepted = sum(put(data + bytes(512 - len(data)), number, number) for number in range(200_000))
    grown = resident_memory() - before
    os.kill(writer.process_id, signal.SIGCONT)
    status = writer.close()
    assert grown < 60e6, grown
    assert status.dropped == {"/plant/rate": 200_000 - status.counts["/plant/rate"]}
    assert 65_536 <= status.counts["/plant/rate"] <= accepted < 70_000


def resident_memory() -> int:
    """Of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
