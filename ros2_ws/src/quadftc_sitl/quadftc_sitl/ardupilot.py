# pyright: basic
"""ArduPilot's simulation: JSON packets over UDP, its own simulated compass, barometer and GPS."""

from __future__ import annotations

import socket
from pathlib import Path

from quadftc_sim.ardupilot import ArduPilotPhysics
from quadftc_sitl.autopilot import Autopilot, Start
from quadftc_sitl.firmware import LOOPBACK, PARAMETERS, free_port
from quadftc_sitl.physics import PhysicsSocket
from quadftc_sitl.pilot import Pilot
from quadftc_sitl.plan import SitlPlan

SPEEDUP = 1000  # times real time, which it does not reach
SERIAL_PORTS = (1, 2)  # besides the first; GPS come next, and those behind are off
LOOP_RATE, USUAL_LOOP_RATE = "SCHED_LOOP_RATE", 400.0  # ArduCopter's own loop [Hz], and its default
GYRO_RATE = 2.0  # of the gyro to the loop; ArduCopter does not arm below 1.8
COMPASS = {"X": 5.0, "Y": 13.0, "Z": -18.0}  # offsets that ArduPilot's simulated compass has
STICKS = {"MIN": 1000.0, "MAX": 2000.0, "TRIM": 1500.0}  # us
MINE = {
    **dict.fromkeys(("FRAME_CLASS", "FRAME_TYPE", "MOT_THST_EXPO"), 1.0),
    "BATT_MONITOR": 4.0,
    "MOT_BAT_VOLT_MAX": 0.0,
    "MOT_SPIN_ARM": 0.15,
    "MOT_SPIN_MIN": 0.16,
    **{f"SERIAL{number}_PROTOCOL": -1.0 for number in (1, 2, 5, 6, 7)},
    **{f"COMPASS_OFS{unit}_{axis}": value for unit in ("", "2", "3") for axis, value in COMPASS.items()},
    **{f"INS_ACC{unit}OFFS_{axis}": 0.001 for unit in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{unit}SCAL_{axis}": 1.001 for unit in ("", "2") for axis in "XYZ"},
    **{f"RC{number}_{name}": value for number in range(1, 9) for name, value in STICKS.items()},
}


class ArduPilot(Autopilot):
    """ArduCopter."""

    name, title = "ardupilot", "ArduPilot"
    sensors = {"mag.rate": 0.0, "baro.rate": 0.0}
    server, physics, pilot = PhysicsSocket, ArduPilotPhysics, Pilot
    logs = "logs/*.BIN"

    def rate(self, plan: SitlPlan) -> float:
        """Return the rate [Hz] of physics and IMU: twice its loop, or the scenario's if that is higher."""
        return max(plan.scenario.rate, GYRO_RATE * plan.section.parameters.get(LOOP_RATE, USUAL_LOOP_RATE))

    def parameters(self, plan: SitlPlan) -> dict[str, float]:
        """Return what a quadrotor of our physics needs."""
        return {**MINE, "SIM_RATE_HZ": self.rate(plan)}

    def start(self, binary: Path, folder: Path, physics_port: int, mavlink_port: int) -> Start:
        """Return how it is started with our physics, its first serial port ours.

        Its other serial ports would listen at every address. So the parameters make them no MAVLink ports,
        and if the firmware opens them nevertheless, they send to a port of ours that nobody reads.
        """
        spare = f"udpclient:{LOOPBACK}:{free_port()}"
        serials = [(f"--serial{number}", spare) for number in SERIAL_PORTS]
        home = ",".join(f"{value:.9g}" for value in (*Pilot.HOME, 90.0))
        return Start(
            [
                *(str(binary), "--model", f"JSON:{LOOPBACK}", "--speedup", str(SPEEDUP)),
                *("--sim-address", LOOPBACK, "--sim-port-out", str(physics_port)),
                *("--sim-port-in", str(free_port()), "--rc-in-port", str(free_port())),
                *("--base-port", str(free_port(socket.SOCK_STREAM))),
                *("--serial0", f"udpclient:{LOOPBACK}:{mavlink_port}"),
                *(word for pair in serials for word in pair),
                *("--defaults", PARAMETERS, "--home", home),
            ]
        )
