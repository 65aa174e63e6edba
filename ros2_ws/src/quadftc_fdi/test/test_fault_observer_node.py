"""The fault observer node: an estimate and a corrected sample for every sample, whatever comes in."""

import math
import operator

import numpy as np
import pytest
from accusing_observer import AccusingObserver, registered
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from message_objects import FaultStatusWriter, imu_sample
from node_bench import imu_message, vector_message
from quadftc_fdi.fault_observer_node import RAW_AFTER, FaultObserverNode
from quadftc_model.arrays import where
from quadftc_model.samples import FAULTY, HEALTHY, STARTING, FaultEstimate
from quadftc_ros.conversions import stamp_of
from quadftc_ros.parameters import STAYS

FIRST_NS = 1_000_000_000
PERIOD_NS = 4_000_000
OUTPUTS = ("imu/corrected", "fault/estimate", "fault/status")


def values_of(status):
    return {pair.key: pair.value for pair in status.values}


class Observer:
    """An observer with the sources it reads and all that comes out of it."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(FaultObserverNode, **{"observer": "sliding_mode", **parameters})
        self.send = bench.talk("imu/data")
        self.command = bench.talk("torque/command")
        self.found = {topic: bench.listen(topic) for topic in OUTPUTS}
        self.status = bench.watch_diagnostics()
        bench.connect()
        self.sent = 0

    @property
    def stamp_ns(self):
        return FIRST_NS + self.sent * PERIOD_NS

    def step(self, *angles, torque=(0.0, 0.0, 0.0), message=None):
        """Send a sample; wait for all that it brings about, then command a torque for it."""
        counts = {topic: len(messages) for topic, messages in self.found.items()}
        stamp_ns = self.stamp_ns
        self.sent += 1
        self.send(imu_message(stamp_ns, angles or (0.0, 0.0, 0.0)) if message is None else message)
        self.bench.until(lambda: all(len(self.found[topic]) > count for topic, count in counts.items()))
        self.command(vector_message(stamp_ns, torque))

    def estimate(self):
        found = self.found["fault/estimate"][-1].vector
        return [found.x, found.y, found.z]

    def counted(self):
        """What the diagnostics have counted, once that is told."""
        self.bench.until(lambda: "fault_observer: samples" in self.status)
        self.bench.until(lambda: self.status["fault_observer: samples"].level == DiagnosticStatus.WARN)
        return {pair.key: int(pair.value) for pair in self.status["fault_observer: samples"].values}


def test_outputs_have_the_stamp_of_the_sample_and_their_frames(lockstep_bench):
    observer = Observer(lockstep_bench)
    for _ in range(3):
        observer.step()
    wanted = [FIRST_NS + k * PERIOD_NS for k in range(3)]
    assert [[stamp_of(m) for m in observer.found[topic]] for topic in OUTPUTS] == [wanted] * 3
    frames = [observer.found[topic][0].header.frame_id for topic in OUTPUTS]
    assert frames == ["imu_link", "map", "imu_link"]


def test_fault_is_estimated_and_taken_off_the_sample(lockstep_bench):
    observer = Observer(lockstep_bench)
    for k in range(100):
        observer.step(0.02 if k >= 50 else 0.0, 0.0, 0.0)
    assert observer.estimate() == pytest.approx([0.02, 0.0, 0.0], abs=1e-3)
    corrected = imu_sample(observer.found["imu/corrected"][-1])
    np.testing.assert_allclose(corrected.q_xyzw, [0.0, 0.0, 0.0, 1.0], atol=1e-3)
    estimate = observer.found["fault/status"][-1].estimate
    assert [estimate.x, estimate.y, estimate.z] == observer.estimate()


def test_without_diagnosis_the_sample_passes_bit_for_bit(lockstep_bench):
    observer = Observer(lockstep_bench, observer="none")
    message = imu_message(FIRST_NS, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0))
    observer.step(message=message)
    assert observer.found["imu/corrected"] == [message]
    assert observer.estimate() == [0.0, 0.0, 0.0]


def test_lockstep_waits_for_the_torque_of_the_sample_before(lockstep_bench):
    observer = Observer(lockstep_bench)
    for k in (0, 1, 2):
        observer.send(imu_message(FIRST_NS + k * PERIOD_NS))
    lockstep_bench.until(lambda: observer.found["fault/estimate"])
    observer.command(vector_message(FIRST_NS))
    lockstep_bench.until(lambda: len(observer.found["fault/estimate"]) == 2)
    observer.command(vector_message(FIRST_NS + PERIOD_NS))
    lockstep_bench.until(lambda: len(observer.found["fault/estimate"]) == 3)
    assert [stamp_of(m) for m in observer.found["fault/estimate"]] == [
        FIRST_NS + k * PERIOD_NS for k in (0, 1, 2)
    ]


BROKEN = {  # parts of a sample that cannot be used: where each is in the message, and what stands there
    "attitude is no number": ("orientation", "x", math.nan),
    "rate is infinite": ("angular_velocity", "y", math.inf),
    "force is no number": ("linear_acceleration", "z", math.nan),
    "quaternion is zero": ("orientation", "w", 0.0),
    "attitude is absent": ("orientation_covariance", 0, -1.0),
    "rate is absent": ("angular_velocity_covariance", 0, -1.0),
}


def broken(stamp_ns, part):
    """A sample with one part that cannot be used."""
    message = imu_message(stamp_ns, (0.0, 0.0, 0.0))
    field, place, value = BROKEN[part]
    (setattr if isinstance(place, str) else operator.setitem)(getattr(message, field), place, value)
    return message


@pytest.mark.parametrize("name", ["sliding_mode", "none"])
@pytest.mark.parametrize("part", BROKEN)
@pytest.mark.parametrize("first", [0, 5])
def test_no_number_that_is_none_ever_leaves(lockstep_bench, name, part, first):
    observer = Observer(lockstep_bench, observer=name)
    for k in range(10):
        observer.step(message=broken(observer.stamp_ns, part) if first <= k < first + 3 else None)
    for topic in OUTPUTS:
        assert len(observer.found[topic]) == 10
    for message in observer.found["imu/corrected"]:
        sample = imu_sample(message)
        assert np.all(np.isfinite(np.concatenate(sample[:3])))
        assert np.linalg.norm(sample.q_xyzw) == pytest.approx(1.0, abs=1e-9)
    for message in observer.found["fault/estimate"]:
        assert np.all(np.isfinite([message.vector.x, message.vector.y, message.vector.z]))


def test_unusable_body_rate_is_counted(lockstep_bench):
    observer = Observer(lockstep_bench)
    observer.step()
    observer.step(message=broken(observer.stamp_ns, "rate is absent"))
    observer.step()
    assert observer.counted() == {"imu/data: body rate absent or unusable": 1}


def test_torque_that_is_no_number_is_counted_and_does_no_harm(lockstep_bench):
    observer = Observer(lockstep_bench)
    for _ in range(5):
        observer.step(torque=(math.nan, 0.0, 0.0))
    assert np.all(np.isfinite(observer.estimate()))
    assert set(observer.counted()) == {"torque/command: not finite"}


def test_stamp_that_repeats_or_goes_back_is_refused_and_counted_in_real_time(bench):
    observer = Observer(bench)
    for _ in range(3):
        observer.step()
    for stamp_ns in (FIRST_NS + 2 * PERIOD_NS, FIRST_NS):
        observer.send(imu_message(stamp_ns))
    assert observer.counted()["imu/data: stamp repeated or went back"] >= 1
    observer.step()
    assert [stamp_of(m) for m in observer.found["fault/estimate"]] == [
        FIRST_NS + k * PERIOD_NS for k in range(4)
    ]


def test_stamps_that_go_back_in_lockstep_begin_a_new_flight(lockstep_bench):
    observer = Observer(lockstep_bench)
    for _ in range(2):
        observer.sent = 0
        for k in range(10):
            observer.step(0.01 * (k > 3), 0.0, 0.0)
    estimates = observer.found["fault/estimate"]
    assert estimates[:10] == estimates[10:]
    assert max(abs(message.vector.x) for message in estimates) > 0.0


def test_reset_forgets_what_was_estimated(lockstep_bench):
    observer = Observer(lockstep_bench)
    for k in range(30):
        observer.step(0.02 * (k > 10), 0.0, 0.0)
    assert abs(observer.estimate()[0]) > 0.015
    assert lockstep_bench.call(Trigger, "fault_observer/reset").success
    observer.step(0.02, 0.0, 0.0)  # to which it restarts
    assert observer.estimate() == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_parameters_of_the_chosen_observer_are_described_and_live(lockstep_bench):
    observer = Observer(lockstep_bench)
    described = lockstep_bench.describe("fault_observer", "sliding_mode.L2")
    assert described.description.endswith("[1/s]")
    assert described.floating_point_range[0].from_value == 0.0
    before = lockstep_bench.get_parameter("fault_observer", "sliding_mode.L2")
    for k in range(20):
        observer.step(0.02 * (k > 10), 0.0, 0.0)
    assert lockstep_bench.set_parameter("fault_observer", "sliding_mode.L2", 2.0 * before).successful
    assert lockstep_bench.get_parameter("fault_observer", "sliding_mode.L2") == 2.0 * before
    kept = observer.estimate()[0]
    observer.step(0.02, 0.0, 0.0)
    assert observer.estimate()[0] == pytest.approx(kept, abs=5e-3)  # it goes on, it does not restart


def test_parameter_out_of_range_is_refused_with_the_bound(lockstep_bench):
    Observer(lockstep_bench)
    before = lockstep_bench.get_parameter("fault_observer", "sliding_mode.L2")
    result = lockstep_bench.set_parameter("fault_observer", "sliding_mode.L2", -1.0)
    assert not result.successful
    assert "sliding_mode.L2" in result.reason
    assert "Min: 0" in result.reason
    assert lockstep_bench.get_parameter("fault_observer", "sliding_mode.L2") == before


def test_observer_stays_in_lockstep(lockstep_bench):
    Observer(lockstep_bench)
    refusal = lockstep_bench.set_parameter("fault_observer", "observer", "none")
    assert (refusal.successful, refusal.reason) == (False, f"observer: {STAYS}")


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"observer": "sliding_mod"}, "sliding_mod.*sliding_mode"),
        ({"sliding_mode.L2": -1.0}, r"sliding_mode.L2 = -1.0 1/s: must be within \[0, inf\]"),
        ({"vehicle": "/nowhere.toml"}, "/nowhere.toml"),
    ],
)
def test_wrong_parameter_is_refused_by_name(bench, wrong, text):
    with pytest.raises(ValueError, match=text):
        bench.run(FaultObserverNode, **{"observer": "sliding_mode", **wrong})


def test_diagnostics_name_the_observer(bench):
    Observer(bench, observer="supervised")
    status = bench.watch_diagnostics()
    bench.until(lambda: "fault_observer: observer" in status)
    said = status["fault_observer: observer"]
    assert (said.message, said.level, said.hardware_id) == ("supervised", DiagnosticStatus.OK, "vehicle")
    assert "fault_observer: connections" in status


def test_diagnostics_tell_the_fault_of_each_axis(lockstep_bench):
    observer = Observer(lockstep_bench, observer="supervised")
    for k in range(1300):  # of which two seconds to get ready
        observer.step(0.02 if k >= 700 else 0.0, 0.0, 0.0)
    roll, pitch = (f"fault_observer: attitude fault {axis}" for axis in ("roll", "pitch"))
    lockstep_bench.until(lambda: observer.status[roll].message == "faulty")
    lockstep_bench.until(lambda: float(values_of(observer.status[roll])["age_s"]) > 1.0)
    values = values_of(observer.status[roll])
    assert observer.status[roll].level == DiagnosticStatus.WARN
    assert float(values["size_deg"]) == pytest.approx(math.degrees(0.02), abs=0.1)
    assert 0.0 < float(values["sigma_deg"]) < 0.5
    assert observer.status[pitch].level == DiagnosticStatus.OK
    assert "age_s" not in values_of(observer.status[pitch])


@pytest.fixture
def accused(lockstep_bench):
    """An observer that says of each sensor what is wrong with it, and what it has reported."""
    with registered() as name:
        reports = lockstep_bench.listen("diagnosis")
        yield Observer(lockstep_bench, observer=name), reports


def turn(observer, rate, count=1):
    for _ in range(count):
        observer.step(message=imu_message(observer.stamp_ns, body_rate=(0.0, rate, 0.0)))


def test_report_is_published_at_once_on_a_change_and_ten_times_a_second(accused, lockstep_bench):
    observer, reports = accused
    turn(observer, 0.0, 30)  # 0.12 s
    turn(observer, 0.25, 5)
    turn(observer, 0.0, 1)
    lockstep_bench.until(lambda: len(reports) == 4)
    samples_ns = [stamp_of(report) - FIRST_NS for report in reports]
    assert samples_ns == [0, 25 * PERIOD_NS, 30 * PERIOD_NS, 35 * PERIOD_NS]
    assert [len(report.faults) for report in reports] == [0, 0, 1, 0]
    assert reports[2].header.frame_id == "imu_link"
    assert reports[2].watched == ["attitude", "gyro", "accelerometer"]
    (fault,) = reports[2].faults
    assert (fault.component, fault.element, fault.kind, fault.unit) == ("gyro", "y", "offset", "rad/s")
    assert (fault.state, fault.size, fault.std_dev) == (FAULTY, 0.25, 0.025)
    assert fault.ambiguous_with == ["attitude/pitch"]
    assert stamp_of(Header(stamp=fault.onset)) == FIRST_NS + 30 * PERIOD_NS


def test_diagnostics_tell_the_fault_of_each_sensor(accused, lockstep_bench):
    observer, _ = accused
    turn(observer, 0.0)
    gyro, accelerometer = "fault_observer: gyro fault", "fault_observer: accelerometer fault"
    turn(observer, 0.5, 3)
    lockstep_bench.until(lambda: observer.status[gyro].level == DiagnosticStatus.WARN)  # at once
    assert observer.status[gyro].message == "faulty"
    assert values_of(observer.status[gyro])["y_size_deg_s"] == "28.648"
    healthy = observer.status[accelerometer]
    assert (healthy.level, healthy.message, healthy.values) == (DiagnosticStatus.OK, "healthy", [])
    assert observer.status["fault_observer: attitude fault roll"].message == "healthy"


class Endless(AccusingObserver):
    """Says nothing finite of a gyro that reads more than 1 rad/s."""

    def step(self, state, inputs, dt):
        state, estimate = super().step(state, inputs, dt)
        endless = where(abs(inputs.imu.body_rate) > 1.0, np.inf, estimate.fault)
        return state, estimate._replace(fault=endless)


def test_unusable_estimate_is_an_error_for_a_while_and_the_observer_restarts_at_once(lockstep_bench):
    with registered(Endless) as name:
        observer = Observer(lockstep_bench, observer=name)
    turn(observer, 0.0, 3)
    turn(observer, 2.0)
    told = "fault_observer: observer"
    lockstep_bench.until(lambda: observer.status[told].level == DiagnosticStatus.ERROR)
    assert observer.status[told].message == "accusing restarts: its estimate was unusable"
    assert observer.found["fault/status"][-1].state.tolist() == [STARTING] * 3
    turn(observer, 0.0)
    assert observer.found["fault/status"][-1].state.tolist() == [HEALTHY] * 3
    turn(observer, 0.0, 300)  # more than a second
    lockstep_bench.until(lambda: observer.status[told].level == DiagnosticStatus.OK)


def test_observer_of_the_attitude_alone_has_no_status_of_the_gyro(lockstep_bench):
    observer = Observer(lockstep_bench, observer="supervised")
    for _ in range(300):
        observer.step()
    lockstep_bench.until(lambda: "fault_observer: attitude fault roll" in observer.status)
    assert "fault_observer: gyro fault" not in observer.status


def test_without_diagnosis_no_axis_is_called_healthy(lockstep_bench):
    observer = Observer(lockstep_bench, observer="none")
    for _ in range(300):
        observer.step()
    lockstep_bench.until(lambda: "fault_observer: timing" in observer.status)
    assert not [name for name in observer.status if "attitude fault" in name]


def test_observer_without_states_says_so(lockstep_bench):
    observer = Observer(lockstep_bench)
    for _ in range(300):
        observer.step(0.05, 0.0, 0.0)
    lockstep_bench.until(lambda: "fault_observer: attitude fault roll" in observer.status)
    assert observer.status["fault_observer: attitude fault roll"].message == "not judged"
    told = observer.status["fault_observer: observer"]
    assert told.level == DiagnosticStatus.WARN
    assert told.message.startswith("sliding_mode declares no faults")


def test_imu_without_attitude_is_told_what_to_do(lockstep_bench):
    observer = Observer(lockstep_bench, observer="isolating")
    for _ in range(RAW_AFTER + 5):
        observer.step(message=broken(observer.stamp_ns, "attitude is absent"))
    lockstep_bench.until(lambda: "fault_observer: imu" in observer.status)
    told = observer.status["fault_observer: imu"]
    assert told.level == DiagnosticStatus.WARN
    assert "attitude_estimator" in told.message


def test_recommended_observer_is_the_default(bench):
    assert bench.run(FaultObserverNode).get_parameter("observer").value == "bank"


def test_imu_is_read_best_effort_in_real_time(bench):
    node = bench.run(FaultObserverNode)
    readers = node.get_subscriptions_info_by_topic(node.resolve_topic_name("imu/data"))
    assert [reader.qos_profile.reliability for reader in readers] == [ReliabilityPolicy.BEST_EFFORT]


def test_onset_of_a_fault_is_its_time():
    unknown = np.full(3, -1.0)
    sample = imu_sample(imu_message(0))
    estimate = FaultEstimate(
        np.zeros(3),
        unknown,
        np.array([HEALTHY, FAULTY, HEALTHY], np.uint8),
        np.array([-1.0, 0.25, -1.0]),
        sample,
    )
    message = FaultStatusWriter()(3_000_000_000, estimate)
    assert [stamp.sec * 10**9 + stamp.nanosec for stamp in message.onset] == [0, 2_750_000_000, 0]
    assert message.state.tolist() == [HEALTHY, FAULTY, HEALTHY]
    assert [message.std_dev.x, message.std_dev.y, message.std_dev.z] == [-1.0] * 3
