"""Our vehicle behind the firmware, in lock-step: each packet of its outputs gets one sample of our sensors.

    packet of servo outputs -> rotors -> plant -> IMU -> faults -> answer
                                                      -> fault observer, bag, pilot

The pilot acts before the answer is sent, while the firmware waits. So all that it hears from us reaches it at
the same sample of its clock, however busy the machine is.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import select
import socket
from collections import deque
from typing import Any

import numpy as np

from quadftc_compile.engine import engine_named
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_flight.scenario import node_parameters
from quadftc_model.arrays import Components
from quadftc_model.samples import DiagnosisReport, PositionReference, RotorReading, level_sample
from quadftc_sim.assembly import EPOCH_NS, simulator_from
from quadftc_sim.autopilot import Shown
from quadftc_sim.injector import FaultInjector
from quadftc_sim.simulator import Simulator
from quadftc_sim.vehicle_simulation import FreeMotion
from quadftc_sitl.autopilot import Server
from quadftc_sitl.firmware import Firmware, SitlError
from quadftc_sitl.plan import SitlPlan
from quadftc_sitl.recording import Recorder

PATIENCE = 20.0  # s of the wall clock; without a packet the firmware hangs
LOOK = 0.5  # s; how often it is looked whether the firmware lives
PACKET = 2048  # bytes
TILT, SPEED, FAR = math.radians(75.0), 2.5, 50.0  # rad, m/s, m; beyond these the vehicle is lost
NEAR_GROUND = 0.1  # m; between the feet and the ground, where speed is that of an impact
REST = 0.1  # m/s; slower it stands, near the ground


class Physics:
    """The physics of one flight, with the fault observer beside it."""

    def __init__(self, plan: SitlPlan, start: tuple[float, float], engine: str = "c") -> None:
        """Take what is flown, and where it stands at first, east and north [m]."""
        self.plan, self._engine = plan, engine_named(engine)
        scenario = plan.scenario
        values = node_parameters(scenario, plan.scheme)["plant"]
        plant: Any = scenario.plant
        self.stand = -float(plant.feet[0, 2])  # m; its height on the ground
        values |= {**plan.autopilot.sensors, "start": [*start, self.stand]}
        self._values: dict[str, object] = {**values}
        self.injector = FaultInjector(scenario.seed, (), plant.command_size, self._engine)
        self._physics = plan.autopilot.physics(self._simulator, lambda: self.injector, plan.rate)
        self._diagnosis = Diagnosis(plan.scheme.observer.law, self._engine, flies=True)
        self._vehicle = plant.vehicle
        self.law = self._simulator(plan.rate).law  # of its motion
        self._speeds: deque[Components] = deque(maxlen=scenario.sensor.delay + 1)
        self.reports: list[DiagnosisReport] = []
        self.begin_ns: int | None = None  # stamp of scenario time 0
        self.last: Shown | None = None
        self._warm_up()

    @property
    def now(self) -> float:
        """Time of the physics [s]."""
        return 0.0 if self.last is None else 1e-9 * (self.last.emission.stamp_ns - EPOCH_NS)

    def begin(self) -> None:
        """Let scenario time begin at the next sample, and the faults with it."""
        assert self.last is not None
        self.begin_ns = self.last.emission.stamp_ns
        for fault in self.plan.scenario.faults:
            injection = fault.injection
            start, stop = injection.start + self.now, injection.stop + self.now
            self.injector.add(dataclasses.replace(injection, start=start, stop=stop))

    def answer(self, data: bytes, recorder: Recorder) -> tuple[bytes | None, Shown | None]:
        """Answer a packet; return the line, and what it shows, None for a repeated or wrong packet."""
        line, shown = self._physics.answer(data), self._physics.shown
        if line is None or shown is None or shown is self.last:
            return line, None
        if self._physics.flights > 1:
            raise SitlError("the firmware has restarted in flight")
        before, self.last = self.last, shown
        commanded_ns = None
        if before is not None and before.injected is not None and before.injected.present:
            commanded_ns = before.emission.sample_stamp_ns
        recorder.note(shown, commanded_ns)
        if (report := self._observe(shown)) is not None:
            self.reports.append(report)
            recorder.report(report)
        return line, shown

    def sent(self) -> None:
        """Note that an answer has gone out."""
        self._physics.sent()

    def wrong_packets(self) -> dict[str, int]:
        """Return how many packets were wrong, by what was wrong."""
        return dict(self._physics.counts)

    def _observe(self, shown: Shown) -> DiagnosisReport | None:
        """Run the fault observer over a sample that has come; return what it reports, if that is due."""
        assert shown.emission.flight is not None
        self._speeds.append(shown.emission.flight.speeds)
        if shown.injected is None or not shown.injected.present or shown.command is None:
            return None
        rotors = RotorReading(shown.command, self._speeds[0], np.True_)
        stamp_ns = shown.emission.sample_stamp_ns
        place = None if self.plan.scenario.position_sensor is None else shown.emission.place
        estimate = self._diagnosis.diagnose(stamp_ns, shown.injected.sample, rotors=rotors, place=place)
        return None if estimate is None else self._diagnosis.report(stamp_ns, estimate)

    def _simulator(self, rate: float) -> Simulator:
        return simulator_from({**self._values, "rate": rate}, EPOCH_NS, self._engine)

    def _warm_up(self) -> None:
        """Compile the laws before the firmware waits for them."""
        simulator = self._simulator(self.plan.rate)
        simulator.start()
        law = Diagnosis(self.plan.scheme.observer.law, self._engine, flies=True)
        speeds = np.full(simulator.plant.command_size, self._vehicle.hover_speed)
        law.diagnose(EPOCH_NS, level_sample(), rotors=RotorReading(speeds, speeds, np.True_))


class Fate:
    """Whether the vehicle is lost, by the truth."""

    def __init__(self, stand: float) -> None:
        """Take the height at which it stands on the ground [m]."""
        self._stand, self._speed = stand, 0.0
        self.words = ""  # how it was lost; empty: it was not
        self.stands = True  # on the ground, at rest

    def step(self, motion: FreeMotion, reference: PositionReference) -> bool:
        """Look at a sample of the flight; return whether the vehicle is lost."""
        x, y = motion.q_xyzw[:2]
        tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))
        off = math.dist(motion.position, reference.position)
        speed, self._speed = self._speed, math.sqrt(float(np.dot(motion.velocity, motion.velocity)))
        near_ground = motion.position[2] < self._stand + NEAR_GROUND
        self.stands = near_ground and self._speed < REST
        if self.words:
            return True
        if near_ground and speed > SPEED:
            self.words = f"hit the ground at {speed:.1f} m/s"
        elif tilt > TILT:
            self.words = f"tilted by {math.degrees(tilt):.0f} deg"
        elif off > FAR:
            self.words = f"{off:.0f} m from where it should be"
        return bool(self.words)


class PhysicsSocket(Server):
    """A UDP socket, whose peer is who speaks first."""

    KIND = socket.SOCK_DGRAM

    def __init__(self) -> None:
        super().__init__()
        self._socket.setblocking(False)
        self._peer: Any = None

    def wait(self, firmware: Firmware, spoke: float) -> list[bytes]:
        """Return the packets that have come; `SitlError` if the firmware has ended or hangs."""
        for _ in range(int(PATIENCE / LOOK)):
            if packets := self.take(LOOK):
                return packets
            firmware.check_alive()
        since = "sends nothing to its physics" if self._peer is None else "hangs: it has sent nothing more"
        raise SitlError(f"{firmware.arguments[0]}: {since} for {PATIENCE:g} s{firmware.last_words()}")

    def take(self, patience: float) -> list[bytes]:
        """Return the packets that have come, waiting so long [s] for the first."""
        found: list[bytes] = []
        select.select([self._socket], [], [], patience)
        with contextlib.suppress(OSError):  # no more, or the firmware has gone
            while True:
                data, sender = self._socket.recvfrom(PACKET)
                if self._peer is None and len(data) > 8:
                    self._peer = sender
                if sender == self._peer:
                    found.append(data)
                else:
                    self.strangers += 1
        return found

    def send(self, line: bytes) -> None:
        """Send an answer."""
        with contextlib.suppress(OSError):
            self._socket.sendto(line, self._peer)
