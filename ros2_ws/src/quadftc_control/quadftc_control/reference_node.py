# pyright: basic
"""The reference node: where the attitude shall be, from the scenario or live from a topic.

Inputs: imu/data (for its stamps), attitude/setpoint (Euler angles [rad], with ``source:=topic``).
Outputs: attitude/reference.
Services: ~/reset (std_srvs/Trigger): the next sample is scenario time 0.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import numpy as np

from quadftc_control.reference import SetpointFilter, reference_from
from quadftc_model.assembly import build_prefixed
from quadftc_model.parameters import parameter
from quadftc_model.samples import AttitudeReference, is_usable
from quadftc_model.stepper import Stepper, warm_up
from quadftc_ros.conversions import Floats
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.wire import ReferenceWire, vector_of

MAX_TILT = math.radians(80.0)  # rad; further, Euler angles are no sensible setpoint


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
        build = partial(build_prefixed, SetpointFilter, prefix="setpoint")
        self._filter = Stepper[Any, AttitudeReference](build(values))
        self._live = values["source"] == "topic"
        reference_from(values).at(0)  # as `warm_up` does
        warm_up(self._filter.law, np.zeros(3))
        self._restart()
        self.settings.on_change(build, partial(setattr, self._filter, "law"))
        self._publish = self.publishes("attitude/reference")
        self._message = ReferenceWire()
        self.driven_by("imu/data", self._on_imu, restart=self._restart, decode=bytes)  # for its stamp
        if self._live:
            self.reads("attitude/setpoint", self._on_setpoint, decode=vector_of)
        self.diagnostics.report("source", OK, values["source"])
        self.ready()

    def _restart(self) -> None:
        self._generator = reference_from(self.settings.values())
        self._filter.reset()
        self._setpoint = np.zeros(3)

    def _on_setpoint(self, stamp_ns: int, setpoint: Floats) -> None:
        if not is_usable(setpoint) or np.any(np.abs(setpoint[:2]) > MAX_TILT):
            self.diagnostics.count("attitude/setpoint is not finite or beyond 80 deg of tilt")
            return
        self._setpoint = setpoint

    def _on_imu(self, stamp_ns: int, _data: bytes) -> None:
        reference = (
            self._filter.step(stamp_ns, self._setpoint) if self._live else self._generator.at(stamp_ns)
        )
        if reference is None:
            self.diagnostics.count("imu/data: stamp repeated or went back")
            return
        self._publish(self._message(stamp_ns, reference))
        self.sampled(stamp_ns)


main = partial(run_node, ReferenceNode)
