"""Whatever comes on a topic or by a service: no node fails, none publishes what is no number.

Sequences of good and bad messages, drawn by Hypothesis, go straight into the callbacks of each node. Then
good messages come again, and the node has to answer them as before. Two things are left out on purpose: the
fault injector passes on what it gets (that is what a faulty sensor is), and in lock-step a node whose partner
answers with another stamp waits for the right one until a new flight begins.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from accusing_observer import NAME as ACCUSING
from accusing_observer import registered
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from message_objects import set_stamp
from node_bench import imu_message
from quadftc_bags.interfaces import load_message_class
from quadftc_control.controller import controllers
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.attitude_estimator_node import AttitudeEstimatorNode
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.conversions import stamp_of
from quadftc_ros.recorder_node import RecorderNode
from quadftc_ros.topics import TOPICS
from quadftc_sim.fault import faults
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode
from wired_node import (
    NO_MESSAGES,
    PERIOD_NS,
    SPECIAL,
    Wired,
    number_places,
    numbers_of,
    put_number,
    set_bad_stamp,
)

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers that overflow on the way

# node, its parameters, the topic that drives it, and the one that answers a sample
NODES = {
    "attitude_estimator": (AttitudeEstimatorNode, {"rate": 250.0}, "imu/data_raw", "imu/data"),
    "fault_injector": (FaultInjectorNode, {}, "plant/imu", "imu/data"),
    **{
        f"fault_observer {name}": (FaultObserverNode, {"observer": name}, "imu/data", "imu/corrected")
        for name in (*fault_observers.names(), ACCUSING)
    },
    **{
        f"disturbance_observer {name}": (
            DisturbanceObserverNode,
            {"observer": name},
            "imu/corrected",
            "disturbance/estimate",
        )
        for name in disturbance_observers.names()
    },
    **{
        f"controller {name}": (ControllerNode, {"controller": name}, "imu/corrected", "torque/command")
        for name in controllers.names()
    },
    "reference scenario": (ReferenceNode, {}, "imu/data", "attitude/reference"),
    "reference topic": (ReferenceNode, {"source": "topic"}, "imu/data", "attitude/reference"),
}
SECOND = 1_000_000_000  # ns
BAD_NUMBERS = st.sampled_from(
    [
        math.nan,
        math.inf,
        -math.inf,
        1.8e308,
        -1e308,
        1e200,
        -1e30,
        1e9,
        1e3,
        5e-324,
        -1e-310,
        0.0,
        -0.0,
        -1.0,
        0.5,
    ]
)
OWN = "own"  # stands for the frame of the topic
FRAMES = st.sampled_from([*[OWN] * 5, "", "map", "base_link", "imu_link", "x" * 300, "é/\n", "n" * 70_000])
STAMPS = st.one_of(
    st.integers(-5 * SECOND, 9 * SECOND // 10), st.sampled_from([*SPECIAL, "next", "next", "next"])
)
GOOD, SETTLING = (
    16,
    4,
)  # samples after each sequence; of which a controller may use those to change its source
FAR_NS = 2_100_000_000 * SECOND
PASSED_ON = (
    "imu/data",
    "fault/injected",
    "fault/injected/gyro",
    "fault/injected/accelerometer",
)  # by the injector


@pytest.fixture(autouse=True, scope="module")
def accusing():
    """An observer that speaks of all sensors."""
    with registered():
        yield


def good(topic, stamp_ns):
    """A message as it should be."""
    if TOPICS[topic].type_name.endswith("/Imu"):
        return imu_message(stamp_ns)
    if TOPICS[topic].type_name.endswith("/Header"):
        header = Header()
        set_stamp(header, stamp_ns)
        return header
    message = load_message_class(TOPICS[topic].type_name)()
    set_stamp(message.header, stamp_ns)
    return message


def spoilt(topic, stamp_ns, data):
    """A message with drawn numbers and a drawn frame."""
    message = good(topic, stamp_ns)
    places = list(number_places(message))
    for index in data.draw(st.lists(st.integers(0, len(places) - 1), max_size=4)) if places else ():
        put_number(places[index], data.draw(BAD_NUMBERS))
    frame = data.draw(FRAMES)
    getattr(message, "header", message).frame_id = TOPICS[topic].frame if frame == OWN else frame
    return message


def fly(wired, driver, first_ns, count):
    """Feed good samples; the one that drives first, the torque last."""
    others = sorted(
        (topic for topic in wired.topics if topic != driver), key=lambda name: name == "torque/command"
    )
    for k in range(count):
        for topic in (driver, *others):
            wired.feed(topic, good(topic, first_ns + k * PERIOD_NS))


def check(wired, injects):
    """All that was published is numbers."""
    for topic, message in wired.take():
        if not (injects and topic in PASSED_ON):
            assert all(map(math.isfinite, numbers_of(message))), f"{topic}: {message}"


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
@pytest.mark.parametrize("case", NODES)
def test_node_lives_through_bad_messages_and_answers_good_ones(case, mode):
    node_class, parameters, driver, answer = NODES[case]
    injects, clock = node_class is FaultInjectorNode, [1000 * SECOND]

    @settings(max_examples=settings().max_examples // 8)
    @given(st.data())
    def sequence(data):
        now_ns = clock[0] = clock[0] + 20 * SECOND
        for topic, stamp in data.draw(
            st.lists(st.tuples(st.sampled_from(sorted(wired.topics)), STAMPS), min_size=5, max_size=30)
        ):
            message = spoilt(topic, now_ns, data)
            wired.feed(topic, set_bad_stamp(message, stamp, now_ns))
            now_ns += PERIOD_NS if stamp == "next" else 0
        check(wired, injects)
        wired.call("reset", Trigger.Request())
        first_ns = now_ns + 5 * SECOND
        if mode == "lockstep":  # a new flight, which stamps that go back tell
            fly(wired, driver, FAR_NS, 1)
            first_ns = SECOND
        fly(wired, driver, first_ns, GOOD)
        answers = [stamp_of(message) for topic, message in wired.take() if topic == answer]
        wanted = [first_ns + k * PERIOD_NS for k in range(GOOD)]
        settling = SETTLING if node_class is ControllerNode and mode == "realtime" else 0
        assert [stamp_ns for stamp_ns in answers if stamp_ns in wanted[settling:]] == wanted[settling:]

    with Wired(node_class, mode, **parameters) as wired:
        fly(wired, driver, 900 * SECOND, 3)
        sequence()


@pytest.mark.parametrize("case", NODES)
def test_bytes_that_are_no_message_are_counted(case):
    node_class, parameters, driver, _ = NODES[case]
    with Wired(node_class, "realtime", **parameters) as wired:
        fly(wired, driver, 900 * SECOND, 3)
        for topic, reader in wired.topics.items():
            if not reader.raw:
                continue
            before = wired.node.diagnostics.counts.total()
            for data in NO_MESSAGES:
                wired.feed(topic, data)
            if (node_class, topic) != (ControllerNode, "imu/data"):  # of which it reads the stamp alone
                assert wired.node.diagnostics.counts[f"{topic}: unreadable"] >= 3
            assert wired.node.diagnostics.counts.total() > before
        check(wired, node_class is FaultInjectorNode)


@pytest.mark.parametrize("case", NODES)
def test_frames_that_are_not_those_of_the_topic_are_counted(case):
    node_class, parameters, driver, _ = NODES[case]
    with Wired(node_class, "realtime", **parameters) as wired:
        fly(wired, driver, 900 * SECOND, 3)
        for topic in wired.topics:
            message = good(topic, 901 * SECOND)
            getattr(message, "header", message).frame_id = "elsewhere"
            wired.feed(topic, message)
            counted = [
                name for name in wired.node.diagnostics.counts if name.startswith(f"{topic}: frame_id")
            ]
            assert len(counted) == 1


@pytest.mark.parametrize("case", NODES)
def test_stamps_that_are_no_time_are_counted_and_the_message_refused(case):
    node_class, parameters, driver, answer = NODES[case]
    with Wired(node_class, "realtime", **parameters) as wired:
        fly(wired, driver, 900 * SECOND, 3)
        wired.take()
        for topic in wired.topics:
            for kind in ("negative", "beyond"):
                wired.feed(topic, set_bad_stamp(good(topic, 0), kind, 0))
            assert wired.node.diagnostics.counts[f"{topic}: stamp is no time"] == 2
        assert answer not in [topic for topic, _ in wired.take()]


@pytest.mark.parametrize(
    ("case", "topic", "spoil", "counted"),
    [
        ("attitude_estimator", "imu/data_raw", "stamp", "imu/data_raw: stamp repeated or went back"),
        ("attitude_estimator", "imu/data_raw", "rate", "imu/data_raw: body rate absent or unusable"),
        ("fault_injector", "plant/imu", "stamp", "plant/imu: stamp repeated or went back"),
        ("fault_observer sliding_mode", "imu/data", "stamp", "imu/data: stamp repeated or went back"),
        ("fault_observer sliding_mode", "imu/data", "rate", "imu/data: body rate absent or unusable"),
        ("fault_observer sliding_mode", "imu/data", "huge", "imu/data: body rate absent or unusable"),
        ("fault_observer sliding_mode", "imu/data", "attitude", "imu/data: attitude absent or unusable"),
        ("fault_observer sliding_mode", "torque/command", "vector", "torque/command: not finite"),
        (
            "disturbance_observer exosystem",
            "imu/corrected",
            "stamp",
            "imu/corrected: stamp repeated or went back",
        ),
        (
            "disturbance_observer exosystem",
            "imu/corrected",
            "rate",
            "imu/corrected: body rate absent or unusable",
        ),
        ("disturbance_observer exosystem", "torque/command", "vector", "torque/command: not finite"),
        ("controller ismc", "disturbance/estimate", "vector", "disturbance/estimate: not finite"),
        ("controller ismc", "attitude/reference", "angles", "attitude/reference: not finite"),
        ("reference topic", "imu/data", "stamp", "imu/data: stamp repeated or went back"),
        ("reference topic", "attitude/setpoint", "vector", "attitude/setpoint"),
    ],
)
def test_what_is_refused_is_counted_by_its_reason(case, topic, spoil, counted):
    node_class, parameters, driver, _ = NODES[case]
    with Wired(node_class, "realtime", **parameters) as wired:
        fly(wired, driver, 900 * SECOND, 3)
        message = good(topic, 900 * SECOND + 3 * PERIOD_NS)
        if spoil == "stamp":
            set_stamp(message.header, 900 * SECOND)
        elif spoil in ("rate", "huge"):
            message.angular_velocity.x = math.nan if spoil == "rate" else 1e200
        elif spoil == "attitude":
            message.orientation.w = 0.0
        else:
            getattr(message, spoil).x = math.nan
        wired.feed(topic, message)
        found = [name for name in wired.node.diagnostics.counts if name.startswith(counted)]
        assert found, dict(wired.node.diagnostics.counts)


REQUESTS = st.fixed_dictionaries(
    {
        "kind": st.sampled_from([*faults.names(), "", "bais", "x" * 5000]),
        "channel": st.sampled_from(["attitude", "gyro", "accelerometer", "imu", "", "é"]),
        "axes": st.lists(st.sampled_from(["roll", "pitch", "yaw", "x", "z", "", "north"]), max_size=4),
        "start": BAD_NUMBERS,
        "duration": BAD_NUMBERS,
        "parameter_names": st.lists(
            st.sampled_from(
                ["value", "sigma", "rate", "probability", "delay", "factor", "stop", "", "x" * 400]
            ),
            max_size=3,
        ),
        "parameter_values": st.lists(BAD_NUMBERS, max_size=3),
    }
)


def test_injector_answers_any_request_and_flies_on():
    with Wired(FaultInjectorNode, "realtime") as wired:
        now_ns = [900 * SECOND]

        @settings(max_examples=5 * settings().max_examples // 2)
        @given(REQUESTS, st.integers(0, 2**32 - 1))
        def ask(fields, number):
            answer = wired.call("inject", InjectFault.Request(**fields))
            assert answer.success == (answer.id > 0)
            assert answer.message
            assert len(answer.message) < 6000
            for _ in range(3):
                now_ns[0] += PERIOD_NS
                wired.feed("plant/imu", imu_message(now_ns[0]))
            out = wired.take()
            assert [stamp_of(message) for topic, message in out if topic == "fault/injected"][-1] == now_ns[0]
            assert wired.call("clear", ClearFault.Request(id=number)).message
            wired.call("clear", ClearFault.Request(id=0))

        ask()


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_plant_flies_on_whatever_torque_comes(mode):
    with Wired(partial(PlantNode, timed=False), mode, start_when_connected=False) as wired:
        assert wired.call("start", Trigger.Request()).success
        assert not wired.call("start", Trigger.Request()).success

        @settings(max_examples=60)
        @given(st.data())
        def sequence(data):
            for topic, stamp in data.draw(
                st.lists(st.tuples(st.sampled_from(sorted(wired.topics)), STAMPS), min_size=3, max_size=20)
            ):
                awaited = wired.node.flight.awaited_ns or 0
                wired.feed(topic, set_bad_stamp(spoilt(topic, awaited, data), stamp, awaited))
                if mode == "realtime":
                    wired.node.tick()
            wired.take()
            for _ in range(5):
                awaited = wired.node.flight.awaited_ns
                wired.feed("torque/command", good("torque/command", awaited))
                if mode == "realtime":
                    wired.node.tick()
            out = [message for topic, message in wired.take() if topic == "plant/imu"]
            assert len(out) >= 5
            assert all(map(math.isfinite, numbers_of(out[-1])))
            rate = out[-1].angular_velocity
            assert np.linalg.norm([rate.x, rate.y, rate.z]) < 1e4

        sequence()
        assert wired.node.diagnostics.counts["torque/command: not finite"] > 0


@pytest.mark.parametrize("data", [*NO_MESSAGES[:4], b"\0\1\0\0\0\0\0\x80" + bytes(40)])
def test_recorder_in_lockstep_leaves_out_what_has_no_stamp(lockstep_bench, tmp_path, data):
    node = lockstep_bench.run(RecorderNode, directory=str(tmp_path / "bag"), topics=["imu/data"])
    take = node.tap("/imu/data")
    for stamp_ns in (SECOND, 2 * SECOND):
        take(data)
        take(serialize_message(imu_message(stamp_ns)))
    status = node.finish()
    assert (status.error, sum(status.counts.values())) == (None, 2)
    assert node.diagnostics.counts["messages without a stamp, not recorded"] == 2
