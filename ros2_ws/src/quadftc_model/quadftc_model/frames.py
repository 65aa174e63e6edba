"""Frames of aircraft, north-east-down and forward-right-down, to those of ROS (REP-103, REP-147).

Vectors in the body, forward-right-down (FRD) to forward-left-up (FLU): (x, y, z) -> (x, -y, -z), half a
turn about x. On the earth, north-east-down (NED) to east-north-up (ENU): (x, y, z) -> (y, x, -z), half a turn
about (1, 1, 0). Both are their own inverses. Attitudes, body to earth:

    q_ENU_FLU = q_ENU_NED  q_NED_FRD  q_FRD_FLU

In Euler angles: roll stays, pitch changes its sign, and yaw becomes pi/2 - yaw (from north clockwise to from
east counterclockwise).
"""

from __future__ import annotations

import math

import numpy as np

from quadftc_model.arrays import Quaternion, Vector, components, namespace, stacked
from quadftc_model.rotations import quaternion_from_euler, quaternion_product

Q_ENU_NED = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # x, y, z, w
Q_FRD_FLU = np.array([1.0, 0.0, 0.0, 0.0])  # x, y, z, w
_HALF_TURN_X = np.array([1.0, -1.0, -1.0])
_HALF_TURN_XY = np.array([1.0, 1.0, -1.0])


def flu_from_frd(vector: Vector) -> Vector:
    """Vector in FLU (..., 3) of one in FRD, and the other way round."""
    return vector * _HALF_TURN_X


def enu_from_ned(vector: Vector) -> Vector:
    """Vector in ENU (..., 3) of one in NED, and the other way round."""
    return vector[..., [1, 0, 2]] * _HALF_TURN_XY


def enu_flu_from_ned_frd(q_wxyz: Quaternion) -> Quaternion:
    """Attitude q_xyzw (..., 4), FLU to ENU, of (..., 4): FRD to north-east-down, w first."""
    q_xyzw = namespace(q_wxyz).asarray(q_wxyz)[..., [1, 2, 3, 0]]
    return quaternion_product(quaternion_product(Q_ENU_NED, q_xyzw), Q_FRD_FLU)


def ned_frd_from_enu_flu(q_xyzw: Quaternion) -> Quaternion:
    """The way back: FRD to north-east-down, w first (..., 4)."""
    turned = enu_flu_from_ned_frd(namespace(q_xyzw).asarray(q_xyzw)[..., [3, 0, 1, 2]])
    return turned[..., [3, 0, 1, 2]]


def enu_flu_from_ned_frd_angles(angles: Vector) -> Quaternion:
    """Attitude q_xyzw (..., 4), FLU to ENU, of roll, pitch and yaw of FRD to north-east-down [rad]."""
    roll, pitch, yaw = components(angles)
    return quaternion_from_euler(stacked([roll, -pitch, math.pi / 2.0 - yaw]))
