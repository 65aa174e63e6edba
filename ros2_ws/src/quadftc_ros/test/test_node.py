"""What every node of the graph does: it is driven by stamps, resets, and tells of its connections."""

import time

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node
from std_srvs.srv import Trigger

from node_bench import NodeBench, imu_message, vector_message
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.conversions import stamp_of
from quadftc_ros.limits import limits_of
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import GRAPHS, crowded_topics, missing_connections
from quadftc_ros.wire import vector_of

SECOND = 1_000_000_000  # ns


class Counter(GraphNode):
    """Notes what drives it; named as the fault observer, whose topics it has."""

    def __init__(self, **kwargs):
        super().__init__("fault_observer", **kwargs)
        self.seen = []
        self.publishes("imu/corrected")
        self.driven_by("imu/data", self.note, restart=lambda: self.seen.append("restart"))
        self.ready()

    def note(self, stamp_ns, message):
        assert stamp_of(message) == stamp_ns
        self.seen.append(stamp_ns)
        self.sampled(stamp_ns)


def driven(bench, stamps):
    """What a node notes of samples with these stamps [ns]."""
    node = bench.run(Counter)
    send = bench.talk("imu/data")
    bench.connect()
    for stamp_ns in stamps:
        count = len(node.seen)
        send(imu_message(stamp_ns))
        bench.until(lambda before=count: len(node.seen) > before)
    bench.until(lambda: stamps[-1] in node.seen)
    return node


@pytest.mark.parametrize("back", [0, 1, 10 * SECOND])
def test_any_stamp_that_is_not_later_begins_a_new_flight_in_lockstep(lockstep_bench, back):
    stamps = [20 * SECOND, 21 * SECOND, 21 * SECOND - back, 22 * SECOND]
    node = driven(lockstep_bench, stamps)
    assert node.seen == [*stamps[:2], "restart", *stamps[2:]]


def test_late_sample_does_not_begin_a_new_flight_in_real_time(bench):
    stamps = [20 * SECOND, 21 * SECOND, 20 * SECOND + 1, 21 * SECOND, 22 * SECOND]
    assert driven(bench, stamps).seen == stamps


def test_clock_that_was_set_back_begins_a_new_flight_in_real_time(bench):
    node, send = bench.run(Counter), bench.talk("imu/data")
    bench.connect()
    send(imu_message(20 * SECOND))
    bench.until(lambda: node.seen)
    for stamp_ns in (5 * SECOND, 6 * SECOND):

        def seen(stamp_ns=stamp_ns):
            send(imu_message(stamp_ns))  # what jumps is doubted at first
            return stamp_ns in node.seen

        bench.until(seen)
    assert list(dict.fromkeys(node.seen)) == [20 * SECOND, "restart", 5 * SECOND, 6 * SECOND]


def test_stamp_that_jumps_among_good_ones_is_refused(bench):
    node, send = bench.run(Follower), bench.talk("torque/command")
    bench.connect()

    def refused():
        stamp_ns = time.monotonic_ns()
        send(vector_message(stamp_ns))
        send(vector_message(stamp_ns + 3600 * SECOND))
        return len(node.seen) > 20 and node.diagnostics.counts.total() > 20

    bench.until(refused)
    assert max(node.seen) < time.monotonic_ns()


def test_torque_that_no_vehicle_gives_is_refused_in_real_time(bench):
    node, send = bench.run(Follower), bench.talk("torque/command")
    bench.connect()
    send(vector_message(SECOND, (0.0, 0.0, 1.0)))
    send(vector_message(SECOND + 1, (0.0, 0.0, 0.3)))
    bench.until(lambda: node.seen)
    assert node.seen == [SECOND + 1]
    assert dict(node.diagnostics.counts) == {"torque/command: more than the vehicle can do, refused": 1}


@pytest.mark.parametrize("topic", ["torque/command", "plant/attitude"], ids=["read", "published"])
def test_second_publisher_is_reported_by_name_and_what_it_says_is_dropped(bench, topic):
    status = bench.watch_diagnostics()

    def said():
        part = status.get("plant: publishers")
        return part and (part.level, part.message)

    node, send = bench.run(Follower), bench.talk("torque/command")
    bench.connect()
    for k in range(50):
        send(vector_message(SECOND + k))
    bench.until(lambda: len(node.seen) == 50)
    intruder = bench._add(Node("intruder", context=bench.context))
    second = intruder.create_publisher(Vector3Stamped, topic, 100)
    first = "/tester" if topic == "torque/command" else "/plant"
    bench.until(lambda: said() == (DiagnosticStatus.ERROR, f"{topic}: /intruder publishes beside {first}"))
    second.publish(vector_message(2 * SECOND, frame="base_link"))
    send(vector_message(SECOND + 50))
    bench.until(lambda: len(node.seen) == 51)
    assert max(node.seen) == SECOND + 50
    intruder.destroy_publisher(second)
    bench.until(lambda: said() == (DiagnosticStatus.OK, "one on each topic"))


def test_reset_service_restarts(bench):
    node = bench.run(Counter)
    answer = bench.call(Trigger, "fault_observer/reset")
    assert (answer.success, answer.message) == (True, "restarts at the next sample")
    assert node.seen == ["restart"]


def test_rate_is_told_by_the_stamps_in_lockstep(lockstep_bench):
    status = lockstep_bench.watch_diagnostics()
    driven(lockstep_bench, [SECOND + k * SECOND // 50 for k in range(120)])
    lockstep_bench.until(lambda: status["fault_observer: timing"].values)
    said = status["fault_observer: timing"]
    assert (said.level, said.message) == (DiagnosticStatus.OK, "samples come")
    assert {pair.key: pair.value for pair in said.values} == {"rate_hz": "50.0"}


def test_rate_and_latency_are_told_in_real_time_and_that_samples_have_stopped(bench):
    status = bench.watch_diagnostics()
    bench.run(Counter)
    send = bench.talk("imu/data")
    bench.connect()
    late_ns = SECOND // 5

    def fly():
        send(imu_message(time.time_ns() - late_ns))
        timing = status.get("fault_observer: timing")
        return timing is not None and len(timing.values) == 3

    bench.until(fly)
    values = {pair.key: float(pair.value) for pair in status["fault_observer: timing"].values}
    assert values["rate_hz"] > 1.0
    assert values["latency_max_ms"] >= values["latency_ms"] >= 200.0
    bench.until(lambda: status["fault_observer: timing"].message == "no samples")
    said = status["fault_observer: timing"]
    assert (said.message, said.values[0].value) == ("no samples", "0.0")


class Follower(GraphNode):
    """Notes the torques that it takes."""

    def __init__(self, **kwargs):
        super().__init__("plant", **kwargs)
        self.seen = []
        self.limits = limits_of(load_vehicle("qball_x4"))
        self.publishes("plant/attitude")
        self.reads("torque/command", lambda stamp_ns, torque: self.seen.append(stamp_ns), decode=vector_of)
        self.ready()


@pytest.mark.parametrize("frame", ["", "base_link", "uav1/base_link"])
def test_frame_of_the_table_of_any_vehicle_or_none_is_taken(bench, frame):
    node, send = bench.run(Follower), bench.talk("torque/command")
    bench.connect()
    send(vector_message(SECOND, frame=frame))
    bench.until(lambda: node.seen == [SECOND])
    assert not node.diagnostics.counts


def test_vector_in_another_frame_is_refused_and_counted(bench):
    node, send = bench.run(Follower), bench.talk("torque/command")
    bench.connect()
    send(vector_message(SECOND, frame="map"))
    send(vector_message(2 * SECOND, frame="base_link"))
    bench.until(lambda: node.seen == [2 * SECOND])
    assert node.diagnostics.counts == {"torque/command: frame_id is not base_link": 1}


def test_imu_is_used_whatever_its_driver_calls_its_frame_and_that_is_counted(bench):
    node, send = bench.run(Counter), bench.talk("imu/data")
    bench.connect()
    message = imu_message(SECOND)
    message.header.frame_id = "fcu"
    send(message)
    bench.until(lambda: node.seen == [SECOND])
    assert node.diagnostics.counts == {"imu/data: frame_id is not imu_link, used all the same": 1}


@pytest.mark.parametrize("use_sim_time", [False, True])
def test_connections_are_told_whatever_the_clock(bench, use_sim_time):
    status = bench.watch_diagnostics()
    bench.run(Counter, use_sim_time=use_sim_time)
    bench.until(lambda: "fault_observer: connections" in status)
    said = status["fault_observer: connections"]
    assert said.level == DiagnosticStatus.WARN
    assert "imu/data: 0 of 1 publishers" in said.message
    assert "imu/corrected: 0 of 2 readers" in said.message
    bench.talk("imu/data")
    for _ in range(2):
        bench.listen("imu/corrected")
    bench.until(lambda: status["fault_observer: connections"].message == "all connected")
    assert status["fault_observer: connections"].level == DiagnosticStatus.OK


def test_namespace_is_in_names_of_topics_services_and_diagnostics():
    with NodeBench("realtime", namespace="fleet/uav3") as bench:
        node = bench.run(Counter)
        status = bench.watch_diagnostics()
        bench.until(lambda: "fleet/uav3/fault_observer: connections" in status)
        assert status["fleet/uav3/fault_observer: connections"].hardware_id == "fleet/uav3"
        topics = {
            name for name, _ in node.get_publisher_names_and_types_by_node("fault_observer", "/fleet/uav3")
        }
        services = {
            name for name, _ in node.get_service_names_and_types_by_node("fault_observer", "/fleet/uav3")
        }
    assert "/fleet/uav3/imu/corrected" in topics
    assert "/fleet/uav3/fault_observer/reset" in services


def test_missing_connections_counts_the_table_and_the_recorders():
    counts = {"imu/data": 1, "imu/corrected": 2}
    assert missing_connections("fault_observer", counts) == []
    assert missing_connections("fault_observer", counts, recorders=1) == ["imu/corrected: 2 of 3 readers"]


def test_topic_with_a_second_publisher_is_crowded():
    for plant, table in GRAPHS.items():
        alone = {name: len(row.publishers) for name, row in table.items()}
        assert crowded_topics(alone.__getitem__, plant) == []
        doubled = {**alone, "imu/data": 2, "/diagnostics": 50}
        assert crowded_topics(doubled.__getitem__, plant) == ["imu/data has 2 publishers"]


@pytest.mark.parametrize(
    ("plant", "missing"),
    [
        ("test_stand", ["torque/command: 0 of 3 readers"]),
        ("free_flight", ["rotors/command: 0 of 2 readers", "torque/command: 0 of 1 readers"]),
    ],
)
def test_controller_is_connected_as_its_kind_of_plant_wants(plant, missing):
    counts = {"attitude/reference": 1, "rotors/command": 0, "torque/command": 0}
    assert missing_connections("controller", counts, plant=plant) == missing


def test_mode_is_one_of_two(bench):
    with pytest.raises(ValueError, match="mode = 'fast': expected one of lockstep, realtime"):
        bench.run(Counter, mode="fast")
