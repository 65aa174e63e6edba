"""What an attitude sensor should read: Euler angles, at any attitude.

    h = x1(q exp(-omega tau)),   H = E [I + [omega tau]x, 0, 0, -omega]         E of (4)

A noise that is alike about all body axes is E E' in the angles: 1 / cos(pitch) times as large in roll and
yaw, with correlation sin(pitch), and as it is in pitch. A fault of roll is a rotation about the body's x
axis, one of pitch about the y axis after yaw, one of yaw about the earth's z axis. So they differ at any
attitude except the poles, 90 deg of pitch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.supervision.transition import DELAY, ROTATION, Covariance, Covariances, Errors, FilterState
from quadftc_model import arrays
from quadftc_model.arrays import (
    Array,
    Flag,
    Float,
    Mask,
    Scalar,
    Vector,
    components,
    cos,
    diagonal,
    larger,
    largest,
    namespace,
    product,
    sin,
    stacked,
    where,
)
from quadftc_model.rotations import euler_from_quaternion, turn, wrap

MeasurementMatrix = Float[arrays.AnyArray, "*batch 3 16"]

MEASURED = (0, 1, 2, DELAY)  # columns of H that are not zero
MIN_COS = 0.003  # 1; cosine of pitch in E: within 0.17 deg of a pole, roll and yaw are always left out
DEFINED = 0.1  # rad; 1 sigma: an error of roll or yaw of three of them is that of a linear function to 5 %


class Prediction(NamedTuple):
    """What the attitude sensor should read, and how uncertain that is."""

    angles: Vector  # Euler angles of tau ago [rad]
    H: MeasurementMatrix
    gain: Vector  # variance of each angle for one of 1 rad² about each body axis
    lean: Scalar  # sine of pitch
    PH: Float[arrays.AnyArray, "*batch 16 3"]  # P H'
    HPH: Float[arrays.AnyArray, "*batch 3 3"]  # covariance of the angles [rad²]

    @property
    def variances(self) -> Vector:
        """Variances of the angles [rad²]."""
        return diagonal(self.HPH)


def predict_angles(state: FilterState, omega: Vector) -> Prediction:
    """Predict the Euler angles that the attitude sensor should read, at a body rate [rad/s]."""
    since = omega * state.x[..., 12:13]
    angles = euler_from_quaternion(turn(state.q_xyzw, -since))
    H, gain, lean = measurement_matrix(angles, omega, since)
    return Prediction(angles, H, gain, lean, *_seen(state.P, H))


def nearest_residual(prediction: Prediction, measured: Vector) -> Vector:
    """Measured minus predicted Euler angles [rad], (..., 3).

    (phi, theta, psi) and (phi + pi, pi - theta, psi + pi) are one attitude. Of these two, the angles nearer
    to the predicted ones are the measured ones: so pitch goes on beyond 90 deg.
    """
    near = wrap(measured - prediction.angles)
    other = wrap(measured * np.array([1.0, -1.0, 1.0]) + math.pi - prediction.angles)
    farther = ((near**2 - other**2) / prediction.gain).sum(axis=-1, keepdims=True) > 0.0
    return where(farther, other, near)


def defined(prediction: Prediction, P: Covariance, variance: Vector, there: Flag) -> tuple[Mask, Mask]:
    """Whether an angle can correct the filter, and whether it can be tested, if the attitude is ``there``.

    Pitch always corrects it. Close to 90 deg, roll and yaw do not where the sensor's own noise moves them by
    more than `DEFINED`. ``variance`` [rad²] is that of its angles. An angle cannot be tested where the
    prediction is so uncertain that the angle is no linear function of the attitude. For roll and yaw: it
    moves them by `DEFINED` more than far from the pole. For pitch: its square counts against the noise (the
    pole repels pitch).
    """
    (roll, pitch, yaw), (gain, _, _) = components(variance), components(prediction.gain)
    known = largest(diagonal(P)[..., ROTATION])
    bent = (gain - 1.0) * known
    usable = there & (larger(roll, yaw) < DEFINED**2) & (gain < 0.99 / MIN_COS**2)
    clear, straight = usable & (bent < DEFINED**2), there & (bent * known < 0.25 * pitch)
    return stacked([usable, there, usable]), stacked([clear, straight, clear])


def predict_again(prediction: Prediction, P: Covariance) -> Prediction:
    """Return the prediction with another covariance of the error state."""
    PH, HPH = _seen(P, prediction.H)
    return prediction._replace(PH=PH, HPH=HPH)


def _seen(P: Covariance, H: MeasurementMatrix) -> tuple[Array, Array]:
    """P H' and H P H'."""
    PH = product(P, H.swapaxes(-1, -2), MEASURED)
    return PH, product(H, PH, MEASURED)


def variances_by(prediction: Prediction, P: Covariances) -> Float[arrays.AnyArray, "*batch n 3"]:
    """Variances of the angles [rad²] by other covariances of the error state."""
    H = prediction.H[..., None, :, :]
    return (product(H, P, MEASURED) * H).sum(axis=-1)


def turned_angles(prediction: Prediction, dx: Errors) -> Vector:
    """Change of the predicted angles [rad] by a correction of the error state."""
    return product(prediction.H, dx[..., None], MEASURED)[..., 0]


def measurement_matrix(
    angles: Vector, omega: Vector, since: Vector
) -> tuple[MeasurementMatrix, Vector, Scalar]:
    """H at Euler angles, body rate [rad/s] and rotation since then [rad]; also gain and sine of pitch."""
    xp, (phi, theta, _) = namespace(angles), components(angles)
    s_phi, c_phi, s_theta = sin(phi), cos(phi), sin(theta)
    secant = 1.0 / larger(cos(theta), MIN_COS)  # these angles have no pitch beyond 90 deg
    tangent = s_theta * secant
    a, b, c, d = s_phi * tangent, c_phi * tangent, s_phi * secant, c_phi * secant
    (p, q, r), (x, y, z) = components(omega), components(since)
    # E = [[1, a, b], [0, c_phi, -s_phi], [0, c, d]]; E + E [omega tau]x, and -E omega
    turned = [
        *(1.0 + a * z - b * y, a + b * x - z, b + y - a * x),
        *(c_phi * z + s_phi * y, c_phi - s_phi * x, -s_phi - c_phi * x),
        *(c * z - d * y, c + d * x, d - c * x),
    ]
    slopes = [-(p + a * q + b * r), s_phi * r - c_phi * q, -(c * q + d * r)]
    rotation = stacked(turned).reshape(*angles.shape, 3)
    unseen = xp.zeros((*angles.shape, DELAY - 3))
    H = xp.concatenate([rotation, unseen, stacked(slopes)[..., None]], axis=-1)
    square = secant * secant
    return H, stacked([square, xp.ones_like(square), square]), s_theta
