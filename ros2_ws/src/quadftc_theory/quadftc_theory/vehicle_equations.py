# pyright: basic
"""The equations of a multirotor and its sensors for fault diagnosis: what is known, where faults come in.

Unknown are the state (angles, body rate, velocity, position), torque, thrust over mass, specific force and
disturbances; known are sensors and commands. Every sensor axis and actuator can have a fault of any shape.

Kinematics (4) and rotation (1), (2) of Wang et al. (2021), without the propellers' gyroscopic torque.
Translation and specific force of a rotorcraft with linear drag are in body axes, with the thrust T along body
z and the wind w. Source: Martin, Salaün (2010), "The true role of accelerometer feedback in quadrotor
control", ICRA.

    v' = f - omega x v + R^T g,    f = (0, 0, T/m) - D (v - w)
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from quadftc_model.samples import AXES, STANDARD_GRAVITY
from quadftc_model.vehicle import Vehicle

COEFFICIENT_ZERO = 1e-12  # 1; a coefficient below it, among values of order 1, is rounding

# 1/s, drag over mass along body x, y, z. Estimate for the Qball-X4 by the rotor coefficients in its TOML
# file: 4 x 8.06e-5 N s²/(m rad) x 445 rad/s / 1.4 kg, and 4 x 0.16 N s/m / 1.4 kg. They are to be positive;
# no rank depends on the numbers.
DRAG = (0.10, 0.10, 0.46)
TURN_RATE = 0.6  # rad/s, of the steady turn
TURN_ROLL, TURN_PITCH = 0.25, -0.15  # rad, in the steady turn

ANGLES, RATES, BODY = ("phi", "theta", "psi"), ("p", "q", "r"), ("x", "y", "z")
VELOCITY, FORCE, TORQUE, WIND = (tuple(f"{name}_{axis}" for axis in BODY) for name in ("v", "f", "tau", "w"))
POSITION = ("east", "north", "up")
STATES = (*ANGLES, *RATES, *VELOCITY)

#: Sensors by name: the label of each axis, and the unknown that it measures.
SENSORS: Mapping[str, Mapping[str, str]] = {
    "attitude": dict(zip(AXES, ANGLES, strict=True)),
    "gyro": dict(zip(AXES, RATES, strict=True)),
    "accelerometer": dict(zip(BODY, FORCE, strict=True)),
    "second_attitude": dict(zip(AXES, ANGLES, strict=True)),
    "second_gyro": dict(zip(AXES, RATES, strict=True)),
    "heading": {"yaw": "psi"},
    "velocity": dict(zip(BODY, VELOCITY, strict=True)),
    "position": dict(zip(POSITION, POSITION, strict=True)),
}

#: What may be assumed, and how it is said.
CHOICES: Mapping[str, Mapping[str, str]] = {
    "motion": {"hover": "in hover", "turn": "in a steady turn"},
    "actuators": {"axes": "torques commanded", "rotors": "rotors commanded", "unknown": "torques not known"},
    "disturbances": {
        "faults": "disturbances to be told apart too",
        "unknown_inputs": "blind to disturbances",
        "absent": "no disturbances",
    },
    "air": {"still": "still air", "wind": "unknown wind", "no_drag": "no drag"},
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Assumptions:
    """What is measured (`SENSORS`), known and disturbing (`CHOICES`); ValueError if a name is unknown.

    In a ``turn``, attitude, rates and velocity are coupled; in ``hover``, terms of second order vanish. Each
    commanded torque or rotor can fail; with torques (``axes``), the thrust is not known. The disturbances are
    torques about the body axes; residuals are blind to ``unknown_inputs``. Drag is linear, the wind unknown
    on each axis; without drag, the thrust is the only force besides the weight.
    """

    sensor_set: Sequence[str] = ("attitude", "gyro")
    motion: str = "hover"
    actuators: str = "axes"
    disturbances: str = "faults"
    air: str = "still"

    def __post_init__(self) -> None:
        """Check the names."""
        given = [self.sensor_set] if isinstance(self.sensor_set, str) else list(self.sensor_set)
        for name in given:
            if name not in SENSORS:
                raise ValueError(f"sensor_set: '{name}' is none of {', '.join(SENSORS)}")
        if not given or len(set(given)) < len(given):
            raise ValueError(f"sensor_set = {given}: expected at least one sensor, each once")
        object.__setattr__(self, "sensor_set", tuple(name for name in SENSORS if name in given))
        for field, choices in CHOICES.items():
            if getattr(self, field) not in choices:
                raise ValueError(f"{field} = {getattr(self, field)!r}: expected one of {', '.join(choices)}")


@dataclasses.dataclass(frozen=True, eq=False)
class LinearModel:
    """Equations 0 = E x' + A x + B w + F f + known signals, linear around one motion.

    The states x are the unknowns of which derivatives appear, w the other unknowns, f the faults. A fault
    must be in exactly one equation, so that its coefficient does not matter: else ValueError.
    """

    name: str
    states: tuple[str, ...]
    faults: tuple[str, ...]
    E: NDArray[np.float64]  # (equations, states)
    A: NDArray[np.float64]  # (equations, states)
    B: NDArray[np.float64]  # (equations, other unknowns)
    F: NDArray[np.float64]  # (equations, faults)

    def __post_init__(self) -> None:
        """Check the faults."""
        for fault, count in zip(self.faults, np.count_nonzero(self.F, axis=0), strict=True):
            if count != 1:
                raise ValueError(f"{self.name}: fault '{fault}' is in {count} equations, expected 1")


def linearised(
    name: str,
    equations: Sequence[sympy.Expr],
    *,
    states: Sequence[str],
    unknowns: Sequence[str],
    faults: Sequence[str],
    point: Mapping[str, float],
) -> LinearModel:
    """Linear model around ``point`` of expressions that are zero; the derivative of state ``x`` is ``dx``."""
    groups = ([f"d{state}" for state in states], states, unknowns, faults)
    jacobian = sympy.Matrix(list(equations)).jacobian(_vector([name for names in groups for name in names]))
    values = {sympy.Symbol(symbol): sympy.Float(value) for symbol, value in point.items()}
    dense = np.array(jacobian.xreplace(values).tolist(), dtype=np.float64)
    dense[np.abs(dense) < COEFFICIENT_ZERO] = 0.0
    matrices = np.split(dense, np.cumsum([len(names) for names in groups])[:-1], axis=1)
    return LinearModel(name, tuple(states), tuple(faults), *matrices)


def vehicle_model(vehicle: Vehicle, assumptions: Assumptions) -> LinearModel:
    """Equations of a vehicle with its sensors, around the motion assumed.

    Faults are named by part and axis: sensors, actuators, then disturbances.
    """
    actuators, commands = [f"actuator {axis}" for axis in AXES], list[str]()
    if assumptions.actuators == "rotors":
        numbers = range(1, len(vehicle.rotors.positions) + 1)
        actuators, commands = [f"rotor {each}" for each in numbers], [f"c_{each}" for each in numbers]
    elif assumptions.actuators == "unknown":
        actuators = []
    role = assumptions.disturbances
    disturbances = [] if role == "absent" else [f"disturbance {axis}" for axis in AXES]
    sensors = {
        f"{sensor.replace('_', ' ')} {axis}": measured
        for sensor in assumptions.sensor_set
        for axis, measured in SENSORS[sensor].items()
    }
    outputs = _vector([f"y {name}" for name in sensors]) - _vector(list(sensors.values()))
    wind = WIND if assumptions.air == "wind" else ()
    blind_to = disturbances if role == "unknown_inputs" else []
    motion, places = _motion(vehicle, disturbances, assumptions.air), ()
    if "position" in assumptions.sensor_set:  # else nothing depends on it
        motion, places = [*motion, *_path()], POSITION
    actuation = _actuation(vehicle, actuators, commands)
    return linearised(
        f"{vehicle.name}, {'+'.join(assumptions.sensor_set)}",
        [*motion, *actuation, *(outputs - _vector(list(sensors)))],
        states=(*STATES, *places),
        unknowns=[*TORQUE, "thrust", *FORCE, *commands, *wind, *blind_to],
        faults=[*sensors, *actuators, *(disturbances if role == "faults" else ())],
        point=motion_point(vehicle, assumptions),
    )


def motion_point(vehicle: Vehicle, assumptions: Assumptions) -> dict[str, float]:
    """The motion around which the equations are taken: a value for every unknown but the rotor commands.

    Hover, or a steady turn, where only the yaw angle changes and all forces balance.
    """
    turning = assumptions.motion == "turn"
    phi, theta, turn = (TURN_ROLL, TURN_PITCH, TURN_RATE) if turning else (0.0, 0.0, 0.0)
    up = np.array([-math.sin(theta), math.sin(phi) * math.cos(theta), math.cos(phi) * math.cos(theta)])
    rate = turn * up
    thrust = np.array([0.0, 0.0, STANDARD_GRAVITY / up[2]])
    drag = np.diag(np.zeros(3) if assumptions.air == "no_drag" else DRAG)
    cross = np.cross(rate, np.eye(3)).T  # [omega x]
    velocity = np.linalg.lstsq(drag + cross, thrust - STANDARD_GRAVITY * up, rcond=None)[0]
    vectors = {
        RATES: rate,
        VELOCITY: velocity,
        TORQUE: vehicle.rotational_drag * rate + np.cross(rate, vehicle.inertia * rate),
        FORCE: thrust - drag @ velocity,
        WIND: np.zeros(3),
    }
    values = dict.fromkeys([f"d{name}" for name in STATES], 0.0)
    values |= {"phi": phi, "theta": theta, "psi": 0.0, "dpsi": turn, "thrust": float(thrust[2])}
    for names, vector in vectors.items():
        values |= dict(zip(names, vector.tolist(), strict=True))
    return values


def _motion(vehicle: Vehicle, disturbances: Sequence[str], air: str) -> list[sympy.Expr]:
    """Kinematics (4), rotation (1), (2), translation and specific force; each expression is zero."""
    sin, cos = sympy.sin, sympy.cos
    phi, theta, thrust = _vector(["phi", "theta", "thrust"])
    omega, velocity, force, torque = map(_vector, (RATES, VELOCITY, FORCE, TORQUE))
    derivatives = _vector([f"d{name}" for name in STATES])
    p, q, r = omega
    across = (sin(phi) * q + cos(phi) * r) / cos(theta)
    kinematics = sympy.Matrix([p + sin(theta) * across, cos(phi) * q - sin(phi) * r, across])

    inertia, spin_drag = (sympy.diag(*each.tolist()) for each in (vehicle.inertia, vehicle.rotational_drag))
    rotation = inertia.inv() * (torque - spin_drag * omega - omega.cross(inertia * omega))
    if disturbances:
        rotation += _vector(disturbances)

    up = sympy.Matrix([-sin(theta), sin(phi) * cos(theta), cos(phi) * cos(theta)])
    speed = velocity - _vector(WIND) if air == "wind" else velocity
    drag = sympy.diag(*((0, 0, 0) if air == "no_drag" else DRAG))
    translation = force - omega.cross(velocity) - STANDARD_GRAVITY * up
    specific_force = sympy.Matrix([0, 0, thrust]) - drag * speed
    return [*(derivatives - sympy.Matrix([*kinematics, *rotation, *translation])), *(force - specific_force)]


def _path() -> list[sympy.Expr]:
    """The change of the position by the velocity; each expression is zero."""
    phi, theta, psi = (sympy.Symbol(name) for name in ANGLES)
    turns = ((sympy.rot_axis3, psi), (sympy.rot_axis2, theta), (sympy.rot_axis1, phi))
    yaw, pitch, roll = (turn(-angle) for turn, angle in turns)
    return list(_vector([f"d{name}" for name in POSITION]) - yaw * pitch * roll * _vector(VELOCITY))


def _actuation(vehicle: Vehicle, actuators: Sequence[str], commands: Sequence[str]) -> list[sympy.Expr]:
    """The torques, and the thrust over mass where it is known, by the commands."""
    if not actuators:
        return []
    acting = _vector([f"u {name}" for name in actuators]) + _vector(actuators)
    if not commands:
        return list(_vector(TORQUE) - acting)
    thrust_row = np.full((1, len(commands)), vehicle.rotors.thrust_gain / vehicle.mass)
    mixer = sympy.Matrix(np.vstack([vehicle.mixer, thrust_row]).tolist())
    given = _vector(commands)
    return [*(given - acting), *(_vector([*TORQUE, "thrust"]) - mixer * given)]


def _vector(names: Sequence[str]) -> Any:
    return sympy.Matrix([sympy.Symbol(name) for name in names])
