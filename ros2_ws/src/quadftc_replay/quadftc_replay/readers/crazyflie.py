"""A Crazyflie's log (uSD card) as a flight log.

| signal | variables: the first that are there |
|---|---|
| gyro | ``gyro`` [deg/s], ``ctrlLee.omega``, ``controller.r_`` [rad/s], ``stateEstimateZ.rate`` [mrad/s] |
| second gyro, accelerometer | ``gyroSec`` [deg/s], ``accSec`` [g] |
| accelerometer | ``acc`` [g] |
| magnetometer | ``mag`` [gauss] |
| attitude | ``stateEstimate.q``, ``ctrlLee.rpy`` [rad], angles of ``stateEstimate`` or ``stabilizer`` [deg] |
| position, velocity | ``stateEstimate`` [m, m/s], ``stateEstimateZ`` [mm, mm/s] |
| acceleration | ``stateEstimate`` [g], ``stateEstimateZ`` [mm/s², with gravity] |
| rotor speeds | ``rpm.m1`` to ``m4``, ``motor.m1_rpm`` to ``m4_rpm`` [rpm] |
| rotor commands | ``motor.m`` [1/65535], else from ``controller.cmd_`` |
| torque, thrust command | ``ctrlLee.torque`` [N m], ``ctrlLee.thrustSi`` [N] |
| battery | ``pm.vbat`` [V], ``pm.vbatMV`` [mV] |

All rates are those of the gyro: the controllers and ``stateEstimateZ`` log what they got from it. The body
frame is forward-left-up. Where the firmware keeps its old frame, in which pitch has the other sign
(``controller``, ``stateEstimateZ``, angles in degrees), the sign is turned. The attitude is the vehicle's own
estimate, to which this gyro has contributed. From the commands of the PID controller come those of the
motors, as the firmware distributes and caps them.

Source: bitcraze/crazyflie-firmware (stabilizer.c, controller_lee.c, controller_pid.c, motors.c, rpm.c,
power_distribution_quadrotor.c).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.layouts import Layout
from quadftc_replay.readers.signals import DEGREE, MILLI, RPM, Signals, Stamps, columns
from quadftc_replay.usdlog import EventRows, read_usdlog

FORMAT = "Crazyflie uSD"
VEHICLE = "crazyflie_2x"
FULL = 65535.0  # motor command at full thrust
NO_SPEED = 65535.0  # rpm; the telemetry of a motor has no value


class Source(NamedTuple):
    """Variables that give a quantity; value * scale + offset is in SI and forward-left-up."""

    names: Sequence[str]
    scale: Sequence[float]
    offset: Sequence[float]


def _source(group: str, elements: str, *scale: float, offset: Sequence[float] = ()) -> Source:
    names = [f"{group}{element}" for element in elements.split()]
    scales = scale if len(scale) == len(names) else scale * len(names)
    return Source(names, scales, offset or [0.0] * len(names))


MILLIGAUSS = 1e3  # of a gauss
RATES = (
    _source("gyro.", "x y z", DEGREE),
    _source("ctrlLee.omega", "x y z", 1.0),
    _source("controller.r_", "roll pitch yaw", 1.0, -1.0, 1.0),
    _source("stateEstimateZ.rate", "Roll Pitch Yaw", MILLI, -MILLI, MILLI),
)
QUATERNIONS = (_source("stateEstimate.q", "x y z w", 1.0),)
ANGLES = (
    _source("ctrlLee.rpy", "x y z", 1.0),
    _source("stateEstimate.", "roll pitch yaw", DEGREE, -DEGREE, DEGREE),
    _source("stabilizer.", "roll pitch yaw", DEGREE, -DEGREE, DEGREE),
)
SPEEDS = (_source("rpm.m", "1 2 3 4", RPM), _source("motor.", "m1_rpm m2_rpm m3_rpm m4_rpm", RPM))
PID = _source("controller.cmd_", "thrust roll pitch yaw", 1.0)
FIRST: Mapping[str, Sequence[Source]] = {
    "gyros": RATES,
    "accelerometers": (_source("acc.", "x y z", STANDARD_GRAVITY),),
    "magnetometers": (_source("mag.", "x y z", MILLIGAUSS),),
    "position": (_source("stateEstimate.", "x y z", 1.0), _source("stateEstimateZ.", "x y z", MILLI)),
    "velocity": (_source("stateEstimate.", "vx vy vz", 1.0), _source("stateEstimateZ.", "vx vy vz", MILLI)),
    "acceleration": (
        _source("stateEstimate.", "ax ay az", STANDARD_GRAVITY),
        _source("stateEstimateZ.", "ax ay az", MILLI, offset=(0.0, 0.0, -9.81)),  # as the firmware has it
    ),
    "rotor_commands": (_source("motor.m", "1 2 3 4", 1.0 / FULL),),
    "torque_command": (_source("ctrlLee.torque", "x y z", 1.0),),
    "thrust_command": (_source("ctrlLee.", "thrustSi", 1.0), _source("stabilizer.", "thrust", 1.0)),
    "battery": (_source("pm.", "vbat", 1.0), _source("pm.", "vbatMV", MILLI)),
}
SECOND = {
    "gyros": (_source("gyroSec.", "x y z", DEGREE),),
    "accelerometers": (_source("accSec.", "x y z", STANDARD_GRAVITY),),
}


_LISTED = [*FIRST.values(), *SECOND.values(), QUATERNIONS, ANGLES, SPEEDS, (PID,)]
WANTED = {name for sources in _LISTED for source in sources for name in source.names}


class Taken(NamedTuple):
    """A quantity of a log."""

    stamp_ns: Stamps  # (n,)
    value: Floats  # (n, k), SI, forward-left-up
    names: str  # event and variables


def read(path: Path) -> FlightLog:
    """Read a log; BagError if nothing in it can be used."""
    log = read_usdlog(path, WANTED)
    signals = Signals(path, FORMAT)
    signals.notes += [warning.removeprefix(f"{path}: ") for warning in log.warnings]
    table = _Table(log.events)
    for field, sources in FIRST.items():
        _add(signals, field, table.take(sources))
    for field, sources in SECOND.items():
        _add(signals, field, table.take(sources), name="2")
    _add_attitude(signals, table)
    if (speeds := table.take(SPEEDS)) is not None:
        wrong = speeds.value >= (NO_SPEED - 0.5) * RPM
        _add(signals, "rotor_speeds", speeds._replace(value=np.where(wrong, np.nan, speeds.value)))
    if not signals.has("rotor_commands") and (command := table.take((PID,))) is not None:
        _add(signals, "rotor_commands", command._replace(value=distribute(command.value)))
        signals.notes.append(f"rotor commands: by the firmware's distribution of {command.names}")
    rotors = load_vehicle(VEHICLE).rotors
    signals.notes.append(f"the log does not say which Crazyflie it is; taken as {VEHICLE}")
    return signals.flight_log(Layout(rotors.positions, rotors.yaw_sign), is_own=True, vehicle=VEHICLE)


class _Table:
    """Finds quantities among the events of a log."""

    def __init__(self, events: Mapping[str, EventRows]) -> None:
        self.events = {name: rows for name, rows in events.items() if len(rows.stamp_ns)}

    def take(self, sources: Sequence[Source]) -> Taken | None:
        """Return the first source that an event has; of several events the one with most rows."""
        for source in sources:
            if fit := [name for name in self.events if set(source.names) <= self.events[name].columns.keys()]:
                name = max(fit, key=lambda each: len(self.events[each].stamp_ns))
                rows = self.events[name]
                value = columns(rows.columns, source.names)
                value *= source.scale
                value += source.offset
                return Taken(rows.stamp_ns, value, f"{name}: {', '.join(source.names)}")
        return None


def _add(signals: Signals, field: str, taken: Taken | None, name: str = "") -> bool:
    return taken is not None and signals.add(field, taken.stamp_ns, taken.value, taken.names, name)


def _add_attitude(signals: Signals, table: _Table) -> None:
    if _add(signals, "attitude", table.take(QUATERNIONS)):
        return
    if (angles := table.take(ANGLES)) is not None:
        _add(signals, "attitude", angles._replace(value=quaternion_from_euler(angles.value)))


def distribute(command: Floats) -> Floats:
    """Motor commands (n, 4), 0 to 1, of thrust, roll, pitch and yaw of the PID controller (n, 4).

    powerDistributionLegacy and powerDistributionCap of the firmware, without battery compensation: where a
    motor would exceed the maximum, all are reduced by the excess; none is negative.
    """
    thrust, roll, pitch, yaw = command.T
    r, p = np.trunc(roll / 2.0), np.trunc(pitch / 2.0)
    motors = [thrust - r + p + yaw, thrust - r - p - yaw, thrust + r - p + yaw, thrust + r + p - yaw]
    wanted = np.stack(motors, axis=-1)
    excess = np.maximum(wanted.max(axis=-1, keepdims=True) - FULL, 0.0)
    return np.maximum(wanted - excess, 0.0) / FULL
