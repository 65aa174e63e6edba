"""The position controller node: attitude and thrust for every sample, by trajectories or live setpoints."""

import dataclasses
import uuid

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Trigger

from message_objects import imu_sample, reference_of
from node_bench import imu_message
from quadftc_control.guidance import FlightGuidance, FlightGuidanceInputs
from quadftc_control.position_controller import position_controllers
from quadftc_control.position_controller_node import PositionControllerNode
from quadftc_control.position_loop import PositionLoop
from quadftc_control.trajectory import trajectories
from quadftc_model.arrays import where
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.samples import NO_PLACE, PositionSample
from quadftc_model.vehicle import load_vehicle
from quadftc_ros.conversions import stamp_of, time_message
from quadftc_ros.motion_wire import PositionSampleWire

FIRST_NS, PERIOD_NS = 1_000_000_000, 5_000_000
PLACE = np.array([0.1, -0.2, 0.9])


class Source:
    """A position controller with the samples that drive it, every other with a position."""

    def __init__(self, bench, **parameters):
        self.bench = bench
        self.node = bench.run(PositionControllerNode, plant_kind="free_flight", vehicle="x500", **parameters)
        self.send, self.place = bench.talk("imu/corrected"), bench.talk("position/data")
        self.found, self.estimates = bench.listen("attitude/reference"), bench.listen("position/estimate")
        self.wish = bench.talk("position/setpoint") if parameters.get("source") == "topic" else None
        self.wire = PositionSampleWire(has_velocity=False)
        bench.connect()
        self.sent = 0

    def step(self, count=1, place=PLACE):
        for _ in range(count):
            before, stamp_ns = len(self.found), FIRST_NS + self.sent * PERIOD_NS
            self.send(imu_message(stamp_ns))
            if self.sent % 2 == 0:
                self.place(self.wire(stamp_ns, PositionSample(place, np.zeros(3), np.bool_(True))))
            self.sent += 1
            self.bench.until(lambda seen=before: len(self.found) > seen)


def test_command_is_that_of_the_guidance_at_every_sample(lockstep_bench):
    source = Source(lockstep_bench, trajectories=["circle radius=2 speed=1 start=0"])
    source.step(40)
    assert [stamp_of(each) for each in source.found] == [FIRST_NS + k * PERIOD_NS for k in range(40)]
    vehicle = load_vehicle("x500")
    loop = PositionLoop(
        estimator=PositionEstimator(), controller=position_controllers.get("geometric")(vehicle=vehicle)
    )
    law, state = FlightGuidance(trajectories=(trajectories.get("circle")(),), loop=loop), None
    for index, message in enumerate(source.found):
        place = NO_PLACE if index % 2 else PositionSample(PLACE, np.zeros(3), np.bool_(True))
        inputs = FlightGuidanceInputs(imu_sample(imu_message(0)), place, index * PERIOD_NS / 1e9)
        state = law.init(inputs) if state is None else state
        state, output = law.step(state, inputs, PERIOD_NS / 1e9 if index else 0.0)
        np.testing.assert_allclose(reference_of(message), output.command.attitude, rtol=1e-9, atol=1e-12)
        assert message.thrust == pytest.approx(float(output.command.thrust), rel=1e-9)


def test_live_setpoint_begins_where_the_trajectories_do_and_is_followed(lockstep_bench):
    source = Source(lockstep_bench, source="topic", trajectories=["hover position=0.1,-0.2,0.9"])
    source.step(20)
    assert np.max(np.abs([reference_of(each).angles for each in source.found])) < 1e-6
    pose = PoseStamped()
    pose.header.stamp = time_message(1)
    pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = 5.0, -0.2, 0.9
    source.wish(pose)
    lockstep_bench.until(lambda: source.step() or reference_of(source.found[-1]).angles[1] > 0.05)


@pytest.fixture
def defective():
    """The name of a position controller that wants no number of thrust at more than 2 m east."""

    @dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
    class Defective(position_controllers.get("geometric")):
        """Gives no thrust far in the east."""

        def step(self, state, inputs, dt):
            state, command = super().step(state, inputs, dt)
            far = inputs.estimate.position[..., 0] > 2.0
            return state, command._replace(thrust=where(far, np.nan, command.thrust))

    name = f"defective_{uuid.uuid4().hex}"
    position_controllers.register(name)(Defective)
    yield name
    del position_controllers._components[name]


def test_law_that_gives_no_number_is_an_error_and_the_last_command_held(lockstep_bench, defective):
    source = Source(lockstep_bench, position_controller=defective)
    status = lockstep_bench.watch_diagnostics()
    source.step(2)
    source.step(99, place=np.array([200.0, 0.0, 0.0]))  # the estimator believes it after half a second
    assert source.found[-1].thrust == source.found[-2].thrust
    told = "position_controller: law"
    lockstep_bench.until(lambda: told in status and status[told].level == DiagnosticStatus.ERROR)
    assert "the last command is held" in status[told].message
    source.step(201)  # to the diagnostics of the next second
    lockstep_bench.until(lambda: status[told].level == DiagnosticStatus.OK)
    assert np.isfinite([message.thrust for message in source.found]).all()


def test_reset_begins_the_scenario_anew(lockstep_bench):
    source = Source(lockstep_bench, trajectories=["circle radius=2 speed=1 start=0"])
    source.step(20)
    assert lockstep_bench.call(Trigger, "position_controller/reset").success
    source.step(20)
    commands = np.array([reference_of(message) for message in source.found])
    np.testing.assert_array_equal(commands[:20], commands[20:])
