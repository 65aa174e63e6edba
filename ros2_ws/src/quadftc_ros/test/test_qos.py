"""Quality of service: both ends of every topic fit, also those of a real vehicle's drivers."""

import pytest
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_profile_sensor_data,
)

from quadftc_ros.qos import service_profile, topic_profile
from quadftc_ros.topics import GRAPHS, NODES, OPTIONAL_NODES, TOPICS

MODES = ("realtime", "lockstep")
CLASSES = ("sensor", "reliable", "latched", "clock")


def fit(offered, wanted):
    return qos_check_compatible(offered, wanted)[0] != QoSCompatibility.ERROR


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", CLASSES)
def test_publisher_and_subscriber_of_a_class_fit(mode, kind):
    profile = topic_profile(kind, mode)
    assert fit(profile, profile)


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_imu_of_any_driver_is_heard_in_real_time(reliability):
    driver = QoSProfile(depth=1, reliability=reliability)
    assert fit(driver, topic_profile("sensor", "realtime"))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", CLASSES)
def test_who_reads_sensor_data_hears_every_class(mode, kind):
    assert fit(topic_profile(kind, mode), qos_profile_sensor_data)


def test_a_best_effort_publisher_would_not_be_heard_in_lockstep():
    driver = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    assert not fit(driver, topic_profile("sensor", "lockstep"))


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
