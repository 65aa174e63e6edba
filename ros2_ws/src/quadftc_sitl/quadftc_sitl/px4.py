# pyright: basic
"""PX4's simulation: its simulator API over TCP, all sensors ours; how it is flown, what its messages mean."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from quadftc_model.vehicle import Vehicle
from quadftc_sim.barometer import BAROMETER_GRADES
from quadftc_sim.magnetometer import MAGNETOMETER_GRADES
from quadftc_sim.position_sensor import POSITION_GRADES
from quadftc_sitl.autopilot import Autopilot, Start
from quadftc_sitl.commander import RESULTS, RETRY, Steps
from quadftc_sitl.firmware import LOOPBACK, PARAMETERS, SitlError, free_port
from quadftc_sitl.journal import Journal
from quadftc_sitl.pilot import MESSAGES as COMMON
from quadftc_sitl.pilot import SETPOINTS, TO_CLIMB, Pilot
from quadftc_sitl.plan import OwnFault, SitlPlan
from quadftc_sitl.px4_packets import HOME, PX4Physics, PX4Server

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
BASE_PORT = 4560  # TCP; PX4 connects to this and its instance's number
MODEL = "none_iris"  # airframe of its start script, a quadrotor behind the simulator API
SCRIPT = Path("etc", "init.d-posix", "rcS")
RATES = (100, 200, 250, 400)  # Hz; of IMU_INTEG_RATE
SLOWEST = 250.0  # Hz; PX4's rate controller needs a gyro as fast
LEFT = ("/tmp/px4-sock-{}", "/tmp/px4_lock-{}")  # files of an instance
# where its start script finds them before its own files of these names
PARAMETER_SCRIPT = f'while read -r name value; do param set "$name" "$value"; done < {PARAMETERS}\n'
LINK_SCRIPT = f"mavlink start -x -u {{}} -t {LOOPBACK} -o {{}} -r 4000000 -m custom\n"
# Zurich by the world magnetic model of PX4 1.16; elsewhere EKF2 holds the compass for disturbed
FIELD = {"mag.strength": 48.2e-6, "mag.inclination": 1.1023, "mag.declination": 0.0594}


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
    MESSAGES = {**COMMON, dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 10}

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


class PX4(Autopilot):
    """PX4 with a multirotor."""

    name, title = "px4", "PX4"
    takes_failures = True
    server, physics, pilot = PX4Server, PX4Physics, PX4Pilot
    logs = "log/*/*.ulg"
    sensors = {
        "position_sensor": True,
        **{f"position.{name}": value for name, value in POSITION_GRADES["gps"].items()},
        "position.wander": (0.0, 0.0, 0.0),  # none, so that setpoints are places
        **{f"mag.{name}": value for name, value in MAGNETOMETER_GRADES["mems"].items()},
        **FIELD,
        **{f"baro.{name}": value for name, value in BAROMETER_GRADES["mems"].items()},
        "baro.altitude": HOME[2],
    }

    def rate(self, plan: SitlPlan) -> float:
        """Return the rate [Hz] of physics and IMU: the scenario's, if PX4 can fly with it."""
        return max(plan.scenario.rate, SLOWEST)

    def parameters(self, plan: SitlPlan) -> dict[str, float]:
        """Return what the vehicle needs: its rotors, which follow their command linearly, and no pilot.

        The log is that of a real vehicle by default, not the longer one of a simulation.
        """
        plant: Any = plan.scenario.plant
        return {
            **rotor_parameters(plant.vehicle),
            "IMU_GYRO_RATEMAX": 2000.0,  # every sample is used, and answered
            "IMU_INTEG_RATE": float(max(choice for choice in RATES if choice <= self.rate(plan))),
            "EKF2_GPS_DELAY": 1e3 * self.sensors["position.delay"],
            "COM_RC_IN_MODE": 4.0,
            "NAV_RCL_ACT": 0.0,
            "SDLOG_PROFILE": 1.0,
            "MAV_SYS_ID": 1.0,
        }

    def start(self, binary: Path, folder: Path, physics_port: int, mavlink_port: int) -> Start:
        """Return how its own start script is run; the port of the physics tells the instance's number."""
        root = binary.parent.parent / SCRIPT.parts[0]
        if not (root.parent / SCRIPT).is_file():
            raise SitlError(f"{binary}: no {root.parent / SCRIPT} beside it; expected a build of px4_sitl")
        (folder / "px4-rc.params").write_text(PARAMETER_SCRIPT, encoding="ascii")
        (folder / "px4-rc.mavlink").write_text(LINK_SCRIPT.format(free_port(), mavlink_port))
        instance = str(physics_port - BASE_PORT)
        path = f"{folder}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
        environment = {"PATH": path, "PX4_SIM_MODEL": MODEL, "PX4_SIMULATOR": "", "HEADLESS": "1"}
        return Start([str(binary), "-d", "-i", instance, "-s", str(SCRIPT), str(root)], environment)

    def tidy(self, start: Start) -> None:
        """Remove the socket and the lock of its instance."""
        instance = start.arguments[3]
        for name in LEFT:
            with contextlib.suppress(OSError):
                Path(name.format(instance)).unlink()


def rotor_parameters(vehicle: Vehicle) -> dict[str, float]:
    """Return where the rotors are, forward and right [m], which way they turn, and what hovering takes.

    The command is a share of the largest speed, so the thrust goes with its square: THR_MDL_FAC 1.
    """
    rotors = vehicle.rotors
    found: dict[str, float] = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": len(rotors.positions), "THR_MDL_FAC": 1.0}
    for number, (forward, left) in enumerate(rotors.positions):
        moment = -rotors.yaw_sign[number] * rotors.yaw_gain / rotors.thrust_gain
        values = {"PX": float(forward), "PY": -float(left), "KM": float(moment)}
        found |= {f"CA_ROTOR{number}_{name}": value for name, value in values.items()}
        found[f"PWM_MAIN_FUNC{number + 1}"] = 101.0 + number
    return {**found, "MPC_THR_HOVER": round(vehicle.weight / vehicle.thrust_max, 3)}
