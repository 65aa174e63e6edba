"""Betaflight's simulation (SITL): a plant as the physics behind it.

Layout of the packets: Betaflight 4.6, src/platform/SIMULATOR, target.h and sitl.c; doubles and floats, least
byte first. Its motors come on UDP port 9002, in ArduPilot's order; the state goes to port 9003. The
firmware makes rates of -2000 to 2000 deg/s in steps of 1/16.4 deg/s.
"""

from __future__ import annotations

import math
import struct

from quadftc_model.frames import flu_from_frd, ned_frd_from_enu_flu
from quadftc_model.samples import ImuSample
from quadftc_sim.autopilot import AutopilotPhysics, speeds_of_shares
from quadftc_sim.barometer import standard_pressure
from quadftc_sim.simulator import Emission

MOTORS = struct.Struct("<4f")  # shares of the largest speed
STATE = struct.Struct("<18d")  # time, rate (3), force (3), attitude (4), velocity (3), place (3), pressure
LONGITUDE, LATITUDE = 8.0, 47.0  # deg; where position is 0, at sea level
EARTH = 6371000.0  # m, its radius


def read_motors(data: bytes) -> tuple[float, ...]:
    """Read a packet of motors; a ValueError says what is wrong with it."""
    if len(data) != MOTORS.size:
        raise ValueError(f"length: {len(data)} bytes, expected {MOTORS.size}")
    shares = MOTORS.unpack(data)
    if not all(math.isfinite(share) for share in shares):
        raise ValueError(f"motor_speed: {shares}, expected numbers")
    return shares


class BetaflightPhysics(AutopilotPhysics):
    """The physics behind Betaflight.

    The firmware answers a state by its motors, as soon as its loop has come round. A new sender is a restart.
    """

    _sender: object = None

    def state(self) -> bytes:
        """Return the state that the firmware has to answer."""
        shown = self.shown or self.begin(self._rate)
        return shown.line

    def answer(self, data: bytes, sender: object = None) -> bytes | None:
        """Fly one period under the outputs of a packet; return the state; None for no such packet."""
        try:
            shares = read_motors(data)
        except ValueError as error:
            return self.refuse(error)
        again = self._sender not in (None, sender)
        self._sender = sender
        if self._simulator is None or again:
            return self.begin(self._rate).line
        return self.fly(speeds_of_shares(self._simulator.plant.vehicle, shares), self._simulator).line

    def hold(self) -> None:
        """Fly one period under the outputs of the last packet, and count it."""
        self.counts["unanswered"] += 1
        assert self._simulator is not None
        assert self.shown is not None
        assert self.shown.command is not None
        self.fly(self.shown.command, self._simulator)

    def encode(self, time: float, sample: ImuSample, emission: Emission) -> bytes:
        """Write a state.

        The firmware turns the sign of all three axes of the force, so they are backward, right, down here.
        """
        motion = emission.flight
        assert motion is not None
        east, north, up = motion.position
        longitude = LONGITUDE + math.degrees(east / EARTH) / math.cos(math.radians(LATITUDE))
        return STATE.pack(
            time,
            *flu_from_frd(sample.body_rate),
            *-sample.specific_force,
            *ned_frd_from_enu_flu(sample.q_xyzw),
            *motion.velocity,
            longitude,
            LATITUDE + math.degrees(north / EARTH),
            up,
            standard_pressure(float(up)),
        )
