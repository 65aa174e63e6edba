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
