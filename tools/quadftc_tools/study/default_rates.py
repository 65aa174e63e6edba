"""Losses of rotors in logs at default rates: simulated flights of random vehicles through `quadftc diagnose`.

    python -m quadftc_tools.study.default_rates [--flights 60] [--seed 9000]

Each flight has a random frame (four to eight rotors), inertia, rotor lag, centre of mass, controller, gusts,
manoeuvres and noise. It is flown healthy, and with a rotor that stops or gives half its thrust. It is logged
as ArduPilot does (two IMUs at 25 Hz, attitude and outputs at 10 Hz) and as PX4 does (one IMU at 200 Hz,
attitude at 20 Hz, outputs at 10 Hz, torque and thrust at 50 Hz); satellites at 5 Hz.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_cli.screen import say
from quadftc_model.rotations import to_earth, turn
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.inspect import inspect
from quadftc_replay.readers.layouts import Layout, frame_layout

Floats = NDArray[np.float64]
DT = 0.005  # s
FRAMES = ((4, "x"), (4, "plus"), (6, "x"), (8, "x"), (4, "betaflight x"))
AUTOPILOTS = ("ArduPilot", "PX4")
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])
VOLTAGE = 12.0  # V


class Loss(NamedTuple):
    """A rotor that loses a share of its thrust."""

    rotor: int
    share: float
    onset: float  # s


class Flown(NamedTuple):
    """A flight, sample by sample; n rows."""

    layout: Layout
    rate: Floats  # (n, 3) [rad/s]
    force: Floats  # (n, 3) [m/s²]
    commands: Floats  # (n, rotors)
    attitude: Floats  # (n, 4)
    velocity: Floats  # (n, 3) [m/s]
    torque: Floats  # (n, 3) shares that are asked for


def fly(rng: np.random.Generator, seconds: float, loss: Loss | None) -> Flown:
    """Fly a random vehicle in gusts."""
    rotors, frame = FRAMES[rng.integers(len(FRAMES))]
    layout = frame_layout(rotors, frame)
    assert layout is not None
    strength = rng.uniform(30.0, 150.0) * 4.0 / rotors  # rad/s² per unit of a rotor, at an arm of one
    places, signs = np.sqrt(2.0) * layout.positions, 0.13 * layout.yaw_signs
    gains = strength * np.stack([places[:, 1], -places[:, 0], signs], axis=1)
    hover, lag, damping = rng.uniform(0.25, 0.55), rng.uniform(0.02, 0.08), rng.uniform(0.0, 1.0)
    gusts, tilt, offset = rng.uniform(0.2, 3.0), rng.uniform(0.0, 0.35), 0.3 * strength * rng.normal(size=3)
    offset *= [0.02, 0.03, 0.05]
    stiffness, damper, rhythm = (
        30.0 * rng.uniform(0.5, 1.5),
        10.0 * rng.uniform(0.7, 1.3),
        rng.uniform(0.3, 1.5, 2),
    )
    mixer = np.linalg.pinv(gains.T)
    count = round(seconds / DT)
    flown = Flown(layout, *(np.zeros((count, width)) for width in (3, 3, rotors, 4, 3, 3)))
    q, rate, velocity, gust, memory = np.array([0.0, 0.0, 0.0, 1.0]), *(np.zeros(3) for _ in range(4))
    thrust = np.full(rotors, hover)
    for row in range(count):
        now = row * DT
        wave = np.array([np.sin(rhythm[0] * now), np.cos(rhythm[1] * now), 0.0])
        error = 2.0 * q[:3] * np.sign(q[3]) - tilt * (np.sign(wave) if tilt > 0.2 else wave)
        memory = np.clip(memory + 20.0 * DT * error, -8.0, 8.0)
        asked = (-stiffness * error - damper * rate - memory) * [1.0, 1.0, 0.4]
        upright = max(float(q[3] ** 2 + q[2] ** 2 - q[0] ** 2 - q[1] ** 2), 0.5)
        command = np.clip(hover / upright + mixer @ asked, 0.0, 1.0)
        thrust = thrust + DT / lag * (command - thrust)
        given = thrust.copy()
        if loss is not None and now >= loss.onset:
            given[loss.rotor] *= 1.0 - loss.share
        gust += DT * (-gust / 0.7 + gusts * rng.standard_normal(3) / np.sqrt(DT))
        rate = rate + DT * (given @ gains + gust + offset - damping * rate)
        q = turn(q, rate * DT)
        force = given.mean() / hover * GRAVITY
        velocity = velocity + DT * (to_earth(q, force) - GRAVITY)
        torque = 2.0 * (mixer @ asked) @ gains / np.abs(gains).sum(axis=0)
        for column, value in zip(flown[1:], (rate, force, command, q, velocity, torque), strict=True):
            column[row] = value
    return flown


def log_of(flown: Flown, autopilot: str, rng: np.random.Generator) -> FlightLog:
    """Log a flight as an autopilot does by default."""
    time = np.arange(len(flown.rate), dtype=np.float64) * DT
    noise = rng.uniform(0.5, 3.0)
    force = flown.force + 0.3 * noise * np.sin(2.0 * np.pi * 73.1 * time)[:, None]

    def kept(values: Floats, rate: float, sigma: float = 0.0) -> Signal:
        rows = slice(None, None, round(1.0 / (rate * DT)))
        return Signal(time[rows], values[rows] + sigma * rng.standard_normal(values[rows].shape))

    is_px4 = autopilot == "PX4"
    imus, fast, attitude = (("",), 200.0, 20.0) if is_px4 else (("", "1"), 25.0, 10.0)
    return FlightLog(
        path=Path(autopilot),
        format="PX4 ULog" if is_px4 else "ArduPilot BIN",
        gyros={name: kept(flown.rate, fast, 0.005 * noise) for name in imus},
        accelerometers={name: kept(force, fast, 0.1 * noise) for name in imus},
        attitude=kept(flown.attitude, attitude),
        attitude_from_gyro=True,
        velocity=kept(flown.velocity, 2.5),
        gps_velocities={"": kept(flown.velocity, 5.0, 0.03 * noise)},
        rotor_commands=kept(flown.commands, 10.0),
        torque_command=kept(flown.torque, 50.0) if is_px4 else None,
        thrust_command=kept(flown.commands.mean(axis=1, keepdims=True), 50.0) if is_px4 else None,
        torque_unit="1",
        battery=kept(np.full((len(time), 1), VOLTAGE), 10.0),
        rotor_positions=flown.layout.positions,
        rotor_yaw_signs=flown.layout.yaw_signs,
    )


def said_of(seed: int, autopilot: str, share: float | None) -> tuple[str, float]:
    """Fly, log and judge; return what was said, and how far the onset is off [s]."""
    choose = np.random.default_rng([seed, 1])
    onset, after = choose.uniform(6.0, 18.0), choose.choice([1.5, 4.0, 8.0])
    rotor = int(choose.integers(FRAMES[np.random.default_rng(seed).integers(len(FRAMES))][0]))
    loss = None if share is None else Loss(rotor, share, onset)
    flown = fly(np.random.default_rng(seed), 25.0 if loss is None else onset + after, loss)
    verdict = inspect(log_of(flown, autopilot, choose)).verdict
    first = verdict.findings[0] if verdict.findings else None
    if loss is None or first is None:
        return verdict.outcome if first is None else f"wrong: {first.name}", 0.0
    is_named = (first.component, first.element) == ("rotor", str(rotor + 1))
    return "named" if is_named else f"wrong: {first.name}", abs(first.onset_s - onset)


def main() -> None:
    """Fly all, and print a table."""
    parser = argparse.ArgumentParser(description="Judge simulated flights logged at default rates.")
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--seed", type=int, default=9000, help="of the first flight")
    options = parser.parse_args()
    said, late = Counter[tuple[str, str, str]](), list[float]()
    for seed in range(options.seed, options.seed + options.flights):
        for autopilot in AUTOPILOTS:
            said[autopilot, "healthy", said_of(seed, autopilot, None)[0]] += 1
            share = (0.5, 1.0)[seed % 2]
            what, error = said_of(seed, autopilot, share)
            said[autopilot, f"rotor loses {100 * share:.0f} %", what] += 1
            late += [error] if what == "named" else []
    say(
        *(f"{autopilot}, {truth}: {what} {count}" for (autopilot, truth, what), count in sorted(said.items()))
    )
    if late:
        say(f"onset: half within {np.median(late):.2f} s, nine of ten within {np.quantile(late, 0.9):.2f} s")


if __name__ == "__main__":
    main()
