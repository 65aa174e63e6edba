"""The controller node: a torque for every sample, whichever input goes missing."""

import dataclasses
import math
import uuid

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from message_objects import ReferenceWriter
from node_bench import imu_message, vector_message
from quadftc_control.attitude_loop import AttitudeLoop, AttitudeLoopInputs
from quadftc_control.controller import Controller, controllers
from quadftc_control.controller_node import ControllerNode
from quadftc_control.input_monitor import HeldTorque
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import (
    FAULTY,
    HEALTHY,
    AttitudeCommand,
    AttitudeReference,
    ControllerOutput,
    RotorEstimate,
    level_sample,
)
from quadftc_model.vehicle import load_vehicle
from quadftc_msgs.msg import ControlStatus, FaultStatus
from quadftc_ros.conversions import stamp_of, time_message
from quadftc_ros.motion_wire import RotorsWire
from quadftc_ros.rotor_wire import RotorStatusWire
from quadftc_ros.wire import ReferenceWire

FIRST_NS = 1_000_000_000
PERIOD_NS = 4_000_000
TILT = (0.1, 0.0, 0.0)  # rad
INPUTS = ("imu/data", "imu/corrected", "attitude/reference", "disturbance/estimate")


class Pilot:
    """A controller with the sources it reads and what comes out of it."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(ControllerNode, **parameters)
        self.send = {topic: bench.talk(topic) for topic in INPUTS}
        self.torques = bench.listen("torque/command")
        self.states = bench.listen("control/status")
        self.status = bench.watch_diagnostics()
        bench.connect()
        self.sent, self.waited = 0, 0
        self.angles, self.rates = TILT, (0.0, 0.0, 0.0)

    def message(self, topic, angles, stamp_ns):
        if topic == "attitude/reference":
            return ReferenceWriter()(stamp_ns, AttitudeReference(*(np.zeros(3),) * 3))
        if topic == "disturbance/estimate":
            return vector_message(stamp_ns)
        return imu_message(stamp_ns, angles, self.rates)

    def publish(self, *topics, angles=None):
        """Send what belongs to the next sample on some topics."""
        stamp_ns = FIRST_NS + self.sent * PERIOD_NS
        self.sent += 1
        for topic in topics:
            self.send[topic](self.message(topic, angles or self.angles, stamp_ns))

    def step(self, *topics, angles=None):
        """Send a sample and wait for its torque."""
        self.publish(*(topics or INPUTS), angles=angles)
        self.served()

    def served(self):
        """Wait until the newest sample has been answered."""
        newest = FIRST_NS + (self.sent - 1) * PERIOD_NS
        self.bench.until(
            lambda: all(found and stamp_of(found[-1]) == newest for found in (self.torques, self.states))
        )

    def prime(self):
        """In real time: send inputs until all of them are known, and the newest sample has been answered."""
        self.bench.until(self.full)
        self.served()

    def full(self):
        """Send the next sample when the last was answered, or is not going to be."""
        self.waited += 1
        newest = FIRST_NS + (self.sent - 1) * PERIOD_NS
        if self.waited > 20 or (self.states and stamp_of(self.states[-1]) == newest):
            self.waited = 0
            self.publish(*INPUTS)
        return self.states and self.mode() == ControlStatus.MODE_FULL

    def mode(self):
        return self.states[-1].mode

    def until_status(self, part, level):
        name = f"controller: {part}"
        self.bench.until(lambda: name in self.status and self.status[name].level == level)
        return self.status[name]


def values(message):
    return [message.vector.x, message.vector.y, message.vector.z]


def test_torque_and_status_have_the_stamp_of_the_sample(lockstep_bench):
    pilot = Pilot(lockstep_bench)
    for _ in range(3):
        pilot.step()
    wanted = [FIRST_NS + k * PERIOD_NS for k in range(3)]
    assert [stamp_of(m) for m in pilot.torques] == [stamp_of(m) for m in pilot.states] == wanted
    assert {m.header.frame_id for m in (*pilot.torques, *pilot.states)} == {"base_link"}


def test_torque_drives_the_error_down_and_status_tells_it(lockstep_bench):
    pilot = Pilot(lockstep_bench)
    pilot.step()
    pilot.step()
    assert pilot.torques[-1].vector.x < 0.0
    state = pilot.states[-1]
    assert state.error.x == pytest.approx(TILT[0], abs=1e-9)
    assert state.mode == ControlStatus.MODE_FULL
    assert 0.0 < state.compute_time < 1.0


@pytest.mark.parametrize("order", [INPUTS, INPUTS[::-1]])
def test_lockstep_waits_for_all_of_one_stamp_in_any_order(lockstep_bench, order):
    pilot = Pilot(lockstep_bench)
    needed = [topic for topic in order if topic != "imu/data"]
    for stamp_ns in (FIRST_NS, FIRST_NS + PERIOD_NS):
        for topic in needed:
            pilot.send[topic](pilot.message(topic, TILT, stamp_ns))
    lockstep_bench.until(lambda: len(pilot.torques) == 2)
    pilot.send["imu/corrected"](imu_message(FIRST_NS + 2 * PERIOD_NS))
    pilot.send["disturbance/estimate"](vector_message(FIRST_NS + 2 * PERIOD_NS))
    lockstep_bench.call(Trigger, "controller/reset")  # so that both have been heard
    assert len(pilot.torques) == 2
    pilot.send["attitude/reference"](pilot.message("attitude/reference", TILT, FIRST_NS + 2 * PERIOD_NS))
    lockstep_bench.until(lambda: len(pilot.torques) == 3)


def test_reset_in_lockstep_keeps_the_sample_that_waits(lockstep_bench):
    pilot = Pilot(lockstep_bench)
    pilot.publish("imu/corrected")
    pilot.sent -= 1
    assert lockstep_bench.call(Trigger, "controller/reset").success
    pilot.step("attitude/reference", "disturbance/estimate")


def test_in_free_flight_rotors_get_what_the_inner_loop_says(lockstep_bench):
    """With speeds that are not usable at one sample, and nothing known of the rotors at the first."""
    vehicle = load_vehicle("qball_x4")
    pilot = Pilot(lockstep_bench, plant_kind="free_flight")
    talk = {topic: lockstep_bench.talk(topic) for topic in ("rotors/speed", "rotors/status")}
    commands = lockstep_bench.listen("rotors/command")
    lockstep_bench.connect()
    zeros, speeds = np.zeros(3), np.array([400.0, 410.0, 390.0, 405.0])
    command = AttitudeCommand(AttitudeReference(zeros, zeros, zeros), np.float64(12.0))
    law, state = AttitudeLoop(controller=controllers.get("ismc")(vehicle=vehicle), flies=True), None
    for index in range(4):
        stamp_ns = FIRST_NS + index * PERIOD_NS
        measured, weak = np.bool_(index != 2), np.array([1.0, 0.9, 1.0, 1.0] if index else [1.0] * 4)
        for topic in INPUTS[1:]:
            if topic != "attitude/reference":
                pilot.send[topic](pilot.message(topic, TILT, stamp_ns))
        pilot.send["attitude/reference"](ReferenceWire()(stamp_ns, command.attitude, 12.0))
        talk["rotors/speed"](RotorsWire(4)(stamp_ns, speeds if measured else speeds * math.nan))
        state_of = np.array([HEALTHY, FAULTY, HEALTHY, HEALTHY], dtype=np.uint8)
        flags = np.zeros(4, dtype=bool)
        status = RotorEstimate(state_of, weak, *np.zeros((3, 4)), state_of, flags) if index else None
        talk["rotors/status"](RotorStatusWire(4)(stamp_ns, status))
        lockstep_bench.until(lambda count=index: len(commands) > count)
        imu = level_sample()._replace(q_xyzw=quaternion_from_euler(np.array(TILT)))
        given = np.where(measured, speeds, 0.0)
        inputs = AttitudeLoopInputs(imu, command, zeros, zeros, given, measured, weak)
        state = law.init(inputs) if state is None else state
        state, output = law.step(state, inputs, PERIOD_NS / 1e9 if index else 0.0)
        np.testing.assert_allclose(commands[-1].velocity, output.speeds, rtol=1e-9)


# What follows is about real time. Where silence is not the subject, no pause of a slow machine is one.
PATIENT = {"patience.hold": 60.0, "patience.off": 60.0}


def test_falls_back_on_imu_data_within_three_samples_and_returns(bench):
    pilot = Pilot(bench, **PATIENT)
    pilot.prime()
    pilot.step("imu/data", "imu/corrected")
    assert pilot.mode() == ControlStatus.MODE_FULL
    first = pilot.sent
    pilot.publish("imu/data")
    pilot.publish("imu/data")
    pilot.publish("imu/data")
    pilot.step("imu/data")
    assert pilot.mode() == ControlStatus.MODE_NO_DIAGNOSIS
    fallen = [state for state in pilot.states if state.mode == ControlStatus.MODE_NO_DIAGNOSIS]
    assert (
        stamp_of(fallen[0]) <= FIRST_NS + (first + 3) * PERIOD_NS
    )  # at most three samples go without torque
    said = pilot.until_status("mode", DiagnosticStatus.WARN)
    assert said.message == "no diagnosis: on imu/data, as imu/corrected is missing"
    pilot.step("imu/data")
    assert pilot.mode() == ControlStatus.MODE_NO_DIAGNOSIS
    pilot.step("imu/data", "imu/corrected")
    assert pilot.mode() == ControlStatus.MODE_NO_DIAGNOSIS  # one is not enough
    pilot.prime()
    pilot.until_status("mode", DiagnosticStatus.OK)
    modes = [state.mode for state in pilot.states]
    back = len(modes) - modes[::-1].index(ControlStatus.MODE_NO_DIAGNOSIS)
    assert stamp_of(pilot.states[back]) - stamp_of(fallen[-1]) > 20 * PERIOD_NS


def test_last_words_of_an_observer_are_kept_for_the_next(bench):
    pilot = Pilot(bench, **PATIENT)
    status = bench.talk("fault/status")
    kept = {topic: bench.listen(topic) for topic in ("fault/kept", "gyro/kept", "disturbance/kept")}
    bench.connect()
    pilot.prime()
    last_ns = FIRST_NS + pilot.sent * PERIOD_NS
    said = FaultStatus(state=[FAULTY, HEALTHY, HEALTHY])
    said.header.stamp, said.estimate.x = time_message(last_ns), 0.05
    status(said)
    pilot.send["imu/data"](imu_message(last_ns, TILT, (0.02, 0.0, 0.0)))
    pilot.send["attitude/reference"](pilot.message("attitude/reference", TILT, last_ns))
    pilot.send["disturbance/estimate"](vector_message(last_ns, (0.7, 0.0, 0.0)))
    pilot.send["imu/corrected"](imu_message(last_ns, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0)))
    pilot.sent += 1
    pilot.served()
    bench.call(GetParameters, "controller/get_parameters")  # so that all has been heard

    def fly_without_diagnosis():
        for _ in range(10):
            pilot.publish("imu/data")
            pilot.publish("imu/data")
            pilot.publish("imu/data")
            pilot.step("imu/data")

    pilot.rates = (0.01, 0.0, 0.0)  # all of it bias
    fly_without_diagnosis()
    bench.until(lambda: all(kept.values()))
    assert kept["fault/kept"][0] == said
    assert stamp_of(kept["gyro/kept"][0]) == last_ns
    assert values(kept["gyro/kept"][0]) == pytest.approx([-0.01, 0.0, 0.0])
    assert values(kept["disturbance/kept"][0]) == [0.7, 0.0, 0.0]
    # what the fault has become meanwhile shows in the attitude, as the vehicle does not turn
    changed = pilot.angles = (TILT[0] + 0.1, TILT[1], TILT[2] + 0.05)
    fly_without_diagnosis()
    bench.until(lambda: kept["fault/kept"][-1].estimate.x == pytest.approx(changed[0], abs=2e-3))
    last = kept["fault/kept"][-1]
    assert last.header == said.header
    assert last.state.tolist() == [FAULTY, HEALTHY, FAULTY]
    assert stamp_of(Header(stamp=last.onset[2])) > last_ns


def test_disturbance_estimate_that_stops_fades_and_is_told(bench):
    fade = {"patience.disturbance_age": 0.01, "patience.disturbance_fade": 0.02}
    pilot = Pilot(bench, **fade, **PATIENT)
    pilot.angles = (0.0, 0.0, 0.0)  # nothing to do but to work against the disturbance
    pilot.prime()
    pilot.send["disturbance/estimate"](vector_message(FIRST_NS + pilot.sent * PERIOD_NS, (1.0, 0.0, 0.0)))
    torques = []
    for _ in range(12):
        pilot.step("imu/corrected")
        torques.append(pilot.torques[-1].vector.x)
    assert pilot.mode() == ControlStatus.MODE_NO_DISTURBANCE_ESTIMATE
    said = pilot.until_status("mode", DiagnosticStatus.WARN)
    assert said.message == "no disturbance estimate: the switching gain takes over"
    inertia = load_vehicle("qball_x4").inertia[0]
    assert torques[1] == pytest.approx(-inertia * 1.0)
    assert np.all(np.diff(torques[1:]) >= 0.0)
    assert torques[-1] == 0.0


def test_holds_then_gives_up_when_the_imu_stops_and_returns(bench):
    pilot = Pilot(bench, **{"patience.hold": 0.1, "patience.off": 1.5})
    pilot.prime()
    pilot.step()
    mean = HeldTorque()
    for message in pilot.torques:
        mean.add(stamp_of(message), np.array(values(message)))
    assert mean.mean[0] != 0.0
    bench.until(lambda: pilot.mode() == ControlStatus.MODE_OFF and values(pilot.torques[-1]) == [0.0] * 3)
    assert ControlStatus.MODE_HOLD in {state.mode for state in pilot.states}
    index = [values(message) for message in pilot.torques].index([0.0, 0.0, 0.0])
    assert values(pilot.torques[index - 1]) == pytest.approx(mean.mean)  # held until then
    said = pilot.until_status("mode", DiagnosticStatus.ERROR)
    assert said.message == "off: no IMU, zero torque"
    pilot.prime()
    pilot.until_status("mode", DiagnosticStatus.OK)


def test_reference_that_stops_is_held_and_told(bench):
    pilot = Pilot(bench, **PATIENT)
    pilot.prime()
    pilot.sent += 200  # 0.8 s
    pilot.step("imu/corrected", "disturbance/estimate")
    said = pilot.until_status("reference", DiagnosticStatus.WARN)
    assert said.message == "attitude/reference does not come: the last is held"
    pilot.step()
    pilot.until_status("reference", DiagnosticStatus.OK)


def test_nothing_is_commanded_before_there_is_a_reference(bench):
    pilot = Pilot(bench, **PATIENT)
    pilot.publish("imu/data", "imu/corrected")
    said = pilot.until_status("samples", DiagnosticStatus.WARN)
    assert "no attitude/reference yet" in {pair.key for pair in said.values}
    assert pilot.torques == []


def spoilt(topic, stamp_ns):
    message = imu_message(stamp_ns, TILT)
    message.orientation.z = math.nan
    if topic == "attitude/reference":
        message = ReferenceWriter()(stamp_ns, AttitudeReference(*(np.full(3, math.nan),) * 3))
    elif topic == "disturbance/estimate":
        message = vector_message(stamp_ns, (math.nan, 0.0, 0.0))
    return message


@pytest.mark.parametrize("topic", INPUTS[2:])
def test_number_that_is_none_does_not_stop_lockstep(lockstep_bench, topic):
    pilot = Pilot(lockstep_bench)
    pilot.step()
    stamp_ns = FIRST_NS + pilot.sent * PERIOD_NS
    pilot.send[topic](spoilt(topic, stamp_ns))
    pilot.step(*(each for each in INPUTS if each != topic))
    assert stamp_of(pilot.torques[-1]) == stamp_ns
    assert np.all(np.isfinite(values(pilot.torques[-1])))


@pytest.fixture
def defective():
    """The name of a controller whose torque is no number at one of its steps."""

    @dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
    class Defective(Controller):
        """Counts its steps."""

        def init(self, inputs):
            return 0

        def step(self, state, inputs, dt):
            torque = np.full(3, math.nan if state == 3 else 0.001 * (state + 1))
            return state + 1, ControllerOutput(torque, np.zeros(3), np.zeros(3), np.zeros(3, dtype=bool))

    name = f"defective_{uuid.uuid4().hex}"
    controllers.register(name)(Defective)
    yield name
    del controllers._components[name]


def test_law_that_gives_no_number_is_counted_and_the_last_torque_held(lockstep_bench, defective):
    pilot = Pilot(lockstep_bench, controller=defective)
    for _ in range(5):
        pilot.step()
    assert [m.vector.x for m in pilot.torques] == pytest.approx([0.001, 0.002, 0.003, 0.003, 0.001])
    said = pilot.until_status("samples", DiagnosticStatus.WARN)
    assert {pair.key: pair.value for pair in said.values} == {
        "the controller gave no number: the last torque is held": "1"
    }
    assert [state.restarts for state in pilot.states] == [0, 0, 0, 1, 1]
    law = pilot.until_status("law", DiagnosticStatus.ERROR)
    assert law.message == "restarts: its output was unusable, the last torque is held"
    for _ in range(3):
        pilot.step()
    assert [state.restarts for state in pilot.states[5:]] == [1, 1, 2]


def test_reset_forgets_the_integral(lockstep_bench):
    pilot = Pilot(lockstep_bench, controller="pid")
    for _ in range(30):
        pilot.step()
    first, last = pilot.torques[0], pilot.torques[-1]
    assert lockstep_bench.call(Trigger, "controller/reset").success
    pilot.step()
    assert values(pilot.torques[-1]) == pytest.approx(values(first))
    assert values(last) != pytest.approx(values(first))


def test_patience_is_checked_as_a_whole_and_described(bench):
    Pilot(bench)
    refused = bench.set_parameter("controller", "patience.off", 0.01)
    assert (refused.successful, "must not be less than hold" in refused.reason) == (False, True)
    assert bench.get_parameter("controller", "patience.off") == 0.5
    assert bench.set_parameter("controller", "patience.off", 0.2).successful
    assert bench.describe("controller", "patience.hold").description.endswith("[s]")
