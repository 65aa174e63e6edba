# pyright: basic
"""The position controller node: from corrected IMU and position to the attitude and thrust to fly.

Inputs: imu/corrected, position/data; position/setpoint (with ``source:=topic``).
Outputs: attitude/reference with thrust [N], position/reference, position/estimate.
Services: ~/reset (std_srvs/Trigger): the next sample is scenario time 0.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

from quadftc_compile.engine import engine_from
from quadftc_control.guidance import (
    FlightGuidanceInputs,
    GuidanceOutput,
    LiveGuidanceInputs,
    ScenarioClock,
    flight_guidance_from,
    live_guidance_from,
)
from quadftc_control.position_controller import position_controllers
from quadftc_control.trajectory import PositionSetpoint, PositionSetpointFilter, combined, trajectories_from
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import parameter
from quadftc_model.position_estimator import PositionEstimator
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import NO_PLACE, ImuSample, PositionSample, is_usable
from quadftc_model.stepper import Law, Stepper
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import ERROR, OK
from quadftc_ros.executor import run_node
from quadftc_ros.join import PlaceGate, PlaceParameters
from quadftc_ros.motion_wire import OdometryWire, PoseWire, PositionSampleReader
from quadftc_ros.node import GraphNode
from quadftc_ros.parameters import VehicleParameters
from quadftc_ros.wire import ReferenceWire, imu_of, pose_of


@dataclasses.dataclass(frozen=True)
class PositionControllerParameters:
    """Parameters of the node besides those of the controller, which stand behind its name."""

    position_controller: str = parameter("geometric", doc="name of the position controller")
    source: str = parameter(
        "scenario",
        choices=("scenario", "topic"),
        doc="from `trajectories`, or position/setpoint, which begins where `trajectories` begin",
    )


class PositionControllerNode(GraphNode):
    """Attitude and thrust for every IMU sample."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("position_controller", **kwargs)
        self.settings.declare(VehicleParameters, read_only=True)
        self.settings.declare(PositionControllerParameters, read_only=True)
        name = self.settings.values()["position_controller"]
        self.settings.declare(position_controllers.get(name), f"{name}.")
        self.settings.declare(PlaceParameters, "position.", read_only=True)
        self.settings.declare(PositionEstimator, "estimator.")
        self.settings.declare(PositionSetpointFilter, "setpoint.")
        example = "circle radius=2m speed=1m/s start=5s"
        self.settings.declare_list("trajectories", f"each: kind key=value..., e.g. '{example}'")
        values = self.settings.values()
        self._live = values["source"] == "topic"
        self._place = build_prefixed(PlaceParameters, values, "position")
        engine = engine_from(values, self.get_logger().info)
        self._stepper = Stepper(self._build(values), engine=engine)
        self._scenario = ScenarioClock()
        self._restarts = 0  # of its law, since the last report
        self._restart()
        self.settings.on_change(self._build, partial(setattr, self._stepper, "law"))
        self._publish_command, self._command = self.publishes("attitude/reference"), ReferenceWire()
        self._publish_reference, self._pose = self.publishes("position/reference"), PoseWire()
        self._publish_estimate = self.publishes("position/estimate")
        self._odometry = OdometryWire(self.base_frame)
        self.driven_by("imu/corrected", self._on_imu, restart=self._restart, decode=imu_of)
        self.reads("position/data", self._on_place, decode=PositionSampleReader())
        if self._live:
            self.reads("position/setpoint", self._on_setpoint, decode=pose_of)
        self.diagnostics.report("source", OK, values["source"])
        self.ready()

    def _build(self, values: NodeParameters) -> Law[Any, GuidanceOutput]:
        """Build what is flown; a ValueError says which parameter is wrong, of the filter in any case."""
        live = live_guidance_from(values)
        return live if self._live else flight_guidance_from(values)

    def _restart(self) -> None:
        begin = combined(trajectories_from(self.settings.values()), 0.0)
        self._setpoint = PositionSetpoint(begin.position, begin.yaw)
        self._stepper.reset()
        self._scenario.reset()
        self._gate = PlaceGate(self.mode, self._place.period, self._place.delay, self._on_sample)

    def _on_imu(self, stamp_ns: int, imu: ImuSample) -> None:
        self._gate.put_sample(stamp_ns, imu)

    def _on_place(self, stamp_ns: int, place: PositionSample) -> None:
        if is_usable(place.position, place.velocity):
            self._gate.put_place(stamp_ns, place)
        else:
            self.diagnostics.count("position/data: not finite")

    def _on_setpoint(self, stamp_ns: int, pose: tuple[Floats, Floats]) -> None:
        position, q_xyzw = pose
        if is_usable(position, q_xyzw):
            self._setpoint = PositionSetpoint(position, euler_from_quaternion(q_xyzw)[2])
        else:
            self.diagnostics.count("position/setpoint: not finite")

    def _on_sample(self, stamp_ns: int, imu: ImuSample, place: PositionSample | None) -> None:
        seen = imu, NO_PLACE if place is None else place
        if self._live:
            output = self._stepper.step(stamp_ns, LiveGuidanceInputs(*seen, self._setpoint))
        else:
            elapsed = self._scenario.elapsed(stamp_ns)
            output = self._stepper.step(stamp_ns, FlightGuidanceInputs(*seen, elapsed))
        if output is None:
            self.diagnostics.count("imu/corrected: stamp repeated or went back")
            return
        # the controller waits for the attitude: publish it first
        position, (attitude, thrust) = output.estimate.position, output.command
        self._publish_command(self._command(stamp_ns, attitude, float(thrust)))
        self._publish_reference(self._pose(stamp_ns, output.reference.position, output.heading))
        odometry = self._odometry(stamp_ns, position, imu.q_xyzw, output.body_velocity, imu.body_rate)
        self._publish_estimate(odometry)
        if not output.good:
            self._restarts += 1
            self.diagnostics.count("the position controller gave no number: the last command is held")
        self.sampled(stamp_ns)

    def report(self) -> None:
        """Report a law that restarts."""
        words = "restarts: its output was unusable, the last command is held" if self._restarts else "flies"
        self.diagnostics.report("law", ERROR if self._restarts else OK, words)
        self._restarts = 0


main = partial(run_node, PositionControllerNode)
