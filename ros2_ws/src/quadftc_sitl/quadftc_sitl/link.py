# pyright: basic
"""MAVLink to an autopilot over a UDP socket on loopback, without waiting."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_model.arrays import Vector
from quadftc_sitl.firmware import LOOPBACK

GROUND = 255, 190  # MAVLink's system and component of a ground station
ONBOARD = 1, dialect.MAV_COMP_ID_ONBOARD_COMPUTER  # and of a computer on the first vehicle
PACKET = 65536  # bytes
TEXT = 50  # bytes of a STATUSTEXT
MIDDLE = 1500  # us; pulse of a stick
MULTIROTORS = {
    dialect.MAV_TYPE_QUADROTOR: 4,
    dialect.MAV_TYPE_HEXAROTOR: 6,
    dialect.MAV_TYPE_OCTOROTOR: 8,
}  # type of a vehicle -> rotors


class MavlinkLink:
    """The autopilot's first serial port. It speaks first; who else sends to the port is not heard."""

    def __init__(self, address: str = LOOPBACK, port: int = 0, source: tuple[int, int] = GROUND) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, port))
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        self._mavlink = dialect.MAVLink(self, srcSystem=source[0], srcComponent=source[1])
        self._mavlink.robust_parsing = True
        self.target: tuple[int, int] = (1, 1)  # system and component of the autopilot
        self.strangers = 0  # packets from elsewhere
        self.spoke = 0.0  # when the autopilot did last, by the monotonic clock [s]

    @property
    def port(self) -> int:
        """Its UDP port."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def write(self, data: bytes) -> None:
        """Send bytes; what the autopilot has not made room for is lost, as on any link."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def receive(self) -> list[dialect.MAVLink_message]:
        """Return the messages that have come."""
        found: list[dialect.MAVLink_message] = []
        with contextlib.suppress(OSError):  # no more
            while True:
                data, sender = self._socket.recvfrom(PACKET)
                if self._peer is None:
                    self._peer = sender
                if sender != self._peer:
                    self.strangers += 1
                    continue
                self.spoke = time.monotonic()
                parsed = self._mavlink.parse_buffer(data) or []
                found += [each for each in parsed if each.get_type() != "BAD_DATA"]
        return found

    def heartbeat(self) -> None:
        """Tell that there is a ground station."""
        self._mavlink.heartbeat_send(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def tell(self, words: str) -> None:
        """Send a text to whoever listens; the autopilot puts it into its log."""
        self._mavlink.statustext_send(dialect.MAV_SEVERITY_WARNING, words.encode()[:TEXT])

    def centre_sticks(self) -> None:
        """Hold roll, pitch, throttle and yaw of the remote control in the middle."""
        self._mavlink.rc_channels_override_send(*self.target, MIDDLE, MIDDLE, MIDDLE, MIDDLE, 0, 0, 0, 0)

    def command(self, number: int, *parameters: float) -> None:
        """Send a command with up to seven parameters."""
        values: Any = [*parameters, *[0.0] * (7 - len(parameters))]
        self._mavlink.command_long_send(*self.target, number, 0, *values)

    def ask_parameter(self, name: str) -> None:
        """Ask for the value of a parameter."""
        self._mavlink.param_request_read_send(*self.target, name.encode(), -1)

    def set_parameter(self, name: str, value: float, integer: bool = False) -> None:
        """Set a parameter; that of an integer can go as its bits."""
        kind = dialect.MAV_PARAM_TYPE_INT32 if integer else dialect.MAV_PARAM_TYPE_REAL32
        if integer:
            value = struct.unpack("<f", struct.pack("<i", round(value)))[0]
        self._mavlink.param_set_send(*self.target, name.encode(), value, kind)

    def fly_to(
        self, time: float, position: Vector, velocity: Vector, acceleration: Vector, yaw: float
    ) -> None:
        """Send a setpoint: north, east, down from the origin of the estimator [m], and its derivatives."""
        place: Any = (*position, *velocity, *acceleration, yaw, 0.0)
        frame, mask = dialect.MAV_FRAME_LOCAL_NED, dialect.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
        self._mavlink.set_position_target_local_ned_send(int(1e3 * time), *self.target, frame, mask, *place)

    def mission_count(self, count: int) -> None:
        """Announce a mission of so many items."""
        self._mavlink.mission_count_send(*self.target, count, dialect.MAV_MISSION_TYPE_MISSION)

    def mission_item(self, number: int, place: tuple[float, float, float]) -> None:
        """Send a waypoint of a mission: latitude, longitude [deg], height above home [m]."""
        latitude, longitude, height = place
        self._mavlink.mission_item_int_send(
            *(*self.target, number, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT),
            *(dialect.MAV_CMD_NAV_WAYPOINT, 0, 1),
            *(0.0, 0.0, 0.0, 0.0, round(1e7 * latitude), round(1e7 * longitude), height),
            dialect.MAV_MISSION_TYPE_MISSION,
        )
