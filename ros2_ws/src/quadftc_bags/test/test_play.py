"""Playing a bag: what a subscriber on the live graph receives."""

import time
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest
import rclpy
from builtin_interfaces.msg import Time
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from quadftc_bags.bag import BagError
from quadftc_bags.bag_format import offered_qos
from quadftc_bags.play import play, profile_from_record
from quadftc_bags.writer import BagWriter
from quadftc_ros.executor import make_executor

COUNT = 50
PERIOD_NS = 10_000_000


@pytest.fixture
def context() -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.try_shutdown(context=context)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Half a second of stamps on /stamps."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/stamps", "std_msgs/msg/Header", QoSProfile(depth=COUNT))
        for number in range(COUNT):
            writer.write("/stamps", message(number), number * PERIOD_NS, number * PERIOD_NS)
    return tmp_path / "bag"


def message(number: int) -> bytes:
    return serialize_message(Header(stamp=Time(sec=number), frame_id="base_link"))


def listen(context: Context) -> tuple[Node, list[tuple[float, bytes]]]:
    node = Node("listener", context=context)
    received: list[tuple[float, bytes]] = []
    node.create_subscription(
        Header,
        "/stamps",
        lambda data: received.append((time.monotonic(), data)),
        QoSProfile(depth=1000),
        raw=True,
    )
    return node, received


@pytest.mark.parametrize("rate", [1.0, 5.0])
def test_played_bag_arrives_byte_by_byte_at_its_rate(context, bag, rate):
    node, received = listen(context)
    executor = make_executor("events", context)
    executor.add_node(node)
    results: list[int] = []
    player = Thread(target=lambda: results.append(play(bag, rate, delay=0.5, context=context)))
    player.start()
    deadline = time.monotonic() + 20.0
    while len(received) < COUNT and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.2)
    player.join()
    executor.spin_once(timeout_sec=0.2)  # nothing more may come
    executor.shutdown()
    node.destroy_node()
    assert [data for _, data in received] == [message(number) for number in range(COUNT)]
    assert results == [COUNT]
    duration = received[-1][0] - received[0][0]
    assert duration > 0.9 * (COUNT - 1) * PERIOD_NS * 1e-9 / rate


def test_loop_goes_on_until_the_context_is_shut_down(context, bag):
    results: list[int] = []
    player = Thread(target=lambda: results.append(play(bag, 50.0, loop=True, context=context)))
    player.start()
    time.sleep(0.5)
    rclpy.shutdown(context=context)
    player.join(10.0)
    assert not player.is_alive()
    assert results[0] > COUNT


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_rate_that_is_not_positive_is_refused(bag, rate):
    with pytest.raises(ValueError, match=r"rate: .* expected > 0"):
        play(bag, rate)


def test_topic_that_is_not_there_leaves_nothing_to_play(bag):
    with pytest.raises(BagError, match="nothing to play"):
        play(bag, topics=["imu/data"])


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
@pytest.mark.parametrize("durability", [DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL])
def test_quality_of_service_survives_the_record(reliability, durability):
    profile = QoSProfile(depth=7, reliability=reliability, durability=durability)
    again = profile_from_record(offered_qos(profile))
    assert (again.depth, again.reliability, again.durability) == (7, reliability, durability)


@pytest.mark.parametrize("text", ["", "- {history: unknown, depth: 0, reliability: reliable}"])
def test_quality_of_service_that_rosbag2_did_not_know_is_reliable(text):
    profile = profile_from_record(text)
    assert (profile.depth, profile.reliability) == (10, ReliabilityPolicy.RELIABLE)
