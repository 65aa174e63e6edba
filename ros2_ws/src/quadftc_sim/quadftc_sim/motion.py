"""The motion of a simulated vehicle over a period, and what its sensors and its readers see then."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Components, Vector
from quadftc_model.compiled import CompiledStep
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_sim.flying_plant import FlyingPlant
from quadftc_sim.plant import Plant
from quadftc_sim.rotor_fault import rotor_condition

# state, command, time before and now, period [s] -> state now, and what is seen of it
Motion = Callable[[Any, Components, float, float, float], tuple[Any, "Seen"]]


class Seen(NamedTuple):
    """What is seen of a vehicle at an instant."""

    force: Vector  # specific force at the IMU [m/s²], body axes
    angles: Vector  # Euler angles [rad]
    disturbance: Vector  # disturbance torque over the true inertia [rad/s²]
    wind: Vector | None  # velocity of the air [m/s], earth axes; None on the test stand


def see(plant: Plant, state: Any, time: float) -> Seen:
    """Return what is seen of a vehicle at a scenario time [s]."""
    wind = plant.wind(time, state.velocity) if isinstance(plant, FlyingPlant) else None
    disturbance = plant.disturbance_acceleration(time, state.body_rate)
    return Seen(plant.specific_force(state, time), euler_from_quaternion(state.q_xyzw), disturbance, wind)


def motion_of(plant: Plant) -> Motion:
    """Return the motion of a vehicle."""

    def move(state: Any, command: Components, before: float, now: float, dt: float) -> tuple[Any, Seen]:
        state = plant.step(state, command, before, dt)
        return state, see(plant, state, now)

    return move


def compiled_motion(plant: Plant) -> Motion:
    """Return the motion of a vehicle, compiled; a ValueError if it cannot be compiled.

    In free flight the rotors always have a condition, so that there is one function for healthy and faulty.
    """
    # the state comes with the inputs, as the rotors' condition changes from outside
    move, healthy, nothing = motion_of(plant), rotor_condition((), plant.command_size, 0.0), np.zeros(1)

    def complete(state: Any) -> Any:
        if isinstance(plant, FlyingPlant) and state.rotors is None:
            return plant.with_rotors(state, healthy)
        return state

    first = complete(plant.init(quaternion_from_euler(np.zeros(3)), np.zeros(3)))

    def advance(flown: Any, inputs: tuple[Any, Components, float, float], dt: float) -> tuple[Any, Any]:
        state, command, before, now = inputs
        return flown + dt, move(state, command, before, now, dt)

    step = CompiledStep(type(plant).__name__, advance, nothing, (first, plant.first_command, 0.0, 0.0))

    def move_compiled(
        state: Any, command: Components, before: float, now: float, dt: float
    ) -> tuple[Any, Seen]:
        stepped = step(nothing, (complete(state), command, before, now), dt)
        assert stepped is not None
        return stepped[1]

    return move_compiled
