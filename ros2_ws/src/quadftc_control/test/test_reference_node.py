"""The reference node: a reference for every sample, from the scenario or from live setpoints."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from message_objects import reference_of
from node_bench import imu_message, vector_message
from quadftc_control.reference_node import ReferenceNode
from quadftc_ros.conversions import stamp_of

FIRST_NS = 1_000_000_000
PERIOD_NS = 10_000_000
RAMP = "step angles=0.1,0,0 start=0.05s rise=0.1s"


class Source:
    """A reference node with samples to give it time, and what comes out."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(ReferenceNode, **parameters)
        self.send = bench.talk("imu/data")
        self.found = bench.listen("attitude/reference")
        self.status = bench.watch_diagnostics()
        self.wish = bench.talk("attitude/setpoint") if parameters.get("source") == "topic" else None
        bench.connect()
        self.sent = 0

    def step(self, count=1):
        for _ in range(count):
            before = len(self.found)
            self.send(imu_message(FIRST_NS + self.sent * PERIOD_NS))
            self.sent += 1
            self.bench.until(lambda seen=before: len(self.found) > seen)

    def angles(self):
        return np.array([reference_of(message).angles for message in self.found])


def test_scenario_is_followed_from_the_first_sample_on(lockstep_bench):
    source = Source(lockstep_bench, references=[RAMP])
    source.step(30)
    roll = source.angles()[:, 0]
    np.testing.assert_allclose(roll[[0, 5, 10, 15, 29]], [0.0, 0.0, 0.05, 0.1, 0.1], atol=1e-12)
    rate = reference_of(source.found[10]).rates[0]
    assert rate == pytest.approx((roll[11] - roll[9]) / 0.02, rel=0.05)
    assert [stamp_of(m) for m in source.found] == [FIRST_NS + k * PERIOD_NS for k in range(30)]
    assert source.found[0].header.frame_id == "map"


def test_without_references_it_is_level_and_still(lockstep_bench):
    source = Source(lockstep_bench)
    source.step(2)
    assert all(np.all(part == 0.0) for m in source.found for part in reference_of(m))


def test_reset_and_a_new_flight_begin_the_scenario_anew(lockstep_bench):
    source = Source(lockstep_bench, references=[RAMP])
    source.step(20)
    assert lockstep_bench.call(Trigger, "reference/reset").success
    source.step(20)
    np.testing.assert_array_equal(source.angles()[:20], source.angles()[20:])
    source.sent = 0
    source.step(20)
    np.testing.assert_array_equal(source.angles()[:20], source.angles()[40:])


def test_live_setpoint_is_reached_smoothly(lockstep_bench):
    source = Source(lockstep_bench, source="topic", **{"setpoint.bandwidth": 10.0})
    source.step()
    source.wish(vector_message(1, (0.2, -0.1, 0.3)))
    lockstep_bench.until(lambda: source.step() or source.angles()[-1][0] > 0.0)
    source.step(200)
    np.testing.assert_allclose(source.angles()[-1], [0.2, -0.1, 0.3], atol=1e-3)
    assert np.max(np.abs(np.diff(source.angles(), axis=0))) < 0.02  # no jump
    source.wish(vector_message(2))
    last = source.angles()[-1][0]
    lockstep_bench.until(lambda: source.step() or source.angles()[-1][0] < last - 0.01)


@pytest.mark.parametrize("bad", [(math.nan, 0.0, 0.0), (0.0, 1.5, 0.0), (-math.inf, 0.0, 0.0)])
def test_setpoint_that_makes_no_sense_is_refused_and_counted(lockstep_bench, bad):
    source = Source(lockstep_bench, source="topic")
    source.step()
    source.wish(vector_message(1, bad))
    lockstep_bench.until(lambda: source.step() or "reference: samples" in source.status)
    lockstep_bench.until(
        lambda: source.step() or source.status["reference: samples"].level == DiagnosticStatus.WARN
    )
    source.step(20)
    np.testing.assert_array_equal(source.angles(), np.zeros_like(source.angles()))


def test_setpoints_are_not_listened_to_unless_asked_for(lockstep_bench):
    source = Source(lockstep_bench)
    source.step()
    assert source.node.count_subscribers("attitude/setpoint") == 0
    said = lockstep_bench.watch_diagnostics()
    lockstep_bench.until(lambda: source.step() or "reference: source" in said)
    assert said["reference: source"].message == "scenario"
