"""ArduPilot's JSON interface: a plant as the physics of its simulation (SITL, ``--model JSON``).

Layout of the packets: ArduPilot, libraries/SITL/examples/JSON/readme.md and SIM_JSON.h. SITL sends a packet
of servo outputs and waits for a line of JSON with the state.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Components
from quadftc_model.frames import enu_from_ned, flu_from_frd, ned_frd_from_enu_flu
from quadftc_model.samples import ImuSample
from quadftc_model.vehicle import Vehicle
from quadftc_sim.assembly import period_ns
from quadftc_sim.autopilot import AutopilotPhysics, speeds_of_shares
from quadftc_sim.simulator import Emission

HEADER = struct.Struct("<HHI")  # magic, frame_rate [Hz], frame_count
CHANNELS = {18458: 16, 29569: 32}  # magic -> numbers of pwm that follow, uint16 [us]
SLOWEST, FASTEST = 50, 4000  # Hz; frame rates that the plant can be flown at
STALE = 0.5  # s of the wall clock; what comes again so soon after our answer was sent before it
LOWEST, HIGHEST = 1000, 2000  # us; pwm of a motor that stands, and of one at its largest speed


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
    pulses = np.array(pwm[: len(vehicle.rotors.positions)], dtype=np.float64)
    return speeds_of_shares(vehicle, (pulses - LOWEST) / (HIGHEST - LOWEST))


class ArduPilotPhysics(AutopilotPhysics):
    """The physics behind SITL.

    A frame count that goes back is a restart. SITL asks again each second. A packet that comes again just
    after our answer crossed with it: a second answer would put SITL a frame behind for good. One that comes
    later says that the answer was lost.
    """

    _frame, _answered = 0, 0.0  # last frame count; when it was answered, on the monotonic clock [s]

    def answer(self, data: bytes, sender: object = None) -> bytes | None:
        """Fly one period under the outputs of a packet; return the state; None for no such packet."""
        try:
            packet = read_servos(data)
        except ValueError as error:
            return self.refuse(error)
        if self._simulator is None or packet.frame_count < self._frame:
            shown = self.begin(self._rate or float(packet.frame_rate))
        elif self.shown is not None and packet.frame_count == self._frame:
            self.counts["frame_count repeated"] += 1
            if time.monotonic() - self._answered < STALE:
                return None
            shown = self.shown
        else:
            if missing := packet.frame_count - self._frame - 1:
                self.counts["frame_count skipped"] += missing
            self._simulator.set_period(period_ns(self._rate or packet.frame_rate))
            command = rotor_speeds(self._simulator.plant.vehicle, packet.pwm)
            shown = self.fly(command, self._simulator)
        self._frame = packet.frame_count
        return shown.line

    def sent(self) -> None:
        """Note that an answer has gone out."""
        self._answered = time.monotonic()

    def encode(self, time: float, sample: ImuSample, emission: Emission) -> bytes:
        """Write a state as a line of JSON.

        Without blanks: SITL takes the number that begins two characters behind a key.
        """
        motion = emission.flight
        assert motion is not None
        values: dict[str, object] = {
            "timestamp": time,
            "imu": {
                "gyro": flu_from_frd(sample.body_rate).tolist(),
                "accel_body": flu_from_frd(sample.specific_force).tolist(),
            },
            "position": enu_from_ned(motion.position).tolist(),
            "velocity": enu_from_ned(motion.velocity).tolist(),
            "quaternion": ned_frd_from_enu_flu(sample.q_xyzw).tolist(),
        }
        return b"\n" + json.dumps(values, separators=(",", ":"), allow_nan=False).encode() + b"\n"
