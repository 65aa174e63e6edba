"""Quality of service: who may lose messages, who reads late, and the table of topics."""

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import GRAPHS, NODES, OPTIONAL_NODES, TOPICS

CLASSES = ("sensor", "reliable", "latched", "clock")


@pytest.mark.parametrize("kind", CLASSES)
def test_lockstep_loses_nothing(kind):
    assert topic_profile(kind, "lockstep").reliability == ReliabilityPolicy.RELIABLE


def test_only_sensors_and_clock_may_lose_messages_in_real_time():
    lossy = {
        kind
        for kind in CLASSES
        if topic_profile(kind, "realtime").reliability == ReliabilityPolicy.BEST_EFFORT
    }
    assert lossy == {"sensor", "clock"}


def test_only_what_is_latched_reaches_late_readers():
    kept = {
        kind
        for kind in CLASSES
        if topic_profile(kind, "realtime").durability == DurabilityPolicy.TRANSIENT_LOCAL
    }
    assert kept == {"latched"}


def test_service_takes_bursts():
    assert service_profile().depth >= 200


def test_table_names_nodes_of_the_graph_only():
    for plant, table in GRAPHS.items():
        named = {node for row in table.values() for node in (*row.publishers, *row.readers)}
        assert named == {*NODES[plant], *OPTIONAL_NODES}


def test_graphs_differ_in_nothing_but_nodes_and_topics():
    for table in GRAPHS.values():
        for name, row in table.items():
            assert (row.type_name, row.qos, row.frame) == (
                TOPICS[name].type_name,
                TOPICS[name].qos,
                TOPICS[name].frame,
            )


def test_every_topic_of_a_graph_is_read_from_who_publishes_it():
    from_outside = {"imu/data_raw", "imu/mag", "mocap/pose", "attitude/setpoint", "position/setpoint"}
    from_outside |= {"imu/static_pressure"}  # or, as imu/mag, from a plant that has such a sensor
    for table in GRAPHS.values():
        unpublished = {name for name, row in table.items() if not row.publishers}
        assert unpublished <= from_outside


def test_every_topic_but_the_common_ones_follows_the_namespace():
    assert {name for name in TOPICS if name.startswith("/")} == {"/diagnostics", "/clock"}
