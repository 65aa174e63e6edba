# pyright: basic
"""The ArduPilot backend: flies a simulated vehicle for ArduPilot's simulation (SITL), with faults.

    ros2 run quadftc_sim ardupilot_backend --ros-args -p vehicle:=x500 -p "faults:=['bias channel=gyro ...']"
    sim_vehicle.py -v ArduCopter --model JSON:127.0.0.1

SITL asks over UDP for one period after the other, and waits for each: it makes time. Parameters are those of
the plant and the fault injector. The vehicle stands on the ground at first.
Outputs: imu/data (with its faults, as SITL gets it); rotors/command and torque/command, which SITL's pulses
ask for after a sample, without the rotors' lag; the truth on plant/attitude, plant/rate, plant/odometry,
rotors/speed and wind/applied; what the fault injector says of its faults.
Services: fault_injector/inject and fault_injector/clear, as of the fault injector, whose place it takes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import select
import socket
import threading
import time
from functools import partial
from typing import Any

from quadftc_compile.engine import engine_from
from quadftc_model.parameters import parameter
from quadftc_model.rotors import wrench_from_speeds
from quadftc_ros.diagnostics import OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.motion_wire import RotorsWire
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import EARTH_FRAME
from quadftc_ros.wire import VectorWire
from quadftc_sim.ardupilot import ArduPilotPhysics, Shown
from quadftc_sim.assembly import injector_from, simulator_from
from quadftc_sim.injector_ports import InjectorPorts
from quadftc_sim.plant import plants
from quadftc_sim.plant_output import FlightOutput
from quadftc_sim.sensors import GRADES, ImuSensor
from quadftc_sim.simulator import Simulator

LOOK = 0.1  # s; how often the socket's thread looks whether it is to end
PACKET = 2048  # bytes; more than any packet has
MOST = 100  # packets that are read before they are answered


@dataclasses.dataclass(frozen=True)
class BackendParameters:
    """Parameters of the node besides those of the plant and of the IMU."""

    plant: str = parameter("free_flight", doc="name of the plant; it must fly")
    vehicle: str = parameter("x500", doc="name of a vehicle, or path of its TOML file; rotors as ArduPilot's")
    seed: int = parameter(0, low=0, doc="of the sensor's noise and bias, and of random faults")
    imu_grade: str = parameter(
        "mems", choices=(*GRADES,), doc="which numbers the parameters imu.* begin with; ideal: no noise"
    )
    address: str = parameter("127.0.0.1", doc="of this machine, where SITL's packets come; 0.0.0.0: any")
    port: int = parameter(9002, low=0, high=65535, doc="UDP port there; 0: any that is free")


class ArduPilotBackendNode(GraphNode):
    """The physics behind ArduPilot's simulation."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("ardupilot_backend", **kwargs)
        self.settings.declare(BackendParameters, read_only=True)
        law = plants.get(self.settings.values()["plant"])
        if not law.flies:
            raise ValueError(f"plant = '{self.settings.values()['plant']}': expected one that flies")
        self.settings.declare(law, read_only=True)
        grade = GRADES[self.settings.values()["imu_grade"]]
        self.settings.declare(ImuSensor, "imu.", read_only=True, defaults=grade)
        for name in ("winds", "disturbances", "faults"):
            self.settings.declare_list(name, "each: kind key=value..., as of plant and fault_injector")
        self._values = self.settings.values()
        self._engine = engine_from(self._values, self.get_logger().info)
        simulator = self._simulator(400.0)  # refuses wrong values now
        plant: Any = simulator.plant
        self._values |= {"start": [*plant.start[:2], -plant.feet[0, 2]], "rotors": plant.command_size}
        make = partial(injector_from, self._values, self._engine)
        self._faults = InjectorPorts(self, make, plant.command_size, flies=True, under="fault_injector")
        self.physics = ArduPilotPhysics(self._simulator, self._faults.restart)
        self._vehicle = plant.vehicle
        self._publish_speeds = self.publishes("rotors/command")
        self._speeds = RotorsWire(plant.command_size, self.base_frame)
        self._publish_torque, self._body = self.publishes("torque/command"), VectorWire(self.base_frame)
        self._publish_attitude, self._earth = self.publishes("plant/attitude"), VectorWire(EARTH_FRAME)
        self._publish_rate = self.publishes("plant/rate")
        self._flight = FlightOutput(self, simulator.law)
        self._socket = self._open_socket()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="sitl", daemon=True)
        self._thread.start()
        self.ready()

    @property
    def port(self) -> int:
        """The UDP port that it listens on."""
        return self._socket.getsockname()[1]

    def connections(self) -> dict[str, int]:
        """Return none: SITL flies the vehicle, and whoever likes reads the topics."""
        return {}

    def report(self) -> None:
        """Report whether SITL is there, how many packets were wrong, and the faults that act."""
        physics, values = self.physics, {name.replace(" ", "_"): n for name, n in self.physics.counts.items()}
        words = "SITL flies" if physics.flights else f"waiting for SITL on UDP port {self.port}"
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

    def _simulator(self, rate: float) -> Simulator:
        return simulator_from({**self._values, "rate": rate}, time.time_ns(), self._engine)

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
        """Answer SITL until the node ends, then publish each sample.

        SITL repeats a packet that it has waited a second for, as when laws are compiled. All repetitions get
        one answer: it would take a second one for that to its next packet, and lag from then on.
        """
        last: Shown | None = None
        while not self._ending.is_set():
            answers: dict[Any, bytes] = {}  # by sender
            new: list[Shown] = []
            for patience in (LOOK, 0.0):  # the second time for what has come meanwhile
                for data, sender in self._packets(patience):
                    with self._faults.lock:
                        line, shown = self.physics.answer(data), self.physics.shown
                    if line is not None and shown is not None:
                        answers[sender] = line
                        new += [] if shown is (new[-1] if new else last) else [shown]
            for sender, line in answers.items():
                with contextlib.suppress(OSError):  # SITL has gone
                    self._socket.sendto(line, sender)
            for shown in new:
                if last is not None:
                    self._show_command(last, shown)
                self._show(shown)
                last = shown

    def _packets(self, patience: float) -> list[tuple[bytes, Any]]:
        """Return the packets that have come, with their senders; wait [s] for the first."""
        select.select([self._socket], [], [], patience)
        found: list[tuple[bytes, Any]] = []
        with contextlib.suppress(OSError):  # no more, or SITL has gone and its port refused our last answer
            while len(found) < MOST:
                found.append(self._socket.recvfrom(PACKET))
        return found

    def _show_command(self, last: Shown, shown: Shown) -> None:
        """Publish how SITL has answered a sample: what it asks of the rotors."""
        if shown.command is None or last.injected is None or not last.injected.present:
            return
        stamp_ns = last.emission.sample_stamp_ns
        torque, _ = wrench_from_speeds(self._vehicle, shown.command)
        self._publish_speeds(self._speeds(stamp_ns, shown.command))
        self._publish_torque(self._body(stamp_ns, torque))

    def _show(self, shown: Shown) -> None:
        """Publish a sample as SITL got it, and the truth."""
        emission = shown.emission
        if shown.injected is not None:
            self._faults.publish(emission.sample_stamp_ns, shown.injected)
        self._publish_attitude(self._earth(emission.stamp_ns, emission.angles))
        self._publish_rate(self._body(emission.stamp_ns, emission.body_rate))
        self._flight.show_truth(emission)


main = partial(run_node, ArduPilotBackendNode)
