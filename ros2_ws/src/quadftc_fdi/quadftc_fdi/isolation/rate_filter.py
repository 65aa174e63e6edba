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
    pick,
    stacked,
)
from quadftc_model.rotations import turn
from quadftc_model.samples import MAX_BODY_RATE

LAG = 0.03  # s; changes of the torque that are slower are followed by d
UNSURE = 0.3  # 1; share of faster changes that the rotors may not follow, or follow otherwise
UNKNOWN_RATE, UNKNOWN_ACCELERATION = 0.5, 1.0  # rad/s, rad/s²; at the start, 1 sigma


class RateFilter(NamedTuple):
    """Estimate, and the covariances of angle (a), rate (r) and acceleration (d) on each axis."""

    q_xyzw: Quaternion
    rate: Vector  # [rad/s]
    acceleration: Vector  # d [rad/s²]
    slow: Vector  # acceleration by the torque, without its fast changes [rad/s²]
    aa: Vector
    ar: Vector
    ad: Vector
    rr: Vector
    rd: Vector
    dd: Vector


def start_rate_filter(q_xyzw: Quaternion, rate: Vector, drive: Vector, variance: Scalar) -> RateFilter:
    """Start at an attitude with its variance [rad²], a body rate and an acceleration by the torque."""
    zeros = namespace(rate).zeros_like(rate)
    unknown = zeros + UNKNOWN_RATE**2, zeros + UNKNOWN_ACCELERATION**2
    return RateFilter(
        q_xyzw, rate, zeros, drive, variance + zeros, zeros, zeros, unknown[0], zeros, unknown[1]
    )


def predict(state: RateFilter, drive: Vector, gyroscopic: Vector, q: Scalar, dt: float) -> RateFilter:
    """Predict by the accelerations [rad/s²] of the torque and of the body's own rotation.

    ``q`` [rad²/s⁵] is the density of the noise that moves d.
    """
    rate = state.rate
    acceleration = drive + gyroscopic + state.acceleration
    q_xyzw = turn(state.q_xyzw, dt * rate + 0.5 * dt * dt * acceleration)
    slow = state.slow + (1.0 - exp(-dt / LAG)) * (drive - state.slow)
    missed = UNSURE * dt * (drive - slow)
    h = 0.5 * dt * dt
    aa = state.aa + dt * state.ar + h * state.ad
    ar = state.ar + dt * state.rr + h * state.rd
    ad = state.ad + dt * state.rd + h * state.dd
    rr, rd = state.rr + dt * state.rd, state.rd + dt * state.dd
    return RateFilter(
        q_xyzw,
        clip(rate + dt * acceleration, -MAX_BODY_RATE, MAX_BODY_RATE),
        state.acceleration,
        slow,
        aa + dt * ar + h * ad,
        ar + dt * ad,
        ad,
        rr + dt * rd + missed * missed,
        rd,
        state.dd + q * dt,
    )


def rotation_to(state: RateFilter, q_xyzw: Quaternion) -> Vector:
    """Rotation from the predicted attitude to a measured one, in body axes [rad]; small angles."""
    (px, py, pz, pw), (x, y, z, w) = components(state.q_xyzw), components(q_xyzw)
    sign = pick(pw * w + px * x + py * y + pz * z < 0.0, -2.0, 2.0)
    return stacked(
        [
            sign * (pw * x - px * w - py * z + pz * y),
            sign * (pw * y + px * z - py * w - pz * x),
            sign * (pw * z - px * y + py * x - pz * w),
        ]
    )


def correct_by_attitude(state: RateFilter, rotation: Vector, variance: Vector, used: Mask) -> RateFilter:
    """Correct by a measured attitude: rotation to it [rad], variance of it [rad²]."""
    return _correct(state, (state.aa, state.ar, state.ad), rotation, used / (state.aa + variance))


def correct_by_gyro(state: RateFilter, innovation: Vector, variance: Vector, used: Mask) -> RateFilter:
    """Correct by a gyro: what it reads more than the predicted rate [rad/s], variance of it [rad²/s²]."""
    return _correct(state, (state.ar, state.rr, state.rd), innovation, used / (state.rr + variance))


def _correct(
    state: RateFilter, seen: tuple[Vector, Vector, Vector], innovation: Vector, weight: Vector
) -> RateFilter:
    """Correct by an innovation: covariances of the state with it, one over its variance."""
    a, r, d = seen
    ka, kr, kd = a * weight, r * weight, d * weight
    return RateFilter(
        turn(state.q_xyzw, ka * innovation),
        state.rate + kr * innovation,
        state.acceleration + kd * innovation,
        state.slow,
        state.aa - ka * a,
        state.ar - ka * r,
        state.ad - ka * d,
        state.rr - kr * r,
        state.rd - kr * d,
        state.dd - kd * d,
    )


def adopt_rate(state: RateFilter, rate: Vector, variance: Vector, where: Mask) -> RateFilter:
    """Start again at a rate [rad/s] of a variance on some axes."""
    kept = ~where
    xp = namespace(rate)
    return state._replace(
        rate=xp.where(where, rate, state.rate),
        ar=state.ar * kept,
        rr=xp.where(where, variance, state.rr),
        rd=state.rd * kept,
    )


def absorb(state: RateFilter, rotation: Vector) -> RateFilter:
    """Take over a rotation [rad] of the attitude that is none of the vehicle."""
    return state._replace(q_xyzw=turn(state.q_xyzw, rotation))
