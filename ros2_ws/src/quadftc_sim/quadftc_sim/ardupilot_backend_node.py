# pyright: basic
"""The ArduPilot backend: flies a simulated vehicle for ArduPilot's simulation (SITL), with faults.

    ros2 run quadftc_sim ardupilot_backend --ros-args -p vehicle:=x500 -p "faults:=['bias channel=gyro ...']"
    sim_vehicle.py -v ArduCopter --model JSON:127.0.0.1

SITL asks over UDP for one period after the other, and waits for each: it makes time. Parameters are those of
the plant and the fault injector. The vehicle stands on the ground at first.
Outputs and services: those of `backend_node`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from quadftc_ros.executor import run_node
from quadftc_sim.ardupilot import ArduPilotPhysics
from quadftc_sim.autopilot import MakeInjector, MakeSimulator, Shown
from quadftc_sim.backend_node import LOOK, Address, BackendNode


class ArduPilotBackendNode(BackendNode):
    """The physics behind ArduPilot's simulation."""

    autopilot = "SITL"

    def __init__(self, **kwargs: Any) -> None:
        self._last: Shown | None = None
        super().__init__("ardupilot_backend", **kwargs)

    def make_physics(self, make_simulator: MakeSimulator, make_injector: MakeInjector) -> ArduPilotPhysics:
        """Return the physics behind SITL."""
        return ArduPilotPhysics(make_simulator, make_injector)

    def exchange(self) -> list[Shown]:
        """Answer what SITL asks; what it repeated meanwhile, as when laws are compiled, gets one answer."""
        answers: dict[Address, bytes] = {}  # by sender
        new: list[Shown] = []
        for data, sender in self.packets(LOOK):
            line, shown = self.answer(data, sender), self.physics.shown
            if line is not None and shown is not None:
                answers[sender] = line
                new += [] if shown is self._last else [shown]
                self._last = shown
        for sender, line in answers.items():
            self.send(line, sender)
            self.physics.sent()
        return new


main = partial(run_node, ArduPilotBackendNode)
