"""ArduPilot's JSON interface: a plant as the physics of its simulation (SITL, ``--model JSON``).

Layout of the packets: ArduPilot, libraries/SITL/examples/JSON/readme.md and SIM_JSON.h. SITL sends a packet
of servo outputs and waits for a line of JSON with the state. Its earth axes are north, east, down, its body
axes forward, right, down; ours are east, north, up and forward, left, up.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Components, Quaternion, Vector
from quadftc_model.rotations import quaternion_product
from quadftc_model.samples import ImuSample, level_sample, sanitised
from quadftc_model.vehicle import Vehicle
from quadftc_sim.assembly import period_ns
from quadftc_sim.injector import FaultInjector, Faulty
from quadftc_sim.simulator import Emission, Simulator
from quadftc_sim.vehicle_simulation import FreeMotion

HEADER = struct.Struct("<HHI")  # magic, frame_rate [Hz], frame_count
CHANNELS = {18458: 16, 29569: 32}  # magic -> numbers of pwm that follow, uint16 [us]
SLOWEST, FASTEST = 50, 4000  # Hz; frame rates that the plant can be flown at
LOWEST, HIGHEST = 1000, 2000  # us; pwm of a motor that stands, and of one at its largest speed
NED_OF_ENU = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])  # x, y, z, w: half a turn about north-east
FLU_OF_FRD = np.array([1.0, 0.0, 0.0, 0.0])  # half a turn about the nose


class ServoPacket(NamedTuple):
    """What SITL sends."""

    frame_rate: int  # at which it wants to be answered [Hz] of simulated time
    frame_count: int  # counts up from its start
    pwm: tuple[int, ...]  # of channel 1, 2, ... [us]


def read_servos(data: bytes) -> ServoPacket:
    """Read a packet of servo outputs; a ValueError says what is wrong with it."""
    if len(data) < HEADER.size:
        raise ValueError(f"length: {len(data)} bytes, expected at least {HEADER.size}")
    magic, frame_rate, frame_count = HEADER.unpack_from(data)
    if magic not in CHANNELS:
        raise ValueError(f"magic: {magic}, expected {' or '.join(map(str, CHANNELS))}")
    size = HEADER.size + 2 * CHANNELS[magic]
    if len(data) != size:
        raise ValueError(f"length: {len(data)} bytes, expected {size} with magic {magic}")
    if not SLOWEST <= frame_rate <= FASTEST:
        raise ValueError(f"frame_rate: {frame_rate} Hz, expected {SLOWEST} to {FASTEST}")
    return ServoPacket(frame_rate, frame_count, struct.unpack_from(f"<{CHANNELS[magic]}H", data, HEADER.size))


def rotor_speeds(vehicle: Vehicle, pwm: Sequence[int]) -> Components:
    """Speeds [rad/s] that the first channels ask of the rotors, in their order, within the rotors' range.

    The speed is in proportion to the pulse, so the thrust to its square: ArduPilot's ``MOT_THST_EXPO`` 1.
    """
    rotors = vehicle.rotors
    pulses = np.array(pwm[: len(rotors.positions)], dtype=np.float64)
    wanted = rotors.speed_max * (pulses - LOWEST) / (HIGHEST - LOWEST)
    return np.clip(wanted, rotors.speed_min, rotors.speed_max)


def to_ned(vector: Vector) -> Vector:
    """A vector (3,) along east, north, up, along north, east, down."""
    return np.array([vector[1], vector[0], -vector[2]])


def to_frd(vector: Vector) -> Vector:
    """A vector (3,) along forward, left, up, along forward, right, down."""
    return np.array([vector[0], -vector[1], -vector[2]])


def ned_attitude(q_xyzw: Quaternion) -> Quaternion:
    """Attitude, body to earth in our axes, in ArduPilot's axes and order: w, x, y, z."""
    x, y, z, w = quaternion_product(NED_OF_ENU, quaternion_product(q_xyzw, FLU_OF_FRD))
    return np.array([w, x, y, z])


def state_line(time: float, sample: ImuSample, motion: FreeMotion) -> bytes:
    """Write a state: what the IMU says at a time [s], and where the vehicle is.

    Without blanks: SITL takes the number that begins two characters behind a key.
    """
    values: dict[str, Any] = {
        "timestamp": time,
        "imu": {
            "gyro": to_frd(sample.body_rate).tolist(),
            "accel_body": to_frd(sample.specific_force).tolist(),
        },
        "position": to_ned(motion.position).tolist(),
        "velocity": to_ned(motion.velocity).tolist(),
        "quaternion": ned_attitude(sample.q_xyzw).tolist(),
    }
    return b"\n" + json.dumps(values, separators=(",", ":"), allow_nan=False).encode() + b"\n"


class Shown(NamedTuple):
    """What was answered last."""

    emission: Emission
    injected: Faulty | None  # the sample with its faults; None: it is on its way
    line: bytes
    command: Components | None  # rotor speeds under which it flew here [rad/s]; None: it begins here


class ArduPilotPhysics:
    """The physics behind SITL: answers its packets one by one, and counts what is wrong with them.

    ``make_simulator(rate)`` makes a vehicle at a rate [Hz], ``make_injector()`` its faults; both anew when
    SITL restarts, which shows in a frame count that goes back. Faults put on before SITL starts stay. Each
    packet's rate is that of its period: SITL comes from 1200 Hz to its ``SIM_RATE_HZ`` in steps of 1 Hz.
    """

    def __init__(
        self, make_simulator: Callable[[float], Simulator], make_injector: Callable[[], FaultInjector]
    ) -> None:
        self._make_simulator, self._make_injector = make_simulator, make_injector
        self._simulator: Simulator | None = None
        self._injector = make_injector()
        self._frame = 0
        self._sample = level_sample()
        self.shown: Shown | None = None
        self.flights = 0  # how often SITL has started
        self.counts: Counter[str] = Counter()  # packets by the field that was wrong
        self.complaint = ""  # about the last that was refused

    def answer(self, data: bytes) -> bytes | None:
        """Fly one period under the servo outputs of a packet; return the state; None for no such packet."""
        try:
            packet = read_servos(data)
        except ValueError as error:
            self.counts[str(error).partition(":")[0]] += 1
            self.complaint = str(error)
            return None
        if self._simulator is None or packet.frame_count < self._frame:
            if self._simulator is not None:
                self._injector, self._sample = self._make_injector(), level_sample()
            self._simulator = self._make_simulator(float(packet.frame_rate))
            self.flights += 1
            command, emission = None, self._simulator.start()
        elif self.shown is not None and packet.frame_count == self._frame:
            self.counts["frame_count repeated"] += 1
            return self.shown.line
        else:
            if missing := packet.frame_count - self._frame - 1:
                self.counts["frame_count skipped"] += missing
            self._simulator.set_period(period_ns(packet.frame_rate))
            command = rotor_speeds(self._simulator.plant.vehicle, packet.pwm)
            emission = self._simulator.advance(command)
        self._frame = packet.frame_count
        self.shown = self._show(emission, self._simulator, command)
        return self.shown.line

    def _show(self, emission: Emission, simulator: Simulator, command: Components | None) -> Shown:
        """Put the faults on a sample and on the rotors.

        SITL needs all samples, so a value stays until the next one comes.
        """
        injected = None
        if emission.sample is not None:
            injected = self._injector.apply(emission.sample_stamp_ns, emission.sample)
            self._sample = held(injected, self._sample)
            simulator.set_rotors(injected.rotors)
        motion = emission.flight
        assert motion is not None
        return Shown(emission, injected, state_line(simulator.time, self._sample, motion), command)


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
