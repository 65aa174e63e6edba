# pyright: basic
"""What the nodes that stand behind an autopilot's simulation share: vehicle, faults, truth, and their topics.

Outputs: imu/data, with its faults, as the autopilot gets it. rotors/command and torque/command, which the
autopilot asks for after a sample, without the rotors' lag. The truth on plant/attitude, plant/rate,
plant/odometry, rotors/speed and wind/applied. What the fault injector says of its faults.
Services: fault_injector/inject and fault_injector/clear, as of the fault injector, whose place it takes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import select
import socket
import threading
from functools import partial
from typing import Any, ClassVar

from quadftc_compile.engine import engine_from
from quadftc_model.parameters import parameter
from quadftc_model.rotors import wrench_from_speeds
from quadftc_ros.conversions import wall_ns
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.motion_wire import RotorsWire
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import VectorWire
from quadftc_sim.assembly import injector_from, simulator_from
from quadftc_sim.autopilot import AutopilotPhysics, MakeInjector, MakeSimulator, Shown
from quadftc_sim.injector_ports import InjectorPorts
from quadftc_sim.plant import plants
from quadftc_sim.plant_output import FlightOutput
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.simulator import Simulator
from quadftc_sim.vehicle_simulation import VehicleSimulation

LOOK = 0.1  # s; how often the socket's thread looks whether it is to end
PACKET = 2048  # bytes; more than any packet has
Address = tuple[str, int]  # of a UDP socket

MOST = 100  # packets that are read before they are answered


@dataclasses.dataclass(frozen=True)
class BackendParameters:
    """Parameters of a backend besides those of the plant and of the IMU."""

    plant: str = parameter("free_flight", doc="name of the plant; it must fly")
    vehicle: str = parameter("x500", doc="name of a vehicle, or path of its TOML file; rotors as ArduPilot's")
    seed: int = parameter(0, low=0, doc="of the sensor's noise and bias, and of random faults")
    imu_grade: str = parameter(
        "mems", choices=(*GRADES,), doc="which numbers the parameters imu.* begin with; ideal: no noise"
    )
    address: str = parameter(
        "127.0.0.1", doc="of this machine, where the autopilot's packets come; 0.0.0.0: any"
    )
    port: int = parameter(9002, low=0, high=65535, doc="UDP port there; 0: any that is free")


class BackendOutput:
    """What is published of a vehicle that an autopilot flies, a `law` of motion with `faults`."""

    def __init__(self, node: GraphNode, law: VehicleSimulation, faults: InjectorPorts) -> None:
        plant = law.plant
        self._vehicle, self._faults = plant.vehicle, faults
        self._publish_speeds = node.publishes("rotors/command")
        self._speeds = RotorsWire(plant.command_size, node.base_frame)
        self._publish_torque, self._body = node.publishes("torque/command"), VectorWire(node.base_frame)
        self._publish_attitude, self._earth = node.publishes("plant/attitude"), VectorWire(EARTH_FRAME)
        self._publish_rate = node.publishes("plant/rate")
        self._flight = FlightOutput(node, law)
        self._last: Shown | None = None

    def show(self, shown: Shown) -> None:
        """Publish a sample as the autopilot got it, the truth, and how the one before was answered."""
        if self._last is not None:
            self._show_command(self._last, shown)
        emission, self._last = shown.emission, shown
        if shown.injected is not None:
            self._faults.publish(emission.sample_stamp_ns, shown.injected)
        self._publish_attitude(self._earth(emission.stamp_ns, emission.angles))
        self._publish_rate(self._body(emission.stamp_ns, emission.body_rate))
        self._flight.show_truth(emission)

    def _show_command(self, last: Shown, shown: Shown) -> None:
        """Publish what the autopilot asks of the rotors after a sample."""
        if shown.command is None or last.injected is None or not last.injected.present:
            return
        stamp_ns = last.emission.sample_stamp_ns
        torque, _ = wrench_from_speeds(self._vehicle, shown.command)
        self._publish_speeds(self._speeds(stamp_ns, shown.command))
        self._publish_torque(self._body(stamp_ns, torque))


class BackendNode(GraphNode):
    """The physics behind an autopilot's simulation."""

    autopilot: ClassVar[str]  # how it is called in what the node says
    parameters: ClassVar[type] = BackendParameters

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.settings.declare(self.parameters, read_only=True)
        law = plants.get(self.settings.values()["plant"])
        if not law.flies:
            raise ValueError(f"plant = '{self.settings.values()['plant']}': expected one that flies")
        self.settings.declare(law, read_only=True)
        grade = GRADES[self.settings.values()["imu_grade"]]
        self.settings.declare(ImuSensor, "imu.", read_only=True, defaults=grade)
        for each in ("winds", "disturbances", "faults"):
            self.settings.declare_list(each, "each: kind key=value..., as of plant and fault_injector")
        self._values = self.settings.values()
        self._engine = engine_from(self._values, self.get_logger().info)
        simulator = self._simulator(self._values.get("rate", 400.0))  # refuses wrong values now
        plant: Any = simulator.plant
        self._values |= {"start": [*plant.start[:2], -plant.feet[0, 2]], "rotors": plant.command_size}
        make = partial(injector_from, self._values, self._engine)
        self._faults = InjectorPorts(self, make, plant.command_size, flies=True, under="fault_injector")
        self._vehicle = plant.vehicle
        self._output = BackendOutput(self, simulator.law, self._faults)
        self.physics: Any = self.make_physics(self._simulator, self._faults.restart)
        self._socket = self._open_socket()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="autopilot", daemon=True)
        self._thread.start()
        self.ready()

    def make_physics(self, make_simulator: MakeSimulator, make_injector: MakeInjector) -> AutopilotPhysics:
        """Return the physics that speaks this autopilot's packets."""
        raise NotImplementedError

    def exchange(self) -> list[Shown]:
        """Exchange packets with the autopilot once; return what was flown, after `LOOK` at the latest."""
        raise NotImplementedError

    @property
    def port(self) -> int:
        """The UDP port that it listens on."""
        return self._socket.getsockname()[1]

    def connections(self) -> dict[str, int]:
        """Return none: the autopilot flies the vehicle, and whoever likes reads the topics."""
        return {}

    def report(self) -> None:
        """Report whether the autopilot is there, how many packets were wrong, and the faults that act."""
        physics, values = self.physics, {name.replace(" ", "_"): n for name, n in self.physics.counts.items()}
        waiting = f"waiting for {self.autopilot} on UDP port {self.port}"
        words = f"{self.autopilot} flies" if physics.heard else waiting
        level = WARN if physics.complaint else OK
        words += f"; refused: {physics.complaint}" if physics.complaint else ""
        self.diagnostics.report("sitl", level, words, starts=physics.flights, **values)
        level, words, active = self._faults.status()
        self.diagnostics.report("faults", level, words, **active)

    def destroy_node(self) -> None:
        """End the thread, then the node."""
        self._ending.set()
        self._thread.join()
        self._socket.close()
        super().destroy_node()

    def answer(self, data: bytes, sender: Address) -> bytes | None:
        """Answer a packet, while no service changes the faults."""
        with self._faults.lock:
            return self.physics.answer(data, sender)

    def packets(self, patience: float) -> list[tuple[bytes, Address]]:
        """Return the packets that have come, with their senders; wait [s] for the first."""
        select.select([self._socket], [], [], patience)
        found: list[tuple[bytes, Address]] = []
        with contextlib.suppress(OSError):  # no more, or the autopilot has gone and refused our last answer
            while len(found) < MOST:
                found.append(self._socket.recvfrom(PACKET))
        return found

    def send(self, data: bytes, receiver: Address) -> None:
        """Send a state."""
        with contextlib.suppress(OSError):  # the autopilot has gone
            self._socket.sendto(data, receiver)

    def _simulator(self, rate: float) -> Simulator:
        return simulator_from({**self._values, "rate": rate}, wall_ns(), self._engine)

    def _open_socket(self) -> socket.socket:
        address, port = self._values["address"], self._values["port"]
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.bind((address, port))
        except OSError as error:
            opened.close()
            raise ValueError(f"address = '{address}', port = {port}: {error.strerror}") from None
        opened.setblocking(False)
        return opened

    def _serve(self) -> None:
        """Fly until the node ends, and publish each sample."""
        while not self._ending.is_set():
            for shown in self.exchange():
                self._output.show(shown)
