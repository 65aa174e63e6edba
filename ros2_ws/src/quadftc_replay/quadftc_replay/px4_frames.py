"""From PX4's frames to those of ROS (REP-103, REP-147).

PX4: earth north-east-down, body forward-right-down (FRD). ROS: earth east-north-up (ENU), body
forward-left-up (FLU). Vectors:

    body:   (x, y, z) -> (x, -y, -z), half a turn about x
    earth:  (x, y, z) -> (y, x, -z), half a turn about (1, 1, 0)

Attitudes, body to earth:

    q_ENU_FLU = q_ENU_NED  q_NED_FRD  q_FRD_FLU

In Euler angles: roll stays, pitch changes its sign, and yaw becomes pi/2 - yaw (from north clockwise to from
east counterclockwise).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import quaternion_product

Floats = NDArray[np.float64]

Q_ENU_NED = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # x, y, z, w
Q_FRD_FLU = np.array([1.0, 0.0, 0.0, 0.0])  # x, y, z, w
_SIGNS = np.array([1.0, -1.0, -1.0])


def flu_from_frd(vector: Floats) -> Floats:
    """Vector in FLU (..., 3) of one in FRD."""
    return vector * _SIGNS


def enu_flu_from_ned_frd(q_wxyz: Floats) -> Floats:
    """Attitude q_xyzw (..., 4), FLU to ENU, of PX4's (..., 4): FRD to north-east-down, w first."""
    q_xyzw = np.roll(np.asarray(q_wxyz, np.float64), -1, axis=-1)
    return quaternion_product(quaternion_product(Q_ENU_NED, q_xyzw), Q_FRD_FLU)
