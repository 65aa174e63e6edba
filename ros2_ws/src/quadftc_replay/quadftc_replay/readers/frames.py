"""Frames of aircraft, north-east-down and forward-right-down, to those of ROS (REP-103, REP-147).

Vectors in the body, forward-right-down (FRD) to forward-left-up (FLU): (x, y, z) -> (x, -y, -z), half a
turn about x. On the earth, north-east-down (NED) to east-north-up (ENU): (x, y, z) -> (y, x, -z), half a turn
about (1, 1, 0). Attitudes, body to earth:

    q_ENU_FLU = q_ENU_NED  q_NED_FRD  q_FRD_FLU

In Euler angles: roll stays, pitch changes its sign, and yaw becomes pi/2 - yaw (from north clockwise to from
east counterclockwise).
"""

from __future__ import annotations

import math

import numpy as np

from quadftc_model.rotations import quaternion_product
from quadftc_replay.flight_log import Floats

Q_ENU_NED = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # x, y, z, w
Q_FRD_FLU = np.array([1.0, 0.0, 0.0, 0.0])  # x, y, z, w


def flu_from_frd(vector: Floats) -> Floats:
    """Vector in FLU (..., 3) of one in FRD."""
    return vector * np.array([1.0, -1.0, -1.0])


def enu_from_ned(vector: Floats) -> Floats:
    """Vector in ENU (..., 3) of one in NED."""
    return vector[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def enu_flu_from_ned_frd(q_wxyz: Floats) -> Floats:
    """Attitude q_xyzw (..., 4), FLU to ENU, of (..., 4): FRD to north-east-down, w first."""
    q_xyzw = np.roll(np.asarray(q_wxyz, np.float64), -1, axis=-1)
    return quaternion_product(quaternion_product(Q_ENU_NED, q_xyzw), Q_FRD_FLU)
