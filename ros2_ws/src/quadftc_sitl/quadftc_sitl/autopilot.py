"""What differs from one autopilot to another: packets, start, parameters, how it flies and what it means.

Each has a module of its own, `ardupilot` or `px4`; all else asks `SitlPlan.autopilot`.
"""

from __future__ import annotations

import abc
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

from quadftc_model.assembly import NodeParameters
from quadftc_sim.autopilot import AutopilotPhysics
from quadftc_sim.injector import FaultInjector
from quadftc_sim.simulator import Simulator
from quadftc_sitl.firmware import LOOPBACK, Firmware, SitlError

if TYPE_CHECKING:
    from quadftc_sitl.pilot import Pilot
    from quadftc_sitl.plan import SitlPlan

NAMES = ("ardupilot", "px4")


class Server(abc.ABC):
    """Where the firmware's packets come in, on loopback; who else sends there is not answered."""

    KIND: ClassVar[socket.SocketKind]

    def __init__(self) -> None:
        """Take any port that is free."""
        self._socket = socket.socket(socket.AF_INET, self.KIND)
        try:
            self._socket.bind((LOOPBACK, 0))
        except OSError as error:
            self._socket.close()
            raise SitlError(f"{LOOPBACK}: {error.strerror}") from None
        self.port = int(self._socket.getsockname()[1])
        self.strangers = 0  # packets from elsewhere

    def close(self) -> None:
        """Close its sockets."""
        self._socket.close()

    @abc.abstractmethod
    def wait(self, firmware: Firmware, spoke: float) -> list[bytes]:
        """Return what has come; `SitlError` if the firmware has ended or hangs.

        ``spoke``: when it said something over MAVLink, by the monotonic clock [s].
        """

    @abc.abstractmethod
    def take(self, patience: float) -> list[bytes]:
        """Return what has come, waiting so long [s] for the first."""

    @abc.abstractmethod
    def send(self, line: bytes) -> None:
        """Send an answer."""


class MakePhysics(Protocol):
    """Makes the physics behind the packets of an autopilot, at a rate [Hz]."""

    def __call__(  # noqa: D102
        self,
        make_simulator: Callable[[float], Simulator],
        make_injector: Callable[[], FaultInjector],
        rate: float,
    ) -> AutopilotPhysics: ...


class Start(NamedTuple):
    """How a firmware is started."""

    arguments: list[str]
    environment: Mapping[str, str] = {}  # besides ours


class Autopilot(abc.ABC):
    """One kind of autopilot."""

    name: ClassVar[str]  # one of `NAMES`
    title: ClassVar[str]
    sensors: ClassVar[NodeParameters]  # parameters of the plant: what it gets from us besides the IMU
    takes_failures: ClassVar[bool] = False  # by MAV_CMD_INJECT_FAILURE
    logs: ClassVar[str]  # pattern of the logs that it leaves in its folder
    server: ClassVar[type[Server]]
    physics: ClassVar[MakePhysics]
    pilot: ClassVar[type[Pilot]]  # who flies it

    @abc.abstractmethod
    def rate(self, plan: SitlPlan) -> float:
        """Return the rate [Hz] of physics and IMU."""

    @abc.abstractmethod
    def parameters(self, plan: SitlPlan) -> dict[str, float]:
        """Return what the vehicle needs; those of a scenario and of files come on top."""

    @abc.abstractmethod
    def start(self, binary: Path, folder: Path, physics_port: int, mavlink_port: int) -> Start:
        """Write what it reads at its start into its folder; return how it is started."""

    def log(self, folder: Path) -> Path | None:
        """Return the last log that it has left in its folder; None: there is none."""
        return max(folder.glob(self.logs), default=None)

    def tidy(self, start: Start) -> None:  # noqa: B027
        """Remove what it has left outside its folder."""


def autopilot_named(name: str) -> Autopilot:
    """Return an autopilot by its name."""
    if name == "px4":
        from quadftc_sitl.px4 import PX4

        return PX4()
    from quadftc_sitl.ardupilot import ArduPilot

    return ArduPilot()
