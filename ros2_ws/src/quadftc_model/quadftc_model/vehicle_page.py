"""What a vehicle's file means in flight: hover, authority, time constants, a plan, and warnings, as text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotors import propeller_speeds
from quadftc_model.samples import AXES
from quadftc_model.vehicle import Vehicle

# what works, but poorly
LITTLE_THRUST = 1.5  # 1; thrust to weight below which little is left for tilt and gusts
OFF_TRIM = 0.05  # 1; share of the command range that trim and hover may be apart
SLOW_ROTORS = 0.05  # s; docs/robustness.md: slower motors cost the attitude controllers their margin
SLOW_YAW = 2.0  # rad/s²; a fault of yaw cannot be answered much faster than a turn by 45 deg in a second
USUAL_GYRATION = (0.4, 0.9)  # 1; radius of gyration over the distance of the rotors
WIDTH, HEIGHT = 41, 15  # characters of the plan

Floats = NDArray[np.float64]


class Row(NamedTuple):
    """One line of the page."""

    name: str
    value: str
    meaning: str


def hover_command(vehicle: Vehicle) -> float:
    """Command [1] at which all rotors together carry the weight."""
    rotors = vehicle.rotors
    return rotors.command_idle + vehicle.weight / (len(rotors.positions) * rotors.thrust_gain)


def page_rows(vehicle: Vehicle) -> list[Row]:
    """Return what follows from a vehicle's numbers."""
    rotors, air = vehicle.rotors, vehicle.aerodynamics
    agility = vehicle.authority / vehicle.inertia
    # in which a free rotation dies by 1/e
    decay = [
        f"{axis} {inertia / drag:.2g} s" if drag > 0.0 else f"{axis} never"
        for axis, inertia, drag in zip(AXES, vehicle.inertia, vehicle.rotational_drag, strict=True)
    ]
    drift = len(rotors.positions) * air.rotor_drag * vehicle.hover_speed
    trim_speed = float(propeller_speeds(vehicle, np.array(rotors.command_trim)))
    return [
        Row("mass", f"{vehicle.mass:g} kg", f"weight {vehicle.weight:.3g} N"),
        Row("rotors", str(len(rotors.positions)), f"{vehicle.reach:.3g} m from the centre to the outermost"),
        Row("thrust to weight", f"{vehicle.thrust_to_weight:.2f}", _tilt(vehicle)),
        Row(
            "hover speed",
            f"{vehicle.hover_speed:.0f} rad/s",
            f"{30.0 / math.pi * vehicle.hover_speed:.0f} rpm",
        ),
        Row(
            "hover command",
            f"{hover_command(vehicle):.4g}",
            f"trim {rotors.command_trim:g}, {trim_speed:.0f} rad/s",
        ),
        *(
            Row(f"authority {axis}", f"{torque:.3g} N m", f"{rate:.3g} rad/s² at the trim")
            for axis, torque, rate in zip(AXES, vehicle.authority, agility, strict=True)
        ),
        Row(
            "rotor lag",
            f"{rotors.time_constant:.3g} s",
            f"{1.0 / rotors.time_constant:.3g} rad/s of bandwidth",
        ),
        Row("free rotation dies with", ", ".join(decay), "by rotational_drag"),
        Row(
            "drift dies with",
            f"{vehicle.mass / drift:.2g} s" if drift > 0.0 else "never",
            "by rotor_drag, in hover",
        ),
    ]


def warnings(vehicle: Vehicle) -> Iterator[str]:
    """Yield what is possible, but unusual or poor to fly."""
    rotors, hover = vehicle.rotors, hover_command(vehicle)
    if vehicle.thrust_to_weight < LITTLE_THRUST:
        yield f"thrust to weight {vehicle.thrust_to_weight:.2f}: little is left for tilt and gusts"
    span = rotors.command_max - rotors.command_min
    if abs(hover - rotors.command_trim) > OFF_TRIM * span:
        yield (
            f"command_trim {rotors.command_trim:g} is not the hover command, {hover:.4g}: right for a test "
            "stand; in free flight authority is that at hover"
        )
    if rotors.time_constant > SLOW_ROTORS:
        yield f"rotor lag {rotors.time_constant:.3g} s: slow for attitude control (docs/robustness.md)"
    if (yaw := float(vehicle.authority[2] / vehicle.inertia[2])) < SLOW_YAW:
        yield f"yaw can be turned by {yaw:.2g} rad/s² only"
    gyration = np.sqrt(vehicle.inertia[:2] / vehicle.mass) / vehicle.reach
    if np.any(gyration < USUAL_GYRATION[0]) or np.any(gyration > USUAL_GYRATION[1]):
        low, high = (vehicle.mass * (share * vehicle.reach) ** 2 for share in USUAL_GYRATION)
        shown = ", ".join(f"{each:.3g}" for each in vehicle.inertia[:2])
        yield f"inertia {shown} kg m² about x, y: usual for this mass and size are {low:.2g} to {high:.2g}"
    if not np.any(vehicle.aerodynamics.drag_area) and vehicle.aerodynamics.rotor_drag == 0.0:
        yield "no [aerodynamics]: in free flight no air stops it, and wind does not move it"
    if np.any(vehicle.rotational_drag == 0.0):
        yield "rotational_drag 0: a free rotation never dies"


def plan(vehicle: Vehicle) -> list[str]:
    """Draw the rotors from above: forward is up, left is left; their numbers, and how they turn."""
    rotors = vehicle.rotors
    scale = 1.0 / float(np.max(np.abs(rotors.positions)))
    grid = [[" "] * WIDTH for _ in range(HEIGHT)]
    grid[HEIGHT // 2][WIDTH // 2] = "+"
    for number, (place, spin) in enumerate(zip(rotors.positions, rotors.spin_sign, strict=True), start=1):
        row = round((HEIGHT - 1) * 0.5 * (1.0 - place[0] * scale))
        column = round((WIDTH - 1) * 0.5 * (1.0 - 0.9 * place[1] * scale))
        word = f"{number}{'↺' if spin > 0.0 else '↻'}"
        begin = min(column, WIDTH - len(word))
        grid[row][begin : begin + len(word)] = word
    return ["".join(row).rstrip() for row in grid]


def _tilt(vehicle: Vehicle) -> str:
    """How far it can tilt and hold its height."""
    return f"holds its height up to {math.degrees(math.acos(1.0 / vehicle.thrust_to_weight)):.0f} deg of tilt"
