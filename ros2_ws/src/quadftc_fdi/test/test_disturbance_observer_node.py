"""The disturbance observer node: an estimate for every corrected sample, finite whatever comes in."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from node_bench import imu_message, vector_message
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_ros.conversions import stamp_of

FIRST_NS = 1_000_000_000
PERIOD_NS = 4_000_000
PUSH = 0.5  # rad/s², a constant disturbance in roll


class Observer:
    """An observer with the sources it reads and what comes out of it."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(DisturbanceObserverNode, **parameters)
        self.send = bench.talk("imu/corrected")
        self.command = bench.talk("torque/command")
        self.found = bench.listen("disturbance/estimate")
        self.status = bench.watch_diagnostics()
        bench.connect()
        self.sent = 0

    def step(self, rate=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0)):
        """Send a sample; wait for the estimate, then command a torque."""
        count, stamp_ns = len(self.found), FIRST_NS + self.sent * PERIOD_NS
        self.sent += 1
        self.send(imu_message(stamp_ns, body_rate=rate))
        self.bench.until(lambda: len(self.found) > count)
        self.command(vector_message(stamp_ns, torque))

    def fall(self, count):
        """Samples of a vehicle that a constant disturbance turns."""
        for _ in range(count):
            self.step((PUSH * self.sent * PERIOD_NS * 1e-9, 0.0, 0.0))

    def estimates(self):
        return np.array([[m.vector.x, m.vector.y, m.vector.z] for m in self.found])


def test_constant_disturbance_is_estimated_with_the_stamp_of_the_sample(lockstep_bench):
    observer = Observer(lockstep_bench, **{"exosystem.bandwidth": 50.0})
    observer.fall(150)
    np.testing.assert_allclose(observer.estimates()[-1], [PUSH, 0.0, 0.0], atol=0.02)
    assert [stamp_of(m) for m in observer.found] == [FIRST_NS + k * PERIOD_NS for k in range(150)]
    assert observer.found[0].header.frame_id == "base_link"


def test_observer_none_estimates_zero(lockstep_bench):
    observer = Observer(lockstep_bench, observer="none", frame_prefix="uav1/")
    observer.fall(5)
    assert observer.found[0].header.frame_id == "uav1/base_link"
    np.testing.assert_array_equal(observer.estimates(), np.zeros((5, 3)))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_no_number_that_is_none_ever_leaves(lockstep_bench, bad):
    observer = Observer(lockstep_bench)
    observer.step((bad, 0.0, 0.0))
    observer.step(torque=(0.0, bad, 0.0))
    observer.step((0.0, bad, bad))
    observer.fall(260)  # for more than a second: what is counted after the first is said with the next report
    assert np.all(np.isfinite(observer.estimates()))
    lockstep_bench.until(lambda: len(counted(observer)) > 1)
    assert counted(observer) == {
        "torque/command: not finite": "1",
        "imu/corrected: body rate absent or unusable": "2",
    }


def counted(observer):
    """What the node says it refused, by reason."""
    there = observer.status.get("disturbance_observer: samples")
    return {} if there is None else {pair.key: pair.value for pair in there.values}


def test_reset_starts_anew_and_so_does_a_new_flight(lockstep_bench):
    observer = Observer(lockstep_bench)
    observer.fall(20)
    assert lockstep_bench.call(Trigger, "disturbance_observer/reset").success
    observer.step((PUSH * observer.sent * PERIOD_NS * 1e-9, 0.0, 0.0))
    assert abs(observer.estimates()[-2][0]) > 1e-3
    np.testing.assert_allclose(observer.estimates()[-1], 0.0, atol=1e-9)
    observer.sent = 0
    observer.fall(20)
    np.testing.assert_array_equal(observer.estimates()[:20], observer.estimates()[21:])


def test_stamp_that_repeats_is_refused_in_real_time(bench):
    observer = Observer(bench)
    observer.fall(3)
    observer.send(imu_message(FIRST_NS))
    bench.until(lambda: "disturbance_observer: samples" in observer.status)
    bench.until(lambda: observer.status["disturbance_observer: samples"].level == DiagnosticStatus.WARN)
    observer.step()
    assert [stamp_of(m) for m in observer.found] == [FIRST_NS + k * PERIOD_NS for k in range(4)]


def test_parameters_change_in_flight_and_bad_ones_are_refused(lockstep_bench):
    observer = Observer(lockstep_bench)
    observer.fall(2)
    assert lockstep_bench.set_parameter("disturbance_observer", "exosystem.bandwidth", 20.0).successful
    refused = lockstep_bench.set_parameter("disturbance_observer", "exosystem.bandwidth", -1.0)
    assert not refused.successful
    assert "exosystem.bandwidth" in refused.reason
    assert lockstep_bench.get_parameter("disturbance_observer", "exosystem.bandwidth") == 20.0
    observer.fall(2)


def test_wrong_parameter_is_refused_by_name(bench):
    with pytest.raises(ValueError, match=r"exosystem.model = 'constnt': expected one of constant"):
        bench.run(DisturbanceObserverNode, **{"exosystem.model": "constnt"})
