# pyright: basic
"""The reference node: where the attitude shall be, from the scenario or live from a topic.

Inputs: imu/data (for its stamps), attitude/setpoint (Euler angles [rad], with ``source:=topic``).
Outputs: attitude/reference.
Services: ~/reset (std_srvs/Trigger): the next sample is scenario time 0.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np

from quadftc_compile.engine import engine_from
from quadftc_control.guidance import ScenarioClock, stand_guidance_from
from quadftc_control.reference import MAX_TILT, SetpointFilter
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import parameter
from quadftc_model.samples import is_usable
from quadftc_model.stepper import Stepper
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.wire import ReferenceWire, vector_of


@dataclasses.dataclass(frozen=True)
class ReferenceParameters:
    """Parameters of the reference node besides those of :class:`SetpointFilter`, behind ``setpoint.``."""

    source: str = parameter(
        "scenario", choices=("scenario", "topic"), doc="from `references`, or attitude/setpoint"
    )


class ReferenceNode(GraphNode):
    """A reference for every IMU sample."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("reference", **kwargs)
        self.settings.declare(ReferenceParameters, read_only=True)
        self.settings.declare(SetpointFilter, "setpoint.")
        example = "step angles=5deg,0,0 start=5s"
        self.settings.declare_list("references", f"each: kind key=value..., e.g. '{example}'")
        values = self.settings.values()
        self._live = values["source"] == "topic"
        engine = engine_from(values, self.get_logger().info)
        self._stepper, self._scenario = Stepper[Any, Any](self._build(values), engine=engine), ScenarioClock()
        self._restart()
        self.settings.on_change(self._build, partial(setattr, self._stepper, "law"))
        self._publish = self.publishes("attitude/reference")
        self._message = ReferenceWire()
        self.driven_by("imu/data", self._on_imu, restart=self._restart, decode=bytes)  # for its stamp
        if self._live:
            self.reads("attitude/setpoint", self._on_setpoint, decode=vector_of)
        self.diagnostics.report("source", OK, values["source"])
        self.ready()

    def _build(self, values: NodeParameters) -> Any:
        """Build what is flown; a ValueError says which parameter is wrong, of the filter in any case."""
        smooth = build_prefixed(SetpointFilter, values, "setpoint")
        return smooth if self._live else stand_guidance_from(values)

    def _restart(self) -> None:
        self._stepper.reset()
        self._scenario.reset()
        self._setpoint = np.zeros(3)

    def _on_setpoint(self, stamp_ns: int, setpoint: Floats) -> None:
        if not is_usable(setpoint) or np.any(np.abs(setpoint[:2]) > MAX_TILT):
            self.diagnostics.count("attitude/setpoint is not finite or beyond 80 deg of tilt")
            return
        self._setpoint = setpoint

    def _on_imu(self, stamp_ns: int, _data: bytes) -> None:
        wanted = self._setpoint if self._live else self._scenario.elapsed(stamp_ns)
        output = self._stepper.step(stamp_ns, wanted)
        if output is None:
            self.diagnostics.count("imu/data: stamp repeated or went back")
            return
        self._publish(self._message(stamp_ns, output if self._live else output.attitude))
        self.sampled(stamp_ns)


main = partial(run_node, ReferenceNode)
