# pyright: basic
"""How PX4 is flown, and what its messages mean: modes, parameters of integers, its estimator, failures."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_sitl.commander import RESULTS, RETRY, Steps
from quadftc_sitl.firmware import SitlError
from quadftc_sitl.journal import Journal
from quadftc_sitl.pilot import MESSAGES as COMMON
from quadftc_sitl.pilot import SETPOINTS, TO_CLIMB, Pilot
from quadftc_sitl.plan import OwnFault
from quadftc_sitl.px4_packets import HOME

# main mode and, of AUTO, sub mode -> name; those that ArduPilot has, too, have its names
MODES = {
    (1, 0): "MANUAL",
    (2, 0): "ALT_HOLD",
    (3, 0): "POSHOLD",
    (4, 2): "TAKEOFF",
    (4, 3): "LOITER",
    (4, 4): "MISSION",
    (4, 5): "RTL",
    (4, 6): "LAND",
    (5, 0): "ACRO",
    (6, 0): "OFFBOARD",
    (7, 0): "STABILIZE",
    (10, 0): "TERMINATION",
}
UNITS = {"gyro": 0, "accelerometer": 1, "magnetometer": 2, "barometer": 3, "gps": 4}  # FAILURE_UNIT
KINDS = {"ok": 0, "off": 1, "stuck": 2}  # FAILURE_TYPE
HASH = 10  # digits of a commit that it tells
STREAMED = 1.0  # s; of setpoints before it takes OFFBOARD


class PX4Journal(Journal):
    """Listens to PX4's messages."""

    AUTOPILOT, NAME = dialect.MAV_AUTOPILOT_PX4, "PX4"
    MODES = {main << 16 | sub << 24: name for (main, sub), name in MODES.items()}
    BEFORE: Mapping[str, str] = {"LOITER": "MISSION"}
    REFUSALS = ("Preflight Fail:", "Arming denied:")

    def hear(self, message: dialect.MAVLink_message) -> None:
        """Note a message; a long text ends where another message comes."""
        if message.get_type() != "STATUSTEXT":
            for words in self._chunks.values():
                self._say(words, self._severity)
            self._chunks.clear()
        super().hear(message)

    def mode_parameters(self, name: str) -> tuple[float, ...]:
        """Return the parameters of MAV_CMD_DO_SET_MODE behind its flags: main and sub mode."""
        number = self.mode_number(name)
        return float(number >> 16 & 255), float(number >> 24)

    def _on_estimator_status(self, message: dialect.MAVLink_estimator_status_message) -> None:
        self._note_estimate(message.flags, bool(message.flags & dialect.ESTIMATOR_GPS_GLITCH))

    def _on_param_value(self, message: dialect.MAVLink_param_value_message) -> None:
        """Note a value; that of an integer comes as its bits."""
        name = message.param_id.rstrip("\0")
        self.integers[name] = message.param_type == dialect.MAV_PARAM_TYPE_INT32
        value = message.param_value
        if self.integers[name]:
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        self.parameters[name] = value

    def _commit(self, custom: bytes) -> str:
        return custom[::-1].hex()[:HASH]


class PX4Pilot(Pilot):
    """An operator who flies PX4 by setpoints in OFFBOARD, or by a mission."""

    HOME = HOME
    JOURNAL = PX4Journal
    FOLLOWS, MISSION = "OFFBOARD", "MISSION"
    FIRST_ITEM = ()  # its missions have no item for home
    MESSAGES = {
        **COMMON,
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 10,
    }

    def _get_ready(self) -> Steps:
        """Wait until it says that it can be armed; it takes OFFBOARD once setpoints come."""
        yield from self._be_armable()
        self._errands.append(self._stream())
        yield from self._pause(STREAMED)
        yield from self._set_mode(self.FOLLOWS)

    def _ask_why(self) -> Steps:
        """Have it say what its checks find."""
        yield from self._command(dialect.MAV_CMD_RUN_PREARM_CHECKS)
        yield from self._pause(RETRY)

    def _take_off(self, height: float) -> Steps:
        """Climb by the setpoints."""
        yield from self._reach(height, TO_CLIMB)

    def _stream(self) -> Steps:
        """Send setpoints until the mission begins."""
        while self.began is None:
            self._send_setpoint()
            yield from self._pause(SETPOINTS)

    def _fail(self, fault: OwnFault, fails: bool) -> Steps:
        """Have a sensor of its fail, or be well again; it takes no command while it has no gyro at all."""
        unit, instance, kind = fault.failure
        number = dialect.MAV_CMD_INJECT_FAILURE
        answer = yield from self._command(number, UNITS[unit], KINDS[kind if fails else "ok"], instance)
        if fails and answer != dialect.MAV_RESULT_ACCEPTED:
            raise SitlError(f"failure '{fault.inject}' refused: {RESULTS.get(answer, 'no answer')}")
