"""The reference node: where the attitude shall be, from the scenario or live from a topic.

Inputs: imu/data (for its stamps), attitude/setpoint (Euler angles [rad], with ``source:=topic``).
Outputs: attitude/reference.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any

import numpy as np

from quadftc_control.assembly import reference_from
from quadftc_control.setpoint import SetpointFilter
from quadftc_model.parameters import build, parameter
from quadftc_model.samples import AttitudeReference
from quadftc_model.stepper import Stepper
from quadftc_ros.conversions import ReferenceWriter, array_of
from quadftc_ros.diagnostics import OK
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode

MAX_TILT = math.radians(80.0)  # rad; further, Euler angles are no sensible setpoint


@dataclasses.dataclass(frozen=True)
class ReferenceParameters:
    """Parameters of the reference node besides those of :class:`SetpointFilter`, behind ``setpoint.``."""

    source: str = parameter("scenario", choices=("scenario", "topic"), doc="from `references`, or attitude/setpoint")


class ReferenceNode(GraphNode):
    """A reference for every IMU sample."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("reference", **kwargs)
        self.settings.declare(ReferenceParameters, read_only=True)
        self.settings.declare(SetpointFilter, "setpoint.", read_only=True)
        self.settings.declare_list("references", "each: kind key=value..., e.g. 'step angles=5deg,0,0 start=5s'")
        values = self.settings.values()
        if values["source"] not in ("scenario", "topic"):
            raise ValueError(f"source = {values['source']!r}: expected one of scenario, topic")
        self._generator = reference_from(values)
        prefix = "setpoint."
        filter_values = {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)}
        self._filter: Stepper[Any, AttitudeReference] = Stepper(build(SetpointFilter, filter_values))
        self._live = values["source"] == "topic"
        self._setpoint = np.zeros(3)
        self._publish = self.publishes("attitude/reference")
        self._message = ReferenceWriter()
        self.reads_raw("imu/data", self._on_imu)
        if self._live:
            self.reads("attitude/setpoint", self._on_setpoint)
        self.diagnostics.report("source", OK, values["source"])
        self.ready()

    def _on_setpoint(self, stamp_ns: int, message: Any) -> None:
        setpoint = array_of(message.vector)
        if not np.all(np.isfinite(setpoint)) or np.any(np.abs(setpoint[:2]) > MAX_TILT):
            self.diagnostics.count("attitude/setpoint is not finite or beyond 80 deg of tilt")
            return
        self._setpoint = setpoint

    def _on_imu(self, stamp_ns: int, _data: bytes) -> None:
        reference = self._filter.step(stamp_ns, self._setpoint) if self._live else self._generator.at(stamp_ns)
        if reference is None:
            self.diagnostics.count("imu/data: stamp repeated or went back")
            return
        self._publish(self._message(stamp_ns, reference))
        self.sampled(stamp_ns)


def main() -> None:
    """Run the node."""
    sys.exit(run_node(ReferenceNode))
