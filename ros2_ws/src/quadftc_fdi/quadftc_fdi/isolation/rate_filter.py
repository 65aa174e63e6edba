r"""Body rate from attitude, gyro and torque: a Kalman filter that can do without any one of them.

Each body axis has its own filter of angle, rate and unknown acceleration. The torque drives it,

    omega' = f(omega) + u / J + d,   d' = white noise of density q,   angle' = omega

and each sample corrects it by the attitude (the rotation between measured and predicted one, in body axes)
and by the gyro, as far as they are used. Without the gyro, its rate is a virtual gyro.

What the torque model does not know is noise of the rate: a rotor lag and a wrong inertia err by a share of
the torque's fast changes, which d cannot follow.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import (
    Mask,
    Quaternion,
    Scalar,
    Vector,
    clip,
    components,
    exp,
    namespace,
    stacked,
    where,
)
from quadftc_model.samples import MAX_BODY_RATE

LAG = 0.03  # s; changes of the torque that are slower are followed by d
UNSURE = 0.3  # 1; share of faster changes that the rotors may not follow, or follow otherwise
UNKNOWN_RATE, UNKNOWN_ACCELERATION = 0.5, 1.0  # rad/s, rad/s²; at the start, 1 sigma


class RateFilter(NamedTuple):
    """Estimate of each axis, and the covariances of angle (a), rate (r) and acceleration (d).

    The angles are the attitude of the filter, a quaternion that the caller keeps: a prediction or a
    correction says by what it turns, in body axes [rad].
    """

    rate: Vector  # [rad/s]
    acceleration: Vector  # d [rad/s²]
    slow: Vector  # acceleration by the torque, without its fast changes [rad/s²]
    aa: Vector
    ar: Vector
    ad: Vector
    rr: Vector
    rd: Vector
    dd: Vector


def start_rate_filter(rate: Vector, drive: Vector, variance: Scalar) -> RateFilter:
    """Start at a body rate, an acceleration by the torque and a variance of the angles [rad²]."""
    zeros = namespace(rate).zeros_like(rate)
    unknown = zeros + UNKNOWN_RATE**2, zeros + UNKNOWN_ACCELERATION**2
    return RateFilter(rate, zeros, drive, variance + zeros, zeros, zeros, unknown[0], zeros, unknown[1])


def predict(
    state: RateFilter, drive: Vector, gyroscopic: Vector, q: Vector, dt: Scalar
) -> tuple[RateFilter, Vector]:
    """Predict by the accelerations [rad/s²] of the torque and of the body's own rotation.

    ``q`` [rad²/s⁵] is the density of the noise that moves d. Also return the rotation.
    """
    rate, unknown, slow, aa, ar, ad, rr, rd, dd = state
    acceleration = drive + gyroscopic + unknown
    slow = slow + (1.0 - exp(-dt / LAG)) * (drive - slow)
    missed = UNSURE * dt * (drive - slow)
    h = 0.5 * dt * dt
    turned = dt * rate + h * acceleration
    # P <- F P F' + Q, first F P, then that times F'
    aa, ar, ad = aa + dt * ar + h * ad, ar + dt * rr + h * rd, ad + dt * rd + h * dd
    rr, rd = rr + dt * rd, rd + dt * dd
    aa, ar, rr = aa + dt * ar + h * ad, ar + dt * ad, rr + dt * rd + missed * missed
    rate = clip(rate + dt * acceleration, -MAX_BODY_RATE, MAX_BODY_RATE)
    return RateFilter(rate, unknown, slow, aa, ar, ad, rr, rd, dd + q * dt), turned


def rotation_to(predicted: Quaternion, measured: Quaternion) -> Vector:
    """Rotation from a predicted attitude to a measured one, in body axes [rad]; small angles."""
    (px, py, pz, pw), (x, y, z, w) = components(predicted), components(measured)
    sign = where(pw * w + px * x + py * y + pz * z < 0.0, -2.0, 2.0)
    return stacked(
        [
            sign * (pw * x - px * w - py * z + pz * y),
            sign * (pw * y + px * z - py * w - pz * x),
            sign * (pw * z - px * y + py * x - pz * w),
        ]
    )


def correct_by_attitude(
    state: RateFilter, rotation: Vector, variance: Vector, used: Mask
) -> tuple[RateFilter, Vector]:
    """Correct by a measured attitude: rotation to it [rad], variance of it [rad²].

    Also return the rotation.
    """
    seen = state.aa, state.ar, state.ad
    return _correct(state, seen, rotation, used / (state.aa + variance))


def correct_by_gyro(
    state: RateFilter, innovation: Vector, variance: Vector, used: Mask
) -> tuple[RateFilter, Vector]:
    """Correct by a gyro: what it reads more than the predicted rate [rad/s], variance of it [rad²/s²].

    Also return the rotation.
    """
    seen = state.ar, state.rr, state.rd
    return _correct(state, seen, innovation, used / (state.rr + variance))


def _correct(
    state: RateFilter, seen: tuple[Vector, Vector, Vector], innovation: Vector, weight: Vector
) -> tuple[RateFilter, Vector]:
    """Correct by an innovation: covariances of the state with it, one over its variance."""
    rate, acceleration, slow, aa, ar, ad, rr, rd, dd = state
    a, r, d = seen
    ka, kr, kd = a * weight, r * weight, d * weight
    after = RateFilter(
        rate + kr * innovation,
        acceleration + kd * innovation,
        slow,
        aa - ka * a,
        ar - ka * r,
        ad - ka * d,
        rr - kr * r,
        rd - kr * d,
        dd - kd * d,
    )
    return after, ka * innovation


def adopt_gyro(
    state: RateFilter, rate: Vector, variance: Vector, acceleration: Vector, returns: Mask
) -> RateFilter:
    """Start again where asked for: at a rate [rad/s] of a variance, and an unknown acceleration [rad/s²]."""
    return state._replace(
        rate=where(returns, rate, state.rate),
        acceleration=where(returns, acceleration, state.acceleration),
        ar=where(returns, 0.0, state.ar),
        ad=where(returns, 0.0, state.ad),
        rr=where(returns, variance, state.rr),
        rd=where(returns, 0.0, state.rd),
        dd=where(returns, UNKNOWN_ACCELERATION**2, state.dd),
    )
