"""Random multirotors, and random flights for them: winds, gusts, manoeuvres, sensors, rotors that fail.

A vehicle is one of those that come with quadftc, with four, six or eight rotors in a frame of the autopilots,
and other mass, inertia, lag and centre of mass.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_flight.scenario import Scenario, parse_scenario
from quadftc_model.vehicle import Vehicle, load_vehicle
from quadftc_model.vehicle_table import KEYS
from quadftc_replay.readers.layouts import Layout, frame_layout

BASES = ("crazyflie_2x", "hummingbird", "qball_x4", "x500")
FRAMES = ((4, "x"), (4, "plus"), (4, "betaflight x"), (6, "x"), (6, "plus"), (8, "x"), (8, "plus"))
CONTROLLERS, GUIDANCES = ("pid", "indi"), ("geometric", "pid_cascade")  # as autopilots have them
RATE = 400.0  # Hz: that of ArduCopter's loop, and twice that of PX4's sensor_combined
HEIGHT = 8.0  # m


class Loss(NamedTuple):
    """A rotor that loses a share of its thrust, to the end."""

    which: float  # of the rotors, from 0 to 1
    share: float
    onset: float  # s


class RandomFlight(NamedTuple):
    """A flight to be flown."""

    base: str  # vehicle that it is made of
    layout: Layout  # as the autopilot knows it
    vehicle: Vehicle
    scenario: Scenario
    rotor: int  # that fails, from 1; 0: none


def draw_flight(rng: np.random.Generator, seconds: float, folder: Path, loss: Loss | None) -> RandomFlight:
    """Draw a vehicle and a flight; the file of the vehicle goes into a folder."""
    base, (rotors, frame) = str(rng.choice(BASES)), FRAMES[rng.integers(len(FRAMES))]
    layout = frame_layout(rotors, frame)
    assert layout is not None
    vehicle = draw_vehicle(rng, load_vehicle(base), layout)
    path = folder / "vehicle.toml"
    path.write_text(vehicle_text(vehicle), encoding="utf-8")
    data: dict[str, object] = {
        "name": "random",
        "description": "a random flight",
        "duration": seconds,
        "rate": RATE,
        "seed": int(rng.integers(2**31)),
        "vehicle": str(path),
        "plant": {"kind": "free_flight", "start": [0.0, 0.0, HEIGHT]},
        "sensors": {"grade": str(rng.choice(("ahrs", "mems"))), "accelerometer_noise": 0.0},
        "position_sensor": {"grade": "mocap"},  # estimates of autopilots are as smooth, by GPS, too
        "trajectories": [draw_trajectory(rng, seconds)],
        "wind": draw_wind(rng, seconds),
    }
    roles = {"controller": CONTROLLERS, "position_controller": GUIDANCES}
    data["schemes"] = {"flown": {role: str(rng.choice(names)) for role, names in roles.items()}}
    rotor = 0 if loss is None else int(loss.which * rotors) + 1
    if loss is not None:
        fault = {"kind": "loss", "channel": "rotor", "rotors": [rotor], "value": loss.share}
        data["faults"] = [{**fault, "start": loss.onset}]
    return RandomFlight(base, layout, vehicle, parse_scenario(json.dumps(data)), rotor)


def draw_vehicle(rng: np.random.Generator, base: Vehicle, layout: Layout) -> Vehicle:
    """Draw a vehicle like another one, with rotors that together give as much."""
    old, count = base.rotors, len(layout.yaw_signs)
    share = len(old.positions) / count
    mass = base.mass * rng.uniform(0.85, 1.1)
    hover = base.weight / base.mass * mass / (count * share * old.thrust_gain) + old.command_idle
    reach = base.reach
    off = 0.02 * reach * rng.standard_normal(2)  # of the centre of mass
    rotors = dataclasses.replace(
        old,
        positions=reach * layout.positions - off,
        yaw_sign=layout.yaw_signs,
        spin_sign=-layout.yaw_signs,
        thrust_gain=share * old.thrust_gain,
        yaw_gain=share * old.yaw_gain,
        thrust_coefficient=share * old.thrust_coefficient,
        command_trim=hover,
        time_constant=old.time_constant * rng.uniform(0.7, 1.5),
    )
    inertia = base.inertia * rng.uniform(0.8, 1.25)
    return dataclasses.replace(base, name="random", mass=mass, inertia=inertia, rotors=rotors)


def vehicle_text(vehicle: Vehicle) -> str:
    """Return the file of a vehicle."""
    lines: list[str] = []
    for section, keys in KEYS.items():
        holder: object = getattr(vehicle, section) if section else vehicle
        lines += [f"[{section}]"] if section else []
        for key in keys:
            value = getattr(holder, key)
            lines.append(f"{key} = {json.dumps(value.tolist() if isinstance(value, np.ndarray) else value)}")
    return "\n".join(lines) + "\n"


def draw_trajectory(rng: np.random.Generator, seconds: float) -> dict[str, object]:
    """Draw a manoeuvre that lasts the whole flight."""
    kind, yaw = str(rng.choice(("hover", "circle", "figure_eight", "waypoints"))), rng.uniform(-0.3, 0.3)
    centre, push = [0.0, 0.0, HEIGHT], rng.uniform(0.5, 5.0)  # m/s²; more is for no autopilot by default
    if kind == "hover":
        return {"kind": kind, "position": centre, "yaw": yaw}
    if kind == "circle":
        radius = rng.uniform(2.0, 10.0)
        speed = np.sqrt(push * radius)
        return {"kind": kind, "centre": [-radius, 0.0, HEIGHT], "radius": radius, "speed": speed, "yaw": yaw}
    if kind == "figure_eight":
        length = rng.uniform(4.0, 20.0)
        period = 2.0 * np.pi * np.sqrt(length / push)
        return {"kind": kind, "centre": centre, "length": length, "width": length / 2.0, "period": period}
    count = 3 + round(seconds / 4.0)
    steps = rng.uniform([-8.0, -8.0, -3.0], [8.0, 8.0, 3.0], (count, 3))
    points = [centre, *(np.array(centre) + steps).tolist()]
    return {"kind": kind, "points": points, "speed": rng.uniform(0.5, 5.0), "acceleration": push, "yaw": yaw}


def draw_wind(rng: np.random.Generator, seconds: float) -> Sequence[dict[str, object]]:
    """Draw a mean wind, turbulence, and now and then a gust."""
    speed, towards = rng.uniform(0.0, 8.0), rng.uniform(0.0, 2.0 * np.pi)
    along = np.array([np.cos(towards), np.sin(towards), 0.0])
    dryden = {"kind": "dryden", "wind_speed": speed, "airspeed": 1.0 + speed, "height": HEIGHT}
    winds: list[dict[str, object]] = [
        {"kind": "constant", "velocity_mean": (0.7 * speed * along).tolist()},
        {**dryden, "history": rng.random()},
    ]
    if rng.random() < 0.3:
        start = rng.uniform(0.2, 0.8) * seconds
        gust = {"kind": "gust", "amplitude": (rng.uniform(2.0, 8.0) * along).tolist(), "start": start}
        winds.append({**gust, "rise": rng.uniform(0.3, 2.0)})
    return winds
