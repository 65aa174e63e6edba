"""/diagnostics of a node: names, levels, once a second of the stamps, at once on a change, never a flood."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from node_bench import NodeBench
from quadftc_ros.conversions import stamp_of
from quadftc_ros.diagnostics import OK, WARN, Diagnostics, SampleTiming
from quadftc_ros.qos import topic_profile

SECOND = 1_000_000_000  # ns
PERIOD = SECOND // 100


class Talker:
    """A node's diagnostics, and all messages of it."""

    def __init__(self, bench):
        self.bench = bench
        self.refreshed = 0
        self.messages = bench.listen("/diagnostics")
        # the tester speaks for itself: it is as good a node as any
        self.diagnostics = Diagnostics(bench.tester, "uav7", self.refresh)
        bench.connect()

    def refresh(self):
        self.refreshed += 1

    def wait(self, count):
        self.bench.until(lambda: len(self.messages) >= count)
        assert len(self.messages) == count
        return {status.name: status for status in self.messages[-1].status}


@pytest.fixture
def talker():
    with NodeBench("lockstep", namespace="fleet/uav7") as bench:
        yield Talker(bench)


def test_status_has_node_part_hardware_level_and_values(talker):
    talker.diagnostics.report("battery", WARN, "low", volts=11.1, cells=3)
    talker.diagnostics.publish(3 * SECOND)
    found = talker.wait(1)
    assert set(found) == {"fleet/uav7/tester: battery", "fleet/uav7/tester: samples"}
    status = found["fleet/uav7/tester: battery"]
    assert (status.hardware_id, status.level, status.message) == ("uav7", DiagnosticStatus.WARN, "low")
    assert {pair.key: pair.value for pair in status.values} == {"volts": "11.1", "cells": "3"}
    assert stamp_of(talker.messages[0]) == 3 * SECOND
    assert talker.refreshed == 1


def test_messages_come_once_a_second_of_the_stamps(talker):
    for stamp in range(SECOND, 4 * SECOND + PERIOD, PERIOD):
        talker.diagnostics.report("law", OK, "steps", step=stamp)
        talker.diagnostics.tick(stamp)
    talker.wait(4)
    assert [stamp_of(message) for message in talker.messages] == [k * SECOND for k in (1, 2, 3, 4)]


def test_change_of_level_or_words_is_told_at_once(talker):
    said = [(OK, "flying"), (OK, "flying"), (WARN, "flying"), (WARN, "limping"), (WARN, "limping")]
    for index, (level, words) in enumerate(said):
        talker.diagnostics.report("law", level, words)
        talker.diagnostics.tick(SECOND + index * PERIOD)
    talker.wait(3)
    assert [stamp_of(message) for message in talker.messages] == [SECOND + k * PERIOD for k in (0, 2, 3)]


def test_first_thing_counted_is_told_at_once_and_the_rest_once_a_second(talker):
    for stamp in range(SECOND, 4 * SECOND, PERIOD):
        if stamp >= SECOND + PERIOD:
            talker.diagnostics.count("bad sample")
        talker.diagnostics.tick(stamp)
    found = talker.wait(4)
    assert [stamp_of(message) for message in talker.messages] == [
        SECOND,
        SECOND + PERIOD,
        2 * SECOND + PERIOD,
        3 * SECOND + PERIOD,
    ]
    status = found["fleet/uav7/tester: samples"]
    assert status.level == DiagnosticStatus.WARN
    assert {pair.key: int(pair.value) for pair in status.values} == {"bad sample": 201}


def test_warning_of_counted_samples_ends_when_nothing_new_was_counted(talker):
    talker.diagnostics.count("bad sample")
    for stamp in (SECOND, 2 * SECOND, 3 * SECOND):
        talker.diagnostics.tick(stamp)
    talker.wait(3)
    samples = [
        next(status for status in message.status if status.name.endswith("samples"))
        for message in talker.messages
    ]
    assert [status.level for status in samples] == [
        DiagnosticStatus.WARN,
        DiagnosticStatus.OK,
        DiagnosticStatus.OK,
    ]
    assert all({pair.key: pair.value for pair in status.values} == {"bad sample": "1"} for status in samples)


def test_stamps_that_go_back_do_not_silence_it(talker):
    talker.diagnostics.tick(100 * SECOND)
    talker.diagnostics.tick(SECOND)
    talker.wait(2)


def test_two_vehicles_have_names_of_their_own():
    with NodeBench("lockstep", namespace="uav1") as bench:
        status = bench.watch_diagnostics()
        other = Node("tester", context=bench.context, namespace="uav2")
        both = [
            Diagnostics(node, node.get_namespace().strip("/"), lambda: None) for node in (bench.tester, other)
        ]
        bench.until(lambda: bench.tester.count_publishers("/diagnostics") == 2)

        def told():
            for each in both:
                each.publish(SECOND)
            return len(status) == 2

        bench.until(told)
        assert set(status) == {"uav1/tester: samples", "uav2/tester: samples"}
        other.destroy_node()


def test_quality_of_service_is_that_of_the_table(talker):
    (offered,) = talker.bench.tester.get_publishers_info_by_topic("/diagnostics")
    assert offered.qos_profile.reliability == topic_profile("reliable", "realtime").reliability


@pytest.mark.parametrize(("age", "late"), [(0.1, False), (1.5, False), (2.5, True)])
def test_samples_that_are_older_than_two_periods_are_late(age, late):
    timing = SampleTiming(clock=True)
    for stamp in range(SECOND, 3 * SECOND, PERIOD):
        timing.sampled(stamp, stamp + round(age * PERIOD))
    values = timing.values(3 * SECOND)
    assert (timing.late, timing.idle) == (late, False)
    assert float(values["latency_ms"]) == pytest.approx(10.0 * age)
    timing.values(5 * SECOND)
    assert (timing.late, timing.idle) == (False, True)
