"""The plant node: what it publishes, how lock-step and real time drive it, its services and parameters."""

import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from node_bench import vector_message
from quadftc_ros.conversions import stamp_of, time_message
from quadftc_ros.rotor_wire import RotorConditionWire
from quadftc_sim.plant_node import PlantNode
from quadftc_sim.rotor_fault import healthy_rotors
from quadftc_sim.simulator import NEVER_NS

FIRST_NS = 1_000_000_000
PERIOD_NS = 4_000_000
MEMS = {"imu.delay": 1, "imu.attitude_noise": 0.002, "imu.gyro_noise": 0.001}
TRUTH = ("plant/attitude", "plant/rate", "disturbance/applied")


class Flight:
    """A plant that was started, with everything around it that it waits for."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(PlantNode, **{"start_when_connected": False, "rate": 250.0, **parameters})
        self.imu = bench.listen("plant/imu")
        self.truth = {topic: bench.listen(topic) for topic in TRUTH}
        self.command = bench.talk("torque/command")
        self.drop = bench.talk("fault/dropped")
        self.status = bench.watch_diagnostics()
        bench.connect()

    def start(self):
        return self.bench.call(Trigger, "plant/start")

    def answer(self, torque=(0.0, 0.0, 0.0)):
        """Command a torque for the newest sample, and wait for what comes of it."""
        count = len(self.imu)
        self.command(vector_message(stamp_of(self.imu[-1]), torque))
        self.bench.until(lambda: len(self.imu) > count or self.node.flight.finished)

    def fly(self, count):
        self.start()
        self.bench.until(lambda: self.imu)
        while len(self.imu) < count:
            self.answer()


def stamps(messages):
    return [stamp_of(message) for message in messages]


def values(message):
    return [message.vector.x, message.vector.y, message.vector.z]


def test_lockstep_stamps_every_topic_from_one_second_on_at_the_rate(lockstep_bench):
    clock = lockstep_bench.listen("/clock")
    flight = Flight(lockstep_bench)
    flight.fly(5)
    wanted = [FIRST_NS + k * PERIOD_NS for k in range(5)]
    lockstep_bench.until(lambda: len(clock) == 5 and all(len(found) == 5 for found in flight.truth.values()))
    assert stamps(flight.imu) == wanted
    assert [stamps(found) for found in flight.truth.values()] == [wanted] * 3
    assert [message.clock.sec * 10**9 + message.clock.nanosec for message in clock] == wanted


def test_frames_are_those_of_the_body_the_earth_and_the_imu(lockstep_bench):
    flight = Flight(lockstep_bench)
    flight.fly(2)
    lockstep_bench.until(lambda: all(flight.truth.values()))
    frames = {topic: found[0].header.frame_id for topic, found in flight.truth.items()}
    assert frames == {"plant/attitude": "map", "plant/rate": "base_link", "disturbance/applied": "base_link"}
    assert flight.imu[0].header.frame_id == "imu_link"


def test_lockstep_advances_for_the_torque_of_its_sample_only(lockstep_bench):
    flight = Flight(lockstep_bench)
    flight.fly(1)
    for stamp_ns in (FIRST_NS - PERIOD_NS, FIRST_NS + PERIOD_NS, FIRST_NS, FIRST_NS):
        flight.command(vector_message(stamp_ns))
    lockstep_bench.until(lambda: len(flight.imu) == 2)
    flight.answer()
    assert stamps(flight.imu) == [FIRST_NS + k * PERIOD_NS for k in range(3)]


def test_condition_of_rotors_that_is_no_number_is_counted_and_not_used(lockstep_bench):
    kinds = {"plant": "free_flight", "plant_kind": "free_flight", "vehicle": "x500"}
    node = lockstep_bench.run(PlantNode, start_when_connected=False, **kinds)
    send, status = lockstep_bench.talk("rotors/fault"), lockstep_bench.watch_diagnostics()
    lockstep_bench.connect()
    weak = healthy_rotors(np.zeros(4))._replace(effectiveness=np.array([1.0, np.nan, 1.0, 1.0]))
    send(RotorConditionWire(4)(FIRST_NS, weak))
    name = "plant: samples"
    told = {"rotors/fault: not finite": "1"}
    lockstep_bench.until(
        lambda: name in status and {pair.key: pair.value for pair in status[name].values} == told
    )
    assert np.all(node.flight.simulator._rotors.effectiveness == 1.0)


def test_sensor_that_is_late_does_not_keep_lockstep_from_starting(lockstep_bench):
    flight = Flight(lockstep_bench, **MEMS)
    flight.fly(3)
    assert stamps(flight.imu) == [FIRST_NS + k * PERIOD_NS for k in range(3)]
    lockstep_bench.until(lambda: len(flight.truth["plant/attitude"]) >= 4)
    assert stamps(flight.truth["plant/attitude"])[:4] == [FIRST_NS + k * PERIOD_NS for k in range(4)]


def test_lockstep_goes_on_with_the_last_torque_when_a_sample_is_withheld(lockstep_bench):
    flight = Flight(lockstep_bench)
    flight.fly(1)
    flight.answer((0.01, 0.0, 0.0))
    flight.drop(Header(stamp=time_message(stamp_of(flight.imu[-1]))))
    lockstep_bench.until(lambda: len(flight.imu) == 3 and len(flight.truth["plant/rate"]) == 3)
    rates = [values(message)[0] for message in flight.truth["plant/rate"]]
    assert rates[2] == pytest.approx(2.0 * rates[1], rel=2e-3)


def test_torque_that_is_no_number_is_counted_and_the_last_one_acts(lockstep_bench):
    flight = Flight(lockstep_bench, duration=0.02)
    flight.fly(1)
    flight.answer((0.01, 0.0, 0.0))
    while not flight.node.flight.finished:
        flight.answer((math.nan, 0.0, 0.0))
    lockstep_bench.until(lambda: len(flight.truth["plant/rate"]) == 5)
    rates = [values(message)[0] for message in flight.truth["plant/rate"]]
    np.testing.assert_allclose(np.diff(rates), rates[1], rtol=0.01)
    lockstep_bench.until(lambda: flight.status["plant: flight"].message == "finished")
    samples = flight.status["plant: samples"]
    assert samples.level == DiagnosticStatus.WARN
    assert {pair.key: pair.value for pair in samples.values} == {"torque/command: not finite": "4"}


def test_flight_ends_after_its_duration_and_says_so(lockstep_bench):
    flight = Flight(lockstep_bench, duration=0.1)
    flight.fly(25)
    flight.answer()
    assert flight.node.flight.finished
    lockstep_bench.until(lambda: flight.status["plant: flight"].message == "finished")
    assert {pair.key: pair.value for pair in flight.status["plant: flight"].values} == {"samples": "25"}
    assert len(flight.imu) == 25


def test_reset_in_lockstep_flies_the_same_flight_again(lockstep_bench):
    flight = Flight(lockstep_bench, seed=5, **MEMS)
    flight.fly(4)
    assert lockstep_bench.call(Trigger, "plant/reset").success
    lockstep_bench.until(lambda: len(flight.imu) == 5)
    while len(flight.imu) < 8:
        flight.answer()
    assert flight.imu[:4] == flight.imu[4:8]


def test_reset_in_real_time_begins_a_flight_with_later_stamps(bench):
    flight = Flight(bench)
    flight.start()
    bench.until(lambda: len(flight.imu) > 3)
    assert bench.call(Trigger, "plant/reset").success
    count = len(flight.imu)
    bench.until(lambda: len(flight.imu) > count + 3)
    found = stamps(flight.imu)
    assert np.all(np.diff(found) > 0)
    assert np.max(np.diff(found)) > 1e9  # for this long nothing was sent, so that all laws restart


def test_timer_that_was_due_when_the_flight_was_reset_does_nothing(bench):
    flight = Flight(bench)
    flight.start()
    bench.until(lambda: len(flight.imu) > 3)
    assert bench.call(Trigger, "plant/reset").success
    flight.node._on_timer()  # as the executor does with what stands in its queue
    assert flight.node.flight.emitted == 0


def test_real_time_stamps_are_of_the_wall_clock_and_at_the_rate(bench):
    flight = Flight(bench, rate=100.0, duration=0.3)
    before = flight.node.get_clock().now().nanoseconds
    flight.start()
    bench.until(lambda: flight.node.flight.finished and len(flight.truth["plant/attitude"]) == 30)
    found = stamps(flight.truth["plant/attitude"])
    assert found[0] >= before
    assert set(np.diff(found)) == {10_000_000}
    assert set(stamps(flight.imu)) <= set(found)


def test_real_time_applies_zero_torque_when_commands_stop(bench):
    flight = Flight(bench, rate=100.0, torque_timeout=0.2)
    flight.start()
    bench.until(lambda: flight.imu)
    flight.command(vector_message(1, (0.001, 0.0, 0.0)))
    bench.until(lambda: "plant: torque" in flight.status)
    bench.until(lambda: flight.status["plant: torque"].level == DiagnosticStatus.ERROR)
    assert flight.status["plant: torque"].message == "torque/command does not come: zero acts"
    count = len(flight.truth["plant/rate"])
    bench.until(lambda: len(flight.truth["plant/rate"]) > count + 10)
    rates = [values(message)[0] for message in flight.truth["plant/rate"]]
    assert 0.0 < rates[-1] < rates[-8]  # it acted before; now there is only drag
    flight.command(vector_message(2))
    bench.until(lambda: flight.status["plant: torque"].level == DiagnosticStatus.OK)


def test_plant_that_never_hears_a_command_says_so(bench):
    flight = Flight(bench, rate=100.0, torque_timeout=0.1)
    flight.start()
    bench.until(lambda: "plant: torque" in flight.status)
    bench.until(lambda: flight.status["plant: torque"].level == DiagnosticStatus.ERROR)


@pytest.mark.parametrize("use_sim_time", [False, True])
def test_flight_starts_by_itself_when_the_graph_is_connected(lockstep_bench, use_sim_time):
    flight = Flight(lockstep_bench, start_when_connected=True, use_sim_time=use_sim_time)
    lockstep_bench.until(lambda: flight.imu)
    assert stamps(flight.imu) == [FIRST_NS]


def test_plant_that_rests_in_real_time_emits_nothing_and_then_begins_a_new_flight(bench):
    flight = Flight(bench)
    flight.start()
    bench.until(lambda: flight.imu)
    first = flight.node.flight
    assert flight.node.trigger_deactivate().name == "SUCCESS"
    assert flight.node.due_ns == NEVER_NS
    refusal = flight.start()
    assert (refusal.success, refusal.message) == (False, "the node is not active")
    flight.node.trigger_activate()
    assert flight.node.flight is not first
    assert not flight.node.flight.emitted  # it begins when the laws restart


@pytest.mark.parametrize("mode", ["realtime", "lockstep"])
def test_imu_is_best_effort_in_real_time_and_reliable_in_lockstep(request, mode):
    bench = request.getfixturevalue("bench" if mode == "realtime" else "lockstep_bench")
    node = bench.run(PlantNode, start_when_connected=False)
    offered = {
        topic: node.get_publishers_info_by_topic(node.resolve_topic_name(topic))[0].qos_profile.reliability
        for topic in ("plant/imu", "plant/attitude")
    }
    best_effort = mode == "realtime"
    assert offered == {
        "plant/imu": ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        "plant/attitude": ReliabilityPolicy.RELIABLE,
    }


def test_what_is_fixed_for_a_flight_cannot_be_changed(bench):
    bench.run(PlantNode, start_when_connected=False, rate=100.0)
    result = bench.set_parameter("plant", "rate", 200.0)
    assert not result.successful
    assert "read-only" in result.reason
    assert bench.get_parameter("plant", "rate") == 100.0


def test_flight_in_real_time_keeps_up_with_the_clock_after_a_stall(bench):
    flight = Flight(bench, rate=100.0)
    flight.start()
    begin = time.monotonic()
    time.sleep(0.3)  # nobody serves the plant: its timer skips periods
    bench.until(lambda: time.monotonic() - begin > 1.5)
    # without catching up it would be 30 fewer for good
    bench.until(lambda: flight.node.flight.emitted >= 100 * (time.monotonic() - begin) - 10)
    assert flight.node.flight.emitted <= 100 * (time.monotonic() - begin) + 2


def test_plant_is_due_by_the_clock_in_real_time_and_never_in_lockstep(bench, lockstep_bench):
    waiting, flying = Flight(lockstep_bench), Flight(bench, rate=100.0)
    assert (waiting.node.due_ns, flying.node.due_ns) == (NEVER_NS, NEVER_NS)
    for flight in (waiting, flying):
        flight.start()
    assert waiting.node.due_ns == NEVER_NS
    assert abs(flying.node.due_ns - time.monotonic_ns()) < 10e9
