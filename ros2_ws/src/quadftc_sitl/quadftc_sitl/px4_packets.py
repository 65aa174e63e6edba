# pyright: basic
"""PX4's simulator API: a plant as the physics of its simulation (SITL), in lock-step.

PX4 connects by TCP. HIL_SENSOR sets its clock, and has one sample of IMU, magnetometer and barometer. It
answers with HIL_ACTUATOR_CONTROLS once its modules have run. Layout and lock-step: PX4 1.16,
src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_model.arrays import Vector
from quadftc_model.frames import enu_from_ned, flu_from_frd
from quadftc_model.samples import ImuSample, PositionSample
from quadftc_sim.autopilot import AutopilotPhysics, MakeInjector, MakeSimulator, speeds_of_shares, to_degrees
from quadftc_sim.barometer import standard_height, standard_pressure
from quadftc_sim.simulator import Emission
from quadftc_sitl.autopilot import Server
from quadftc_sitl.firmware import Firmware, SitlError

HOME = (47.397742, 8.545594, 488.0)  # latitude, longitude [deg], height [m]; PX4's usual field, in Zurich
BOOT = 1.0  # s on its clock at our first sample; 0 means "unset"
IMU_FIELDS = 0b111111  # of HIL_SENSOR's fields_updated: accelerometer and gyro
FIELD_FIELDS, PRESSURE_FIELDS = 0b111000000, 0b1101000000000
IMUS = 3  # all that its simulation knows; they say the same
GAUSS, HECTOPASCAL = 1e4, 1e-2  # of a tesla, of a pascal
TEMPERATURE = 25.0  # degC
FIX_3D, SATELLITES = 3, 12
ACCURACY = 90, 150  # cm; across and up, as a receiver says
PACKET = 65536  # bytes
LOOK = 0.5  # s; how often it is looked whether the firmware lives
TO_CONNECT, PATIENCE = 20.0, 20.0  # s of the wall clock, within which it connects, and goes on
UNANSWERED = 1.0  # s; a sample that PX4 has not answered by then is followed by the next
# s; until the next once it answers no more; and at most behind the first, as on the IMU left it may skip some
TICK, AGAIN = 0.004, 0.02


class PX4Physics(AutopilotPhysics):
    """The physics behind PX4. An empty packet is a sample that PX4 has not answered."""

    def __init__(self, make_simulator: MakeSimulator, make_injector: MakeInjector, rate: float) -> None:
        super().__init__(make_simulator, make_injector, rate)
        self._commanded, self._stamp = False, 0
        self._mavlink: Any = dialect.MAVLink(None, srcSystem=1, srcComponent=200)
        self._field, self._pressure = np.zeros(3), standard_pressure(HOME[2])

    def answer(self, data: bytes, sender: object = None) -> bytes | None:
        """Fly one period under the outputs of a packet; return the sensors; None for no such packet."""
        if self._simulator is None:
            return self.begin(self._rate).line
        vehicle = self._simulator.plant.vehicle
        if data:
            try:
                stamp, controls = self._read(data)
            except ValueError as error:
                return self.refuse(error)
            if stamp < self._stamp:  # it is of a sample that has been given up
                self.counts["late"] += 1
                return None
            shares = controls[: len(vehicle.rotors.positions)]
            self._commanded = True
            return self.fly(speeds_of_shares(vehicle, shares), self._simulator).line
        if self._commanded:
            self.counts["unanswered"] += 1
        held = None if self.shown is None else self.shown.command
        nothing = speeds_of_shares(vehicle, np.zeros(len(vehicle.rotors.positions)))
        return self.fly(nothing if held is None else held, self._simulator).line

    def _read(self, data: bytes) -> tuple[int, list[float]]:
        """Return stamp [us] and controls of a packet; a ValueError says what is wrong with it."""
        try:
            message = self._mavlink.decode(bytearray(data))
            controls = message.controls
        except (dialect.MAVError, AttributeError) as error:
            raise ValueError(f"packet: {error}") from None
        if not all(map(math.isfinite, controls)):
            raise ValueError(f"controls: {controls}, expected numbers")
        return message.time_usec, controls

    def encode(self, time: float, sample: ImuSample, emission: Emission) -> bytes:
        """Write what the sensors say at a time [s]; before it a position, as HIL_SENSOR moves the clock."""
        stamp, updated = round(1e6 * (time + BOOT)), IMU_FIELDS
        self._stamp = stamp
        if emission.field is not None:
            self._field, updated = GAUSS * flu_from_frd(emission.field), updated | FIELD_FIELDS
        if emission.pressure is not None:
            self._pressure, updated = emission.pressure, updated | PRESSURE_FIELDS
        motion = (*flu_from_frd(sample.specific_force), *flu_from_frd(sample.body_rate), *self._field)
        air = HECTOPASCAL * self._pressure, 0.0, standard_height(self._pressure), TEMPERATURE
        units = [updated, *[IMU_FIELDS] * (IMUS - 1)]
        sensors = [
            self._mavlink.hil_sensor_encode(stamp, *motion, *air, fields, unit).pack(self._mavlink)
            for unit, fields in enumerate(units)
        ]
        place = emission.place
        before = b"" if place is None or not place.there else self._position(stamp, place)
        return before + b"".join(sensors)

    def _position(self, stamp: int, place: PositionSample) -> bytes:
        """Write what the position sensor says."""
        east, north, up = map(float, place.position)
        velocity = 1e2 * enu_from_ned(place.velocity)
        flat = (round(1e7 * each) for each in to_degrees(HOME, east, north))
        where = *flat, round(1e3 * (HOME[2] + up)), *ACCURACY
        speeds = round(math.hypot(velocity[0], velocity[1])), *map(round, velocity)
        heading = round(1e2 * course(velocity))
        message = self._mavlink.hil_gps_encode(stamp, FIX_3D, *where, *speeds, heading, SATELLITES)
        return message.pack(self._mavlink)


def course(velocity: Vector) -> float:
    """Return the course [deg] of a velocity, north and east first, from 0 to 360."""
    return math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0


class PX4Server(Server):
    """Where PX4 connects; one connection alone is answered."""

    KIND = socket.SOCK_STREAM

    def __init__(self) -> None:
        super().__init__()
        self._socket.listen(1)
        self._peer: socket.socket | None = None
        self._mavlink = dialect.MAVLink(None)
        self._mavlink.robust_parsing = True
        self._heard = 0.0  # when PX4 answered last, by the wall clock; 0: not yet [s]
        self._patience = UNANSWERED
        self._answers = False  # the last sample was answered
        self._looked = 0.0  # when it was looked whether the firmware lives [s]

    def close(self) -> None:
        """Close the sockets."""
        super().close()
        if self._peer is not None:
            self._peer.close()

    def wait(self, firmware: Firmware, spoke: float) -> list[bytes]:
        """Return PX4's answer, empty if there is none; `SitlError` if the firmware has ended or hangs.

        Without a gyro PX4 answers no more, and goes on: ``spoke`` says when it did over MAVLink [s].
        """
        if self._peer is None:
            self._connect(firmware)
            return [b""]
        self._answers = bool(packets := self.take(self._patience if self._answers else TICK))
        if packets:
            return packets
        self._patience = AGAIN if self._heard else UNANSWERED
        if self._heard or self._is_time():
            firmware.check_alive()
        if self._heard and time.monotonic() > max(self._heard, spoke) + PATIENCE:
            words = f"hangs: it has sent nothing more for {PATIENCE:g} s"
            raise SitlError(f"{firmware.arguments[0]}: {words}{firmware.last_words()}")
        return [b""]

    def take(self, patience: float) -> list[bytes]:
        """Return the last answer that has come, waiting so long [s] for one."""
        if self._peer is None:
            return []
        end = time.monotonic() + patience
        while True:
            ready, _, _ = select.select([self._peer], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                return []
            with contextlib.suppress(OSError):
                data = self._peer.recv(PACKET)
                if not data:  # PX4 has gone
                    time.sleep(patience)
                    return []
                messages = self._mavlink.parse_buffer(data) or []
                if outputs := [m for m in messages if m.get_type() == "HIL_ACTUATOR_CONTROLS"]:
                    self._heard = time.monotonic()
                    return [bytes(outputs[-1].get_msgbuf())]

    def send(self, line: bytes) -> None:
        """Send the sensors of a sample."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._peer.sendall(line)

    def _connect(self, firmware: Firmware) -> None:
        for _ in range(int(TO_CONNECT / LOOK)):
            if select.select([self._socket], [], [], LOOK)[0]:
                self._peer, _ = self._socket.accept()
                self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._looked = time.monotonic()
                return
            firmware.check_alive()
        words = f"does not connect to its physics at TCP port {self.port} within {TO_CONNECT:g} s"
        raise SitlError(f"{firmware.arguments[0]}: {words}{firmware.last_words()}")

    def _is_time(self) -> bool:
        """Return whether it is to be looked whether the firmware lives."""
        if time.monotonic() < self._looked + LOOK:
            return False
        self._looked = time.monotonic()
        return True
