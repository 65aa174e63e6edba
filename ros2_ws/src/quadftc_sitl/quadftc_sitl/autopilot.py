"""What differs from one autopilot to another: packets, start, parameters, how it flies and what it means.

Each has a module of its own, `ardupilot` or `px4`; all else asks `SitlPlan.autopilot`.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from quadftc_sim.autopilot import AutopilotPhysics
from quadftc_sim.injector import FaultInjector
from quadftc_sim.simulator import Simulator

if TYPE_CHECKING:
    from quadftc_sitl.firmware import Firmware
    from quadftc_sitl.link import MavlinkLink
    from quadftc_sitl.pilot import Pilot
    from quadftc_sitl.plan import SitlPlan

NAMES = ("ardupilot", "px4")


class Server(Protocol):
    """Where the firmware's packets come in."""

    port: int
    strangers: int  # packets from elsewhere

    def wait(self, firmware: Firmware, spoke: float) -> list[bytes]:
        """Return what has come; `SitlError` if the firmware has ended or hangs.

        ``spoke``: when it said something over MAVLink, by the monotonic clock [s].
        """
        ...

    def take(self, patience: float) -> list[bytes]:
        """Return what has come, waiting so long [s] for the first."""
        ...

    def send(self, line: bytes) -> None:
        """Send an answer."""
        ...

    def close(self) -> None:
        """Close its sockets."""
        ...


class Start(NamedTuple):
    """How a firmware is started."""

    arguments: list[str]
    environment: Mapping[str, str] = {}  # besides ours


class Autopilot(abc.ABC):
    """One kind of autopilot."""

    name: ClassVar[str]  # one of `NAMES`
    title: ClassVar[str]
    sensors: ClassVar[Mapping[str, Any]]  # parameters of the plant: what it gets from us besides the IMU
    takes_failures: ClassVar[bool] = False  # by MAV_CMD_INJECT_FAILURE

    @abc.abstractmethod
    def rate(self, plan: SitlPlan) -> float:
        """Return the rate [Hz] of physics and IMU."""

    @abc.abstractmethod
    def parameters(self, plan: SitlPlan) -> dict[str, float]:
        """Return what the vehicle needs; those of a scenario and of files come on top."""

    @abc.abstractmethod
    def server(self, port: int) -> Server:
        """Open where its packets come in, at a port of this machine; 0: any that is free."""

    @abc.abstractmethod
    def start(self, binary: Path, folder: Path, physics_port: int, mavlink_port: int) -> Start:
        """Write what it reads at its start into its folder; return how it is started."""

    @abc.abstractmethod
    def physics(
        self,
        make_simulator: Callable[[float], Simulator],
        make_injector: Callable[[], FaultInjector],
        rate: float,
    ) -> AutopilotPhysics:
        """Return the physics behind its packets."""

    @abc.abstractmethod
    def pilot(self, plan: SitlPlan, link: MavlinkLink, begin: Callable[[], None]) -> Pilot:
        """Return who flies it."""

    @abc.abstractmethod
    def log(self, folder: Path) -> Path | None:
        """Return the last log that it has left in its folder; None: there is none."""

    def tidy(self, start: Start) -> None:  # noqa: B027
        """Remove what it has left outside its folder."""


def autopilot_named(name: str) -> Autopilot:
    """Return an autopilot by its name."""
    if name == "px4":
        from quadftc_sitl.px4 import PX4

        return PX4()
    from quadftc_sitl.ardupilot import ArduPilot

    return ArduPilot()
