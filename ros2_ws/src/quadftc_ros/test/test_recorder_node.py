"""The recorder node: what it stores of a live graph, in process and as its own process."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import pytest
import rclpy
from mcap.reader import make_reader
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader

from quadftc_bags.cdr.message import leading_stamp_ns
from quadftc_bags.interfaces import load_message_class
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import make_executor
from quadftc_ros.node import GraphNode
from quadftc_ros.qos import topic_profile
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.topics import GRAPHS, TOPICS

START_NS = 1_000_000_000
PERIOD_NS = 4_000_000
PATIENCE = 20.0  # s


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.try_shutdown(context=context)


@pytest.fixture
def namespace() -> str:
    """A namespace that no other test has, not even one whose processes are still known to the network."""
    return f"/test_{uuid4().hex}"


def parameters(**values: object) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in values.items()]


def stamped(topic: str, stamp_ns: int) -> object:
    """A message of a topic of the table whose leading stamp is set."""
    message = load_message_class(TOPICS[topic].type_name)()
    header = getattr(message, "header", message)
    time_message = message.clock if hasattr(message, "clock") else header.stamp
    time_message.sec, time_message.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


def full_name(namespace: str, topic: str) -> str:
    return topic if topic.startswith("/") else f"{namespace}/{topic}"


def wait_until(done: Callable[[], object], spin: Callable[[], None] = lambda: time.sleep(0.01)) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline, "nothing happened in time"
        spin()


def record(
    context: Context, namespace: str, directory: Path, mode: str, count: int, topics: list[str]
) -> RecorderNode:
    """Publish ``count`` messages on each topic to a recorder; return it, with its bag closed."""
    given = parameters(directory=str(directory), mode=mode, topics=topics)
    recorder = RecorderNode(context=context, parameter_overrides=given, namespace=namespace)
    sender = Node("sender", context=context, namespace=namespace)
    executor = make_executor(context)
    executor.add_node(recorder)
    publishers = [
        sender.create_publisher(
            load_message_class(TOPICS[topic].type_name), topic, topic_profile(TOPICS[topic].qos, mode)
        )
        for topic in topics
    ]
    wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers))
    for number in range(count):
        for topic, publisher in zip(topics, publishers, strict=True):
            publisher.publish(stamped(topic, START_NS + number * PERIOD_NS))
        executor.spin_once(timeout_sec=0.001)
    wait_until(lambda: recorder.received == count * len(topics), lambda: executor.spin_once(timeout_sec=0.01))
    assert sum(recorder.finish().counts.values()) == count * len(topics)
    executor.shutdown()
    recorder.destroy_node()
    sender.destroy_node()
    return recorder


@pytest.mark.parametrize("topic", list(TOPICS))
def test_leading_stamp_is_read_from_every_type_of_the_graph(topic):
    stamp_ns = 12_345_678_901
    assert leading_stamp_ns(serialize_message(stamped(topic, stamp_ns))) == stamp_ns


def test_lockstep_stores_every_message_by_its_stamp(context, namespace, tmp_path):
    topics = ["imu/data", "fault/status", "control/status", "fault/dropped", "/clock"]
    recorder = record(context, namespace, tmp_path / "run", "lockstep", 100, topics)
    stamps = [START_NS + number * PERIOD_NS for number in range(100)]
    with recorder.path.open("rb") as stream:
        found: dict[str, list[tuple[int, int, int]]] = {}
        for _, channel, message in make_reader(stream).iter_messages():
            times = (message.log_time, message.publish_time, leading_stamp_ns(message.data))
            found.setdefault(channel.topic, []).append(times)
    assert found == {full_name(namespace, topic): [(stamp,) * 3 for stamp in stamps] for topic in topics}


def test_realtime_stores_best_effort_topics_by_the_time_of_arrival(context, namespace, tmp_path):
    before = time.time_ns()
    recorder = record(context, namespace, tmp_path / "run", "realtime", 50, ["imu/data", "fault/status"])
    after = time.time_ns()
    with AnyReader([tmp_path / "run"]) as reader:
        times = [time_ns for _, time_ns, _ in reader.messages()]
    assert len(times) == 100
    assert before <= min(times) <= max(times) <= after
    assert recorder.status.counts == {f"{namespace}/imu/data": 50, f"{namespace}/fault/status": 50}


def test_lockstep_leaves_out_what_is_sent_before_the_flight(context, namespace, tmp_path):
    given = parameters(directory=str(tmp_path / "run"), mode="lockstep", topics=["fault/status"])
    recorder = RecorderNode(context=context, parameter_overrides=given, namespace=namespace)
    executor = make_executor(context)
    executor.add_node(recorder)
    publisher = recorder.create_publisher(
        load_message_class(TOPICS["fault/status"].type_name), "fault/status", 10
    )
    wait_until(lambda: publisher.get_subscription_count() == 1)
    for stamp_ns in (0, 0, START_NS):
        publisher.publish(stamped("fault/status", stamp_ns))
    wait_until(
        lambda: recorder.flush() and bool(recorder.status.counts[f"{namespace}/fault/status"]),
        lambda: executor.spin_once(timeout_sec=0.01),
    )
    executor.shutdown()
    recorder.destroy_node()
    with AnyReader([tmp_path / "run"]) as reader:
        assert [time_ns for _, time_ns, _ in reader.messages()] == [START_NS]


def test_bag_holds_attachments_and_versions(context, tmp_path):
    scenario = tmp_path / "scenario.yaml"
    scenario.write_bytes(b"rate: 250\n")
    given = parameters(directory=str(tmp_path / "run"), attachments=[str(scenario)])
    recorder = RecorderNode(context=context, parameter_overrides=given, namespace="/uav1")
    recorder.destroy_node()
    with recorder.path.open("rb") as stream:
        reader = make_reader(stream)
        assert [(item.name, item.data) for item in reader.iter_attachments()] == [
            ("scenario.yaml", b"rate: 250\n")
        ]
        (versions,) = [item.metadata for item in reader.iter_metadata() if item.name == "quadftc"]
        names = {channel.topic for channel in reader.get_summary().channels.values()}
    assert versions["mode"] == "realtime"
    assert {"quadftc", "ros_distro", "python", "mcap", "numpy"} <= set(versions)
    assert names == {full_name("/uav1", name) for name in GRAPHS["test_stand"]}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "directory = '': expected the path of a new directory"),
        ({"directory": "{there}"}, "exists already"),
        ({"directory": "{new}", "mode": "fast"}, "mode = 'fast': expected one of lockstep, realtime"),
        ({"directory": "{new}", "topics": ["imu/date"]}, "topics: unknown imu/date; known are plant/imu"),
        ({"directory": "{new}", "compression": "zip"}, "compression = 'zip': expected one of zstd"),
        ({"directory": "{new}", "attachments": ["{new}/no.yaml"]}, "no.yaml: No such file"),
    ],
)
def test_wrong_parameter_is_refused_with_its_name(context, tmp_path, given, text):
    places = {"there": str(tmp_path), "new": str(tmp_path / "new")}
    filled = {
        name: [part.format(**places) for part in value] if isinstance(value, list) else value.format(**places)
        for name, value in given.items()
    }
    with pytest.raises(ValueError, match=text):
        RecorderNode(context=context, parameter_overrides=parameters(**filled))
    assert not (tmp_path / "new").exists()


@contextmanager
def recorder_process(directory: Path, namespace: str = "/") -> Iterator[subprocess.Popen[str]]:
    """Start the recorder as its own process; it is killed at the end if it still runs."""
    command = [sys.executable, "-m", "quadftc_ros.recorder_node"]
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "-p", f"directory:={directory}"]
    with subprocess.Popen(command + arguments, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_process_closes_the_bag_when_told_to_stop(context, namespace, tmp_path, stop):
    sender = Node("sender", context=context, namespace=namespace)
    publisher = sender.create_publisher(
        load_message_class(TOPICS["imu/data"].type_name), "imu/data", topic_profile("sensor", "realtime")
    )
    with recorder_process(tmp_path / "run", namespace) as process:
        wait_until(lambda: publisher.get_subscription_count() == 1)
        for number in range(500):
            publisher.publish(stamped("imu/data", START_NS + number))
            time.sleep(0.002)
        time.sleep(0.3)
        process.send_signal(stop)
        code = process.wait(PATIENCE)
        errors = process.stderr.read()
    sender.destroy_node()
    assert code == 0
    assert [line for line in errors.splitlines() if "runs: directory " not in line] == []
    with AnyReader([tmp_path / "run"]) as reader:
        stamps = [
            leading_stamp_ns(data) for link, _, data in reader.messages() if link.topic.endswith("/imu/data")
        ]
    # The first ones may come before both processes know of each other; from then on none is missing.
    assert len(stamps) > 100
    assert stamps == list(range(START_NS + 500 - len(stamps), START_NS + 500))


def test_process_refuses_an_existing_directory_in_one_line(tmp_path):
    with recorder_process(tmp_path) as process:
        errors = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 2
    assert errors.splitlines() == [
        f"error: directory = '{tmp_path}': bag directory {tmp_path} exists already"
    ]


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_recorder_gets_by_tap_what_nodes_in_its_process_publish(context, namespace, tmp_path, mode):
    common = {"context": context, "namespace": namespace}
    given = parameters(directory=str(tmp_path / "bag"), mode=mode, topics=["plant/rate", "/diagnostics"])
    recorder = RecorderNode(inside=["plant", "recorder"], parameter_overrides=given, **common)
    sender = GraphNode("plant", tap=recorder.tap, parameter_overrides=parameters(mode=mode), **common)
    rate, attitude = sender.publishes("plant/rate"), sender.publishes("plant/attitude")
    sender.ready()
    assert sender.count_subscribers("plant/rate") == 0
    for number in range(300):
        rate(stamped("plant/rate", START_NS + number * PERIOD_NS))
        attitude(stamped("plant/attitude", START_NS + number * PERIOD_NS))
    sender.diagnostics.report("part", OK, "well")
    sender.sampled(START_NS)
    recorder.diagnostics.publish(START_NS)  # its own, too
    assert recorder.process_id is not None
    status = recorder.finish()
    assert status.counts == {full_name(namespace, "plant/rate"): 300, "/diagnostics": 2}
    with AnyReader([tmp_path / "bag"]) as reader:
        names = {connection.topic for connection in reader.connections}
        found = [leading_stamp_ns(data) for at, _, data in reader.messages() if at.topic.endswith("rate")]
    assert names == {full_name(namespace, "plant/rate"), "/diagnostics"}
    assert found == [START_NS + number * PERIOD_NS for number in range(300)]
    for node in (sender, recorder):
        node.destroy_node()
