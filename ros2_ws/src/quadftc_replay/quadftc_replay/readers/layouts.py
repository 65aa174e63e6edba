"""Where the rotors of usual frames are, in the order of the autopilots.

ArduPilot's and PX4's frames "x" and "plus" are the same. Directions only: how long the arms are, no log says.

Source: ArduPilot, AP_MotorsMatrix.cpp; PX4, src/lib/mixer/MultirotorMixer/geometries/*.toml.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_replay.flight_log import Floats

# rotors, frame -> angle of each rotor from the front, clockwise seen from above [deg]; how it turns so seen
FRAMES = {
    (4, "plus"): ((90.0, -90.0, 0.0, 180.0), "ccw ccw cw cw"),
    (4, "x"): ((45.0, -135.0, -45.0, 135.0), "ccw ccw cw cw"),
    (4, "h"): ((45.0, -135.0, -45.0, 135.0), "cw cw ccw ccw"),
    (4, "plus reversed"): ((90.0, -90.0, 0.0, 180.0), "cw cw ccw ccw"),
    (4, "betaflight x"): ((135.0, 45.0, -135.0, -45.0), "cw ccw ccw cw"),
    (4, "betaflight x reversed"): ((135.0, 45.0, -135.0, -45.0), "ccw cw cw ccw"),
    (4, "dji x"): ((45.0, -45.0, -135.0, 135.0), "ccw cw ccw cw"),
    (4, "clockwise x"): ((45.0, 135.0, -135.0, -45.0), "ccw cw ccw cw"),
    (6, "plus"): ((0.0, 180.0, -120.0, 60.0, -60.0, 120.0), "cw ccw cw ccw ccw cw"),
    (6, "x"): ((90.0, -90.0, -30.0, 150.0, 30.0, -150.0), "cw ccw cw ccw ccw cw"),
    (6, "dji x"): ((30.0, -30.0, -90.0, -150.0, 150.0, 90.0), "ccw cw ccw cw ccw cw"),
    (6, "clockwise x"): ((30.0, 90.0, 150.0, -150.0, -90.0, -30.0), "ccw cw ccw cw ccw cw"),
    (8, "plus"): ((0.0, 180.0, 45.0, 135.0, -45.0, -135.0, -90.0, 90.0), "cw cw ccw ccw ccw ccw cw cw"),
    (8, "x"): ((22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5), "cw cw ccw ccw ccw ccw cw cw"),
}
FEWEST = 100  # samples that tell a mixer
ROUNDING = 1e-12  # of a share squared
LEAST_FIT = 0.9  # R² of each rotor; 0.994 and more in a flight of Betaflight


class Layout(NamedTuple):
    """Where the rotors are, and how they turn the vehicle."""

    positions: Floats  # (n, 2) x forward, y left [m], or directions
    yaw_signs: Floats  # (n,) of the reaction torque about z, up


def frame_layout(rotors: int, frame: str) -> Layout | None:
    """Layout of a usual frame; None if it is not known. A rotor turns the vehicle against its own sense."""
    if (rotors, frame) not in FRAMES:
        return None
    angles, senses = FRAMES[rotors, frame]
    radians = np.radians(np.array(angles))
    signs = [-1.0 if sense == "ccw" else 1.0 for sense in senses.split()]
    return Layout(np.stack([np.cos(radians), -np.sin(radians)], axis=-1), np.array(signs))


def mixer_layout(commands: Floats, torques: Floats) -> Layout | None:
    """Layout by how the firmware mixes torques (n, 3) into commands (n, rotors); None if they do not tell.

    Commands less their mean are u = M τ, where no rotor is at a limit. With the columns of M for roll, pitch
    and yaw a rotor is at y = M_roll, x = -M_pitch, and turns the vehicle by the sign of M_yaw.
    """
    free = ((commands > 0.0) & (commands < 1.0)).all(axis=1)
    if free.sum() < FEWEST:
        return None
    shares = commands[free] - commands[free].mean(axis=1, keepdims=True)
    given = np.concatenate([torques[free], np.ones((int(free.sum()), 1))], axis=1)
    mixer: Floats = np.linalg.pinv(given) @ shares
    left, spread = np.var(shares - given @ mixer, axis=0), np.var(shares, axis=0)
    if not np.all(left < (1.0 - LEAST_FIT) * spread - ROUNDING) or not np.all(mixer[2]):
        return None
    positions = np.stack([-mixer[1], mixer[0]], axis=-1)
    return Layout(positions / np.linalg.norm(positions, axis=1).max(), np.sign(mixer[2]))
