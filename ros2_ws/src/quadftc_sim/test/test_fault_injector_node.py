"""The fault injector node: faults by schedule and by service, the truth about them, and every refusal."""

import math
import re

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from message_objects import imu_sample
from node_bench import imu_message
from quadftc_msgs.srv import ClearFault, InjectFault
from quadftc_ros.conversions import stamp_of
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.injector_ports import MOST_FAULTS

FIRST_NS = 1_000_000_000
PERIOD_NS = 4_000_000
ANGLES = (0.1, -0.2, 0.3)  # rad
RATE = (0.01, 0.02, 0.03)  # rad/s
BIAS = {"kind": "bias", "channel": "attitude", "parameter_names": ["value"], "parameter_values": [0.01]}
TRUTH = ("fault/injected", "fault/injected/gyro", "fault/injected/accelerometer")


class Injector:
    """An injector with a source of samples and all that comes out of it."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(FaultInjectorNode, **parameters)
        self.send = bench.talk("plant/imu")
        self.imu = bench.listen("imu/data")
        self.truth = {topic: bench.listen(topic) for topic in TRUTH}
        self.dropped = bench.listen("fault/dropped")
        self.status = bench.watch_diagnostics()
        bench.connect()
        self.sent = 0

    def step(self, count=1):
        """Send samples; wait until each was delivered or withheld."""
        for _ in range(count):
            answered = len(self.imu) + len(self.dropped)
            told = len(self.truth["fault/injected"])
            self.send(imu_message(FIRST_NS + self.sent * PERIOD_NS, ANGLES, RATE))
            self.sent += 1
            self.bench.until(
                lambda before=answered, said=told: (
                    len(self.imu) + len(self.dropped) > before and len(self.truth["fault/injected"]) > said
                )
            )

    def inject(self, **fields):
        return self.bench.call(InjectFault, "fault_injector/inject", **fields)

    def clear(self, number=0):
        return self.bench.call(ClearFault, "fault_injector/clear", id=number)

    def injected(self, topic="fault/injected"):
        found = self.truth[topic][-1].vector
        return [found.x, found.y, found.z]


@pytest.fixture
def injector(lockstep_bench):
    return Injector(lockstep_bench)


def test_without_faults_a_sample_passes_bit_for_bit(injector):
    injector.step()
    assert injector.imu == [imu_message(FIRST_NS, ANGLES, RATE)]
    assert injector.injected() == [0.0, 0.0, 0.0]
    assert stamp_of(injector.truth["fault/injected"][0]) == FIRST_NS
    assert injector.truth["fault/injected"][0].header.frame_id == "map"


def test_injected_bias_is_on_the_sample_and_on_the_truth(injector):
    injector.step()
    answer = injector.inject(**BIAS, axes=["roll"])
    assert (answer.success, answer.id) == (True, 1)
    injector.step()
    assert injector.injected() == pytest.approx([0.01, 0.0, 0.0], abs=1e-12)
    faulty = imu_sample(injector.imu[-1])
    np.testing.assert_allclose(
        faulty.q_xyzw, imu_sample(imu_message(0, (ANGLES[0] + 0.01, *ANGLES[1:]))).q_xyzw, atol=1e-12
    )
    np.testing.assert_array_equal(faulty.body_rate, RATE)


@pytest.mark.parametrize(
    ("channel", "topic", "axes", "truth", "frame"),
    [
        ("gyro", "fault/injected/gyro", ["y"], [0.0, 0.5, 0.0], "imu_link"),
        ("accelerometer", "fault/injected/accelerometer", [], [0.5, 0.5, 0.5], "imu_link"),
    ],
)
def test_fault_of_another_channel_has_its_own_truth(injector, channel, topic, axes, truth, frame):
    request = {**BIAS, "channel": channel, "axes": axes, "parameter_values": [0.5]}
    assert injector.inject(**request).success
    injector.step()
    injector.bench.until(lambda: injector.truth[topic])
    assert injector.injected(topic) == pytest.approx(truth, abs=1e-12)
    assert injector.truth[topic][-1].header.frame_id == frame
    assert injector.injected() == [0.0, 0.0, 0.0]


def test_fault_acts_from_its_start_for_its_duration(injector):
    injector.step(3)
    assert injector.inject(**BIAS, start=0.008, duration=0.012).success
    injector.step(8)
    rolls = [message.vector.x for message in injector.truth["fault/injected"]]
    # asked at 0.008 s of scenario time: from 0.016 s (sample 4) up to, not including, 0.028 s (sample 7)
    assert np.flatnonzero(np.array(rolls) > 0.005).tolist() == [4, 5, 6]


def test_scheduled_faults_act_on_scenario_time(lockstep_bench):
    injector = Injector(lockstep_bench, faults=["bias axes=yaw value=0.02 start=0.008s stop=0.016s", ""])
    injector.step(6)
    yaws = [round(message.vector.z, 12) for message in injector.truth["fault/injected"]]
    assert yaws == [0.0, 0.0, 0.02, 0.02, 0.0, 0.0]


def test_whole_sample_dropped_is_announced_and_not_delivered(injector):
    injector.step()
    assert injector.inject(kind="dropout", channel="imu", duration=0.008).success
    injector.step(3)
    assert [stamp_of(message) for message in injector.dropped] == [FIRST_NS + k * PERIOD_NS for k in (1, 2)]
    assert [stamp_of(message) for message in injector.imu] == [FIRST_NS + k * PERIOD_NS for k in (0, 3)]
    assert len(injector.truth["fault/injected"]) == 4  # the truth is told of withheld samples, too


@pytest.mark.parametrize(
    ("request_fields", "reason"),
    [
        ({"kind": "bais"}, "bais.*bias"),
        ({"kind": ""}, "fault"),
        ({"kind": "loss", "axes": ["1"]}, "channel = 'rotor': only in free flight"),
        ({**BIAS, "duration": math.nan}, "duration = nan s: must not be negative"),
        ({**BIAS, "start": math.nan}, "start: nan: expected a number in s, not NaN"),
        ({**BIAS, "start": math.inf}, "must be"),
        ({**BIAS, "parameter_values": []}, "parameter_values: 0 numbers for 1 parameter_names"),
        ({**BIAS, "parameter_values": [1.0, 2.0]}, "parameter_values: 2 numbers for 1 parameter_names"),
        ({**BIAS, "parameter_names": ["valeu"]}, "valeu: unknown parameter .did you mean 'value'"),
        ({**BIAS, "parameter_names": ["stop"]}, "parameter_names: stop is a field of the request"),
        (
            {**BIAS, "parameter_names": ["value"] * 2, "parameter_values": [1.0, 2.0]},
            "parameter_names: value is given twice",
        ),
        ({**BIAS, "parameter_values": [math.nan]}, "value: nan: expected a number in rad, not NaN"),
    ],
)
def test_injection_that_cannot_be_done_is_answered_with_the_reason(injector, request_fields, reason):
    answer = injector.inject(**request_fields)
    assert (answer.success, answer.id) == (False, 0)
    assert re.search(reason, answer.message), answer.message
    injector.step()
    assert injector.injected() == [0.0, 0.0, 0.0]


def test_as_many_injections_at_once_as_a_sample_has_time_for_are_accepted_and_act(injector):
    injector.step()
    requests = [{**BIAS, "axes": ["roll"], "parameter_values": [0.001 * (k + 1)]} for k in range(200)]
    answers = injector.bench.call_all(InjectFault, "fault_injector/inject", requests)
    refused = answers[MOST_FAULTS:]
    assert {each.message for each in refused} == {"64 faults wait or act; at most 64 at a time: clear one"}
    assert not any(each.success for each in refused)
    answers = answers[:MOST_FAULTS]
    assert all(answer.success for answer in answers)
    assert {answer.id for answer in answers} == set(range(1, 65))
    injector.step()
    assert injector.injected()[0] == pytest.approx(np.angle(np.exp(1j * 0.001 * 64 * 65 / 2)), abs=1e-9)
    for number, answer in enumerate(answers[:10]):
        before = injector.injected()[0]
        assert injector.clear(answer.id).success
        injector.step()
        change = np.angle(np.exp(1j * (before - injector.injected()[0])))
        assert change == pytest.approx(0.001 * (number + 1), abs=1e-9)
    assert injector.inject(**BIAS, axes=["roll"]).success


def test_clear_ends_one_fault_or_all(injector):
    first, second = (injector.inject(**BIAS, axes=[axis]).id for axis in ("roll", "pitch"))
    injector.step()
    answer = injector.clear(first)
    assert (answer.success, answer.cleared) == (True, 1)
    injector.step()
    assert injector.injected() == pytest.approx([0.0, 0.01, 0.0], abs=1e-12)
    injector.inject(**BIAS, axes=["yaw"])
    answer = injector.clear()
    assert (answer.success, answer.cleared) == (True, 2)
    injector.step()
    assert injector.injected() == [0.0, 0.0, 0.0]
    gone = injector.clear(second)
    assert (gone.success, gone.cleared, gone.message) == (False, 0, f"there is no fault {second}")
    nothing = injector.clear()
    assert (nothing.success, nothing.cleared) == (True, 0)


def test_diagnostics_name_the_faults_that_act(injector):
    injector.step()
    injector.bench.until(lambda: "fault_injector: faults" in injector.status)
    assert injector.status["fault_injector: faults"].level == DiagnosticStatus.OK
    injector.inject(**BIAS, duration=0.004)
    injector.step()
    injector.bench.until(lambda: injector.status["fault_injector: faults"].level == DiagnosticStatus.WARN)
    said = injector.status["fault_injector: faults"]
    assert (said.message, said.hardware_id) == ("1 faults act", "vehicle")
    words = "bias on attitude roll, pitch, yaw until 0.004 s"
    assert {pair.key: pair.value for pair in said.values} == {"1": words}
    injector.step()
    injector.bench.until(lambda: injector.status["fault_injector: faults"].level == DiagnosticStatus.OK)


def test_reset_begins_the_schedule_anew_and_forgets_what_was_injected(lockstep_bench):
    injector = Injector(lockstep_bench, faults=["bias axes=yaw value=0.02 stop=0.008s"])
    injector.inject(**BIAS, axes=["roll"])
    injector.step(4)
    assert injector.injected() == pytest.approx([0.01, 0.0, 0.0], abs=1e-12)
    assert injector.bench.call(Trigger, "fault_injector/reset").success
    injector.step()
    assert injector.injected() == pytest.approx([0.0, 0.0, 0.02], abs=1e-12)
