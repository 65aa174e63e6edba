"""A plant as the physics of an autopilot's simulation, whatever its packets are.

Autopilots count along north, east, down and forward, right, down; here it is east, north, up and forward,
left, up.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Components
from quadftc_model.samples import ImuSample, level_sample, sanitised
from quadftc_model.vehicle import Vehicle
from quadftc_sim.injector import FaultInjector, Faulty
from quadftc_sim.simulator import Emission, Simulator

MakeSimulator = Callable[[float], Simulator]  # for a rate [Hz]
MakeInjector = Callable[[], FaultInjector]

DEGREE = 111318.84502145034  # m of latitude, as ArduPilot's Location has it


def to_degrees(home: Sequence[float], east: float, north: float) -> tuple[float, float]:
    """Latitude and longitude [deg] of a place [m] from a home, whose first two numbers are its own."""
    return home[0] + north / DEGREE, home[1] + east / (DEGREE * math.cos(math.radians(home[0])))


def speeds_of_shares(vehicle: Vehicle, shares: Sequence[float] | Array) -> Components:
    """Speeds [rad/s] that shares of the largest ask of the rotors, within their range."""
    rotors = vehicle.rotors
    return np.clip(rotors.speed_max * np.asarray(shares), rotors.speed_min, rotors.speed_max)


class Shown(NamedTuple):
    """What was answered last."""

    emission: Emission
    injected: Faulty | None  # the sample with its faults; None: it is on its way
    line: bytes
    command: Components | None  # rotor speeds under which it flew here [rad/s]; None: it begins here


class AutopilotPhysics:
    """Answers an autopilot's packets one by one, and counts what is wrong with them.

    ``make_simulator(rate)`` makes a vehicle at a rate [Hz], ``make_injector()`` its faults; both anew when
    the autopilot restarts. Faults put on before it starts stay. ``rate`` is that of the flight [Hz]; 0: the
    autopilot says it.
    """

    def __init__(self, make_simulator: MakeSimulator, make_injector: MakeInjector, rate: float = 0.0) -> None:
        self._make_simulator, self._make_injector, self._rate = make_simulator, make_injector, rate
        self._simulator: Simulator | None = None
        self._injector = make_injector()
        self._sample = level_sample()
        self.shown: Shown | None = None
        self.flights = 0  # how often a flight has begun
        self.counts: Counter[str] = Counter()  # packets by the field that was wrong
        self.complaint = ""  # about the last that was refused

    @property
    def heard(self) -> bool:
        """Whether the autopilot has said what it asks of the rotors, since the flight began."""
        return self.shown is not None and self.shown.command is not None

    def answer(self, data: bytes, sender: object = None) -> bytes | None:
        """Fly one period under the outputs of a packet; return the state; None for no such packet."""
        raise NotImplementedError

    def sent(self) -> None:
        """Note that an answer has gone out."""

    def encode(self, time: float, sample: ImuSample, emission: Emission) -> bytes:
        """Write a state: what the IMU says at a time [s], where the vehicle is, and its other sensors."""
        raise NotImplementedError

    def refuse(self, error: ValueError) -> None:
        """Count a packet that is none; the error begins with the field that is wrong."""
        self.counts[str(error).partition(":")[0]] += 1
        self.complaint = str(error)

    def begin(self, rate: float) -> Shown:
        """Begin a flight at a rate [Hz]; return its first state."""
        if self._simulator is not None:
            self._injector, self._sample = self._make_injector(), level_sample()
        self._simulator = self._make_simulator(rate)
        self.flights += 1
        return self._show(self._simulator.start(), self._simulator, None)

    def fly(self, command: Components, simulator: Simulator) -> Shown:
        """Fly one period under rotor speeds [rad/s]; return the state at its end."""
        return self._show(simulator.advance(command), simulator, command)

    def _show(self, emission: Emission, simulator: Simulator, command: Components | None) -> Shown:
        """Put the faults on a sample and on the rotors.

        Autopilots need all samples, so a value stays until the next one comes.
        """
        injected = None
        if emission.sample is not None:
            injected = self._injector.apply(emission.sample_stamp_ns, emission.sample)
            self._sample = held(injected, self._sample)
            simulator.set_rotors(injected.rotors)
        line = self.encode(simulator.time, self._sample, emission)
        self.shown = Shown(emission, injected, line, command)
        return self.shown


def held(injected: Faulty, last: ImuSample) -> ImuSample:
    """A sample in which every channel that is absent has its last value."""
    if not injected.present:
        return last
    new = sanitised(injected.sample)

    def channel(valid: Array, name: str) -> Array:
        return getattr(new if valid else last, name)

    return level_sample()._replace(
        q_xyzw=channel(new.attitude_valid, "q_xyzw"),
        body_rate=channel(new.rate_valid, "body_rate"),
        specific_force=channel(new.force_valid, "specific_force"),
    )
