# pyright: basic
"""PX4's simulation: its simulator API over TCP, all sensors ours."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from quadftc_model.vehicle import Vehicle
from quadftc_sim.barometer import BAROMETER_GRADES
from quadftc_sim.magnetometer import MAGNETOMETER_GRADES
from quadftc_sim.position_sensor import POSITION_GRADES
from quadftc_sitl.autopilot import Autopilot, Start
from quadftc_sitl.firmware import LOOPBACK, PARAMETERS, SitlError, free_port
from quadftc_sitl.plan import SitlPlan
from quadftc_sitl.px4_packets import HOME, PX4Physics, PX4Server
from quadftc_sitl.px4_pilot import PX4Pilot

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
