# pyright: basic
"""The Betaflight backend: flies a simulated quadrotor for Betaflight's simulation (SITL), with faults.

    ros2 run quadftc_sim betaflight_backend --ros-args -p vehicle:=x500 -p "faults:=['bias channel=gyro ...']"
    obj/betaflight_4.6.0_SITL

Each state is answered by the firmware's motors, and by them the next period is flown. The firmware's clock
is that of the wall, at the pace at which states come, so the node keeps time, too. Parameters are those of
the plant and the fault injector. The vehicle stands on the ground at first. Whoever flies it sends RC to the
firmware's port 9004.
Outputs and services: those of `backend_node`.
"""

from __future__ import annotations

import dataclasses
import time
from functools import partial
from typing import Any

from quadftc_model.parameters import parameter
from quadftc_ros.executor import run_node
from quadftc_sim.autopilot import MakeInjector, MakeSimulator, Shown
from quadftc_sim.backend_node import BackendNode, BackendParameters
from quadftc_sim.betaflight import BetaflightPhysics

PATIENCE = 0.02  # s of the wall clock; how long a state waits for its motors, and how late it may be
SILENT = 25  # periods


@dataclasses.dataclass(frozen=True)
class BetaflightParameters(BackendParameters):
    """Parameters of the node besides those of the plant and of the IMU."""

    rate: float = parameter(1000.0, unit="Hz", low=100.0, high=4000.0, doc="of the states")
    speed: float = parameter(1.0, low=0.01, high=10.0, doc="simulated time over that of the wall, at most")
    firmware: str = parameter("127.0.0.1", doc="address of the firmware")
    state_port: int = parameter(9003, low=1, high=65535, doc="UDP port where it takes states")


class BetaflightBackendNode(BackendNode):
    """The physics behind Betaflight's simulation."""

    autopilot = "Betaflight"
    parameters = BetaflightParameters

    def __init__(self, **kwargs: Any) -> None:
        self._due = 0.0  # when the next state is to be sent [s]
        self._silent = 0  # periods without an answer
        super().__init__("betaflight_backend", **kwargs)

    def make_physics(self, make_simulator: MakeSimulator, make_injector: MakeInjector) -> BetaflightPhysics:
        """Return the physics behind Betaflight; it refuses what is no quadrotor."""
        if (rotors := len(self._vehicle.rotors.positions)) != 4:
            raise ValueError(f"vehicle = '{self._values['vehicle']}': expected 4 rotors, not {rotors}")
        return BetaflightPhysics(make_simulator, make_injector, self._values["rate"])

    def exchange(self) -> list[Shown]:
        """Send the state when it is due, and fly by the motors that answer it.

        Without an answer the last motors act: the firmware's clock would stand still if states waited for it.
        After `SILENT` such periods nothing waits for it any more, until it speaks again.
        """
        physics, period = self.physics, 1.0 / (self._values["rate"] * self._values["speed"])
        if (early := self._due - time.monotonic()) > 0.0:
            time.sleep(early)
        self._due = max(self._due, time.monotonic() - PATIENCE) + period
        with self._faults.lock:
            state = physics.state()
        self.send(state, (self._values["firmware"], self._values["state_port"]))
        if packets := self.packets(PATIENCE if self._silent < SILENT or not physics.heard else 0.0):
            self._silent = 0
            return [] if self.answer(*packets[-1]) is None else [physics.shown]
        if not physics.heard:
            return []
        self._silent += 1
        with self._faults.lock:
            physics.hold()
        return [physics.shown]


main = partial(run_node, BetaflightBackendNode)
