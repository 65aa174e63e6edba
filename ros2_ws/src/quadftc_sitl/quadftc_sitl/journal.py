# pyright: basic
"""What an autopilot says in flight: its texts, modes, health and estimator, with the time of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

SERIOUS = dialect.MAV_SEVERITY_WARNING  # severities up to here count as noticed
LANE = "lane switch"  # in texts that say that another estimator is used
HEALTH = {  # bit of SYS_STATUS -> what is healthy
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyro",
    dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
    dialect.MAV_SYS_STATUS_SENSOR_3D_MAG: "magnetometer",
    dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE: "barometer",
    dialect.MAV_SYS_STATUS_SENSOR_GPS: "gps",
    dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS: "motors",
    dialect.MAV_SYS_STATUS_AHRS: "estimator",
}
GOOD_ESTIMATE = (
    dialect.EKF_ATTITUDE | dialect.EKF_VELOCITY_HORIZ | dialect.EKF_VELOCITY_VERT | dialect.EKF_POS_HORIZ_ABS
)
IN_THE_AIR = (dialect.MAV_LANDED_STATE_IN_AIR, dialect.MAV_LANDED_STATE_UNDEFINED)  # if it says nothing
GLITCH = 1 << 15  # flag EKF_GPS_GLITCHING of EKF_STATUS_REPORT
ESTIMATES = ("estimate incomplete", "estimate complete", "GPS glitch, estimate incomplete", "GPS glitch")


class Event(NamedTuple):
    """Something that the autopilot said, in its words where it has some."""

    time: float  # of its clock, which is that of the physics [s]
    kind: str  # text, lane, mode, health, estimator, disarmed
    words: str
    serious: bool  # an operator would be alarmed


class Journal:
    """Listens to ArduPilot's messages; ``now`` is the time of the physics [s]."""

    AUTOPILOT, NAME = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, "ArduPilot"
    MODES = {
        number: entry.name.removeprefix("COPTER_MODE_")
        for number, entry in dialect.enums.get("COPTER_MODE", {}).items()
    }
    BEFORE: Mapping[str, str] = {}  # mode -> the one that ends in it
    REFUSALS = ("PreArm:", "Arm:")  # begin the texts that say why it does not arm

    def __init__(self) -> None:
        self.now = 0.0
        self.events: list[Event] = []
        self.kind: int | None = None  # of the vehicle, MAV_TYPE; None: no heartbeat yet
        self.autopilot = 0  # MAV_AUTOPILOT
        self.source: tuple[int, int] = (1, 1)  # its system and component
        self.mode = -1
        self.asked_mode = ""  # that we have asked for last; empty: none yet
        self.armed = False
        self.landed_state = dialect.MAV_LANDED_STATE_UNDEFINED
        self.may_disarm = True  # we have asked it to come down
        self.can_arm = False
        self.position = (math.nan,) * 3  # north, east, down from its origin, as it believes [m]
        self.version = ""
        self.boot_offset = 0.0  # its clock less ours [s]
        self.parameters: dict[str, float] = {}
        self.integers: dict[str, bool] = {}  # parameters whose values go as the bits of an integer
        self.acknowledged: dict[int, int] = {}  # command -> MAV_RESULT
        self.wanted_item: int | None = None  # of the mission, that it asks for
        self.mission_result: int | None = None
        self._health: int | None = None
        self._estimator = 0
        self._chunks: dict[tuple[int, int], str] = {}  # parts of long texts
        self._severity = 0  # of the last part

    def hear(self, message: dialect.MAVLink_message) -> None:
        """Note a message."""
        handler = getattr(self, f"_on_{message.get_type().lower()}", None)
        if handler is not None:
            handler(message)

    def refusals(self, since: float) -> list[str]:
        """Return why it does not arm, in its words, as said from a time [s] on."""
        words = [event.words for event in self.events if event.time >= since and event.kind == "text"]
        return list(dict.fromkeys(text for text in words if text.startswith(self.REFUSALS)))

    @property
    def flies(self) -> bool:
        """It is armed, and does not say that it is on the ground, takes off or lands."""
        return self.armed and self.landed_state in IN_THE_AIR

    @property
    def mode_name(self) -> str:
        """Its mode in words."""
        return self.MODES.get(self.mode, str(self.mode))

    def mode_number(self, name: str) -> int:
        """Return the number of a mode by its name."""
        return next(number for number, each in self.MODES.items() if each == name)

    def mode_parameters(self, name: str) -> tuple[float, ...]:
        """Return the parameters of MAV_CMD_DO_SET_MODE behind its flags."""
        return (float(self.mode_number(name)),)

    def lane_since(self, since: float) -> bool:
        """Return whether it has said since a time [s] that it uses another estimator."""
        return any(event.kind == "lane" and event.time >= since for event in self.events)

    def _note(self, kind: str, words: str, serious: bool) -> None:
        self.events.append(Event(round(self.now, 4), kind, words, serious))

    def _on_heartbeat(self, message: dialect.MAVLink_heartbeat_message) -> None:
        if message.type == dialect.MAV_TYPE_GCS or message.autopilot == dialect.MAV_AUTOPILOT_INVALID:
            return
        self.source = (message.get_srcSystem(), message.get_srcComponent())
        self.kind, self.autopilot = message.type, message.autopilot
        armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        if self.armed and not armed:
            self._note("disarmed", "disarmed", not self.may_disarm)
        self.armed = armed
        if message.custom_mode != self.mode:
            self.mode = message.custom_mode
            is_ours = self.asked_mode in ("", self.mode_name, self.BEFORE.get(self.mode_name))
            self._note("mode", f"mode {self.mode_name}", armed and not is_ours)

    def _on_statustext(self, message: dialect.MAVLink_statustext_message) -> None:
        words = message.text.rstrip("\0\t")
        if message.id:  # the text is longer than a message
            key = message.get_srcComponent(), message.id
            words = self._chunks.pop(key, "") + words
            if len(message.text) == 50 and "\0" not in message.text:
                self._chunks[key] = words
                self._severity = message.severity
                return
        self._say(words, message.severity)

    def _say(self, words: str, severity: int) -> None:
        why_not_armed = words.startswith(self.REFUSALS) and not self.armed
        serious = severity <= SERIOUS and not why_not_armed
        self._note("lane" if LANE in words else "text", words, serious)

    def _on_sys_status(self, message: dialect.MAVLink_sys_status_message) -> None:
        present = message.onboard_control_sensors_present & message.onboard_control_sensors_enabled
        health = message.onboard_control_sensors_health
        self.can_arm = bool(health & dialect.MAV_SYS_STATUS_PREARM_CHECK)
        before, self._health = self._health, health
        for bit, name in HEALTH.items():
            if before is not None and present & bit and (before ^ health) & bit:
                good = bool(health & bit)
                self._note("health", f"{name} {'healthy' if good else 'unhealthy'}", not good)

    def _on_extended_sys_state(self, message: dialect.MAVLink_extended_sys_state_message) -> None:
        self.landed_state = message.landed_state

    def _on_ekf_status_report(self, message: dialect.MAVLink_ekf_status_report_message) -> None:
        self._note_estimate(message.flags, bool(message.flags & GLITCH))

    def _note_estimate(self, flags: int, glitch: bool) -> None:
        state = (flags & GOOD_ESTIMATE == GOOD_ESTIMATE) + 2 * glitch
        if state != self._estimator:
            self._note("estimator", ESTIMATES[state], state != 1)
            self._estimator = state

    def _on_local_position_ned(self, message: dialect.MAVLink_local_position_ned_message) -> None:
        self.position = message.x, message.y, message.z
        self.boot_offset = 1e-3 * message.time_boot_ms - self.now

    def _on_autopilot_version(self, message: dialect.MAVLink_autopilot_version_message) -> None:
        number = message.flight_sw_version
        names = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: "official"}
        parts = number >> 24, number >> 16 & 255, number >> 8 & 255
        commit = self._commit(bytes(message.flight_custom_version))
        self.version = f"{'.'.join(map(str, parts))}-{names.get(number & 255, number & 255)} {commit}".strip()

    def _commit(self, custom: bytes) -> str:
        return custom.rstrip(b"\0").decode("ascii", "replace")

    def _on_param_value(self, message: dialect.MAVLink_param_value_message) -> None:
        self.parameters[message.param_id.rstrip("\0")] = message.param_value

    def _on_command_ack(self, message: dialect.MAVLink_command_ack_message) -> None:
        self.acknowledged[message.command] = message.result

    def _on_mission_request(self, message: dialect.MAVLink_mission_request_message) -> None:
        self.wanted_item = message.seq

    _on_mission_request_int = _on_mission_request

    def _on_mission_ack(self, message: dialect.MAVLink_mission_ack_message) -> None:
        self.mission_result = message.type
