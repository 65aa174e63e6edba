# pyright: basic
"""The equations of a multirotor and its sensors, as :mod:`quadftc_theory.isolability` analyses them.

The unknowns are the state (angles, body rate, velocity), the torque, the thrust over mass, the specific force
and what disturbs them; known are the outputs of the sensors and the commands. Every sensor axis and every
actuator can have a fault of any shape in time.

Kinematics (4) and rotation (1), (2) of Wang et al. (2021), without the propellers' gyroscopic torque.
Translation and specific force of a rotorcraft with linear drag after Martin, Salaün (2010), "The true role of
accelerometer feedback in quadrotor control", ICRA, in body axes, with the thrust T along body z and the wind
w:

    v' = f - omega x v + R^T g,    f = (0, 0, T/m) - D (v - w)
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.vehicle import Vehicle
from quadftc_theory.structural_model import (
    ANGLES,
    EULER,
    FORCE,
    RATES,
    SENSORS,
    VELOCITY,
    Assumptions,
    LinearModel,
    linearised,
)

# 1/s, drag over mass along body x, y, z. Estimate for the Qball-X4 by the rotor coefficients in its TOML
# file: 4 x 8.06e-5 N s²/(m rad) x 445 rad/s / 1.4 kg, and 4 x 0.16 N s/m / 1.4 kg. They are to be positive;
# no rank depends on the numbers.
DRAG = (0.10, 0.10, 0.46)
TURN_RATE = 0.6  # rad/s, of the steady turn
TURN_ROLL, TURN_PITCH = 0.25, -0.15  # rad, in the steady turn

TORQUE, WIND = ("tau_x", "tau_y", "tau_z"), ("w_x", "w_y", "w_z")


def vehicle_model(
    vehicle: Vehicle, assumptions: Assumptions, point: Mapping[str, float] | None = None
) -> LinearModel:
    """Equations of a vehicle with its sensors, around the motion assumed, or around another point.

    The faults come in the order sensors, actuators, disturbances; each name is the part and the axis.
    """
    builder = _Builder(vehicle, assumptions)
    return linearised(
        f"{vehicle.name}, {'+'.join(assumptions.sensor_set)}",
        [
            *builder.kinematics(),
            *builder.rotation(),
            *builder.translation(),
            *builder.actuation(),
            *builder.measurements(),
        ],
        states=[*ANGLES, *RATES, *VELOCITY],
        unknowns=builder.unknowns,
        faults=builder.faults,
        known=builder.known,
        point=motion_point(vehicle, assumptions) if point is None else point,
    )


def motion_point(vehicle: Vehicle, assumptions: Assumptions) -> dict[str, float]:
    """The motion around which the equations are taken: a value for every unknown but the rotor commands.

    Hover, or a steady turn at `TURN_RATE`, where only the yaw angle changes: the body rate is that of the
    turn, the thrust carries the weight, and the velocity is that at which all forces balance.
    """
    turning = assumptions.motion == "turn"
    phi, theta, turn = (TURN_ROLL, TURN_PITCH, TURN_RATE) if turning else (0.0, 0.0, 0.0)
    up = np.array([-math.sin(theta), math.sin(phi) * math.cos(theta), math.cos(phi) * math.cos(theta)])
    rate = turn * up
    thrust = np.array([0.0, 0.0, STANDARD_GRAVITY / up[2]])
    drag = np.diag(np.zeros(3) if assumptions.air == "no_drag" else DRAG)
    cross = np.array([[0.0, -rate[2], rate[1]], [rate[2], 0.0, -rate[0]], [-rate[1], rate[0], 0.0]])
    velocity = np.linalg.lstsq(drag + cross, thrust - STANDARD_GRAVITY * up, rcond=None)[0]
    values = dict.fromkeys([f"d{name}" for name in (*ANGLES, *RATES, *VELOCITY)], 0.0)
    values |= {"phi": phi, "theta": theta, "psi": 0.0, "dpsi": turn, "thrust": float(thrust[2])}
    for names, vector in (
        (RATES, rate),
        (VELOCITY, velocity),
        (TORQUE, vehicle.rotational_drag * rate + np.cross(rate, vehicle.inertia * rate)),
        (FORCE, thrust - drag @ velocity),
        (WIND, np.zeros(3)),
    ):
        values |= dict(zip(names, vector.tolist(), strict=True))
    return values


class _Builder:
    """The symbolic equations of a vehicle; each is zero without faults."""

    def __init__(self, vehicle: Vehicle, assumptions: Assumptions) -> None:
        self._vehicle = vehicle
        self._assumptions = assumptions
        rotors = range(1, len(vehicle.rotors.positions) + 1) if assumptions.actuators == "rotors" else ()
        axes = EULER if assumptions.actuators == "axes" else ()
        self._rotor_commands = [f"c_{number}" for number in rotors]
        self._actuators = [*(f"actuator {axis}" for axis in axes), *(f"rotor {number}" for number in rotors)]
        self._disturbances = [f"disturbance {axis}" for axis in EULER]
        self._sensors = {
            f"{sensor.replace('_', ' ')} {axis}": measured
            for sensor in assumptions.sensor_set
            for axis, measured in SENSORS[sensor].items()
        }

    @functools.cached_property
    def unknowns(self) -> list[str]:
        """Unknowns of which no derivative appears."""
        wind = WIND if self._assumptions.air == "wind" else ()
        decoupled = self._disturbances if self._assumptions.disturbances == "unknown_inputs" else ()
        return [*TORQUE, "thrust", *FORCE, *self._rotor_commands, *wind, *decoupled]

    @functools.cached_property
    def faults(self) -> list[str]:
        """Faults, and disturbances that are to be told apart like them."""
        told_apart = self._disturbances if self._assumptions.disturbances == "faults" else ()
        return [*self._sensors, *self._actuators, *told_apart]

    @functools.cached_property
    def known(self) -> list[str]:
        """Outputs of the sensors, and commands."""
        return [*(f"y {name}" for name in self._sensors), *(f"u {name}" for name in self._actuators)]

    def kinematics(self) -> list[Any]:
        """(4): the Euler angle rates by the body rate."""
        import sympy

        phi, theta, p, q, r, *rates = _symbols(["phi", "theta", *RATES, *(f"d{name}" for name in ANGLES)])
        across = (sympy.sin(phi) * q + sympy.cos(phi) * r) / sympy.cos(theta)
        return [
            rates[0] - (p + sympy.sin(theta) * across),
            rates[1] - (sympy.cos(phi) * q - sympy.sin(phi) * r),
            rates[2] - across,
        ]

    def rotation(self) -> list[Any]:
        """(1), (2): the angular acceleration by torque, drag, the body's own rotation and the disturbance."""
        omega, torque = _vector(RATES), _vector(TORQUE)
        inertia, drag = self._vehicle.inertia.tolist(), self._vehicle.rotational_drag.tolist()
        own = omega.cross(_diagonal(inertia) * omega)
        total = torque - _diagonal(drag) * omega - own
        acceleration = _diagonal(inertia).inv() * total
        if self._assumptions.disturbances != "absent":
            acceleration += _vector(self._disturbances)
        return list(_vector([f"d{name}" for name in RATES]) - acceleration)

    def translation(self) -> list[Any]:
        """The velocity by the specific force, and the specific force by thrust and drag."""
        import sympy

        phi, theta, thrust = _symbols(["phi", "theta", "thrust"])
        omega, velocity, force = _vector(RATES), _vector(VELOCITY), _vector(FORCE)
        up = [-sympy.sin(theta), sympy.sin(phi) * sympy.cos(theta), sympy.cos(phi) * sympy.cos(theta)]
        change = _vector([f"d{name}" for name in VELOCITY])
        air = self._assumptions.air
        speed = velocity - _vector(WIND) if air == "wind" else velocity
        drag = _diagonal((0, 0, 0) if air == "no_drag" else DRAG)
        return [
            *(change - (force - omega.cross(velocity) - STANDARD_GRAVITY * sympy.Matrix(up))),
            *(force - (sympy.Matrix([0, 0, thrust]) - drag * speed)),
        ]

    def actuation(self) -> list[Any]:
        """The torques, and the thrust over mass where it is known, by the commands."""
        import sympy

        if not self._actuators:
            return []
        torque = _vector(TORQUE)
        acting = _vector([f"u {name}" for name in self._actuators]) + _vector(self._actuators)
        if not self._rotor_commands:
            return list(torque - acting)
        commands = _vector(self._rotor_commands)
        thrust_row = np.full((1, len(commands)), self._vehicle.rotors.thrust_gain / self._vehicle.mass)
        mixer = sympy.Matrix(np.vstack([self._vehicle.mixer, thrust_row]).tolist())
        return [*(commands - acting), *(_vector([*TORQUE, "thrust"]) - mixer * commands)]

    def measurements(self) -> list[Any]:
        """Every sensor axis: output = unknown + fault."""
        outputs = _vector([f"y {name}" for name in self._sensors])
        return list(outputs - _vector(list(self._sensors.values())) - _vector(list(self._sensors)))


def _symbols(names: Sequence[str]) -> list[Any]:
    import sympy

    return [sympy.Symbol(name) for name in names]


def _vector(names: Sequence[str]) -> Any:
    import sympy

    return sympy.Matrix(_symbols(names))


def _diagonal(values: Sequence[float]) -> Any:
    import sympy

    return sympy.diag(*values)
