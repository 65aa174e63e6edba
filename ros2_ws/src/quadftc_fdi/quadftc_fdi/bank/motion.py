"""The motion of a healthy vehicle: one Kalman filter, whose innovations all hypotheses share.

Each body axis has ten states:

| state | moves as | of |
|---|---|---|
| angle theta | theta' = omega + w | the attitude, which itself is a quaternion: a small error |
| bias beta | beta' = w | the gyro |
| rate omega | omega' = u / J + d | the body |
| acceleration d | d' = -d / T + w | what no model knows |
| k_x, k_y, k_z | k' = 0 | scale and alignment of the gyro |
| lag tau | tau' = 0 | the measured attitude |
| lean lambda | lambda' = w | the accelerometer: its offset, as a tilt |
| sway sigma | sigma' = -sigma / L + w | the measured attitude |

and three measurements, with white noise n: gyro = omega + beta + k omega + n, attitude = theta + sigma -
tau omega + n, and roll and pitch on a test stand, where the accelerometer feels gravity: tilt = theta +
lambda + n. An attitude that an estimator or a marker tells sways: its error comes and goes within L,
`noise.LONGER`. The gyro does not correct its own k, whose variance counts (Schmidt 1966): by a torque over
a wrong inertia a healthy gyro seems to have a wrong scale.
An attitude that an estimator makes of the same gyro repeats the gyro's errors: there theta' = gyro - beta +
w, and w holds what the estimator corrects. Axes are coupled in the mean alone, not in the covariance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank.modes import LAGS
from quadftc_fdi.bank.noise import COLOURED, CORRELATED, LONGER, SEVERAL, SMALL, Noise
from quadftc_fdi.isolation.accelerometer_monitor import LEARNED, LEAST, OFFSET
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Quaternion,
    Scalar,
    Vector,
    clip,
    column,
    components,
    cross,
    exp,
    larger,
    largest,
    namespace,
    norm,
    stacked,
    where,
)
from quadftc_model.rotations import earth_z_in_body, rotation_between, turn, wrap
from quadftc_model.samples import MAX_BODY_RATE, STANDARD_GRAVITY

THETA, BETA, OMEGA, D, SCALE, LAG, LEAN, SWAY, STATES = 0, 1, 2, 3, slice(4, 7), 7, 8, 9, 10
NONE = np.zeros(STATES)
IS_SCALE = 1.0 * np.isin(np.arange(STATES), np.arange(STATES)[SCALE])
WALK = math.radians(0.003)  # rad/s/√s; chosen: of the bias of a MEMS gyro
BIAS = math.radians(2.0)  # rad/s; chosen: of a MEMS gyro at the start
SCALES = 0.01  # 1; chosen: scale and alignment of a MEMS gyro
SMEAR = 0.005  # 1/√s; chosen: error of an attitude over the rate that wanders
JITTER = 0.001  # s; chosen: error of an attitude over the rate that is white
LOUD = 80.0  # 1; chosen: largest square of an innovation over its variance: noise has tails
LOUDER = math.log(4.0)  # 1; chosen: fourfold with each after several loud ones in a row
LEANS = OFFSET / STANDARD_GRAVITY  # rad; of a healthy accelerometer
LEAN_WALK = LEAST / STANDARD_GRAVITY / math.sqrt(LEARNED)  # rad/√s; of that
UNDRIVEN = MAX_BODY_RATE / 1.0  # rad/s²; where no torque is known: any body rate within 1 s


class Motion(NamedTuple):
    """Estimated motion; the covariance is that of each body axis by itself."""

    q_xyzw: Quaternion
    bias: Vector  # [rad/s]
    rate: Vector  # [rad/s]
    unknown: Vector  # acceleration d [rad/s²]
    scale: Array  # (..., 3, 3) of the gyro, by reading and rate
    lag: Vector  # [s]
    lean: Vector  # [rad]
    sway: Vector  # [rad]
    loud: Array  # readings in a row of gyro, attitude, tilt that were louder than that (..., 3, 3)
    covariance: Array  # (..., 3, 10, 10)


class Gains(NamedTuple):
    """What a filter makes of a measurement."""

    innovation: Vector
    variance: Vector  # of the innovation
    gain: Array  # (..., 3, 10); zeros where it is not used
    used: Mask


def start_motion(q_xyzw: Quaternion, gyro: Vector, noise: Noise) -> Motion:
    """Start at a sample, as attitude and gyro say."""
    xp = namespace(gyro)
    zeros = xp.zeros_like(gyro)
    sensor = [zeros + SCALES**2] * 3 + [zeros + LAGS**2, zeros + LEANS**2, noise.sway]
    start = stacked([noise.attitude, zeros + BIAS**2, noise.gyro + BIAS**2, noise.unknown, *sensor])
    P = start[..., None] * xp.eye(STATES)
    silent = xp.stack([zeros] * 3, axis=-2)
    return Motion(q_xyzw, zeros, gyro, zeros, xp.zeros((*gyro.shape, 3)), zeros, zeros, zeros, silent, P)


def unsettled(state: Motion, which: int, variance: Vector) -> Motion:
    """Let one of the states have a variance (..., 3), at least."""
    P = state.covariance
    more = larger(variance - P[..., which, which], 0.0)
    return state._replace(covariance=P + more[..., None, None] * np.diag(np.eye(STATES)[which]))


def untaught(state: Motion, axes: Mask) -> Motion:
    """Forget scale and alignment of gyros (..., 3): what a faulty one reads tells of its fault."""
    own = IS_SCALE > 0.0
    start = SCALES**2 * np.diag(1.0 * own)
    P = where(column(column(axes)) & (own | own[:, None]), start, state.covariance)
    return state._replace(scale=where(column(axes), 0.0, state.scale), covariance=P)


def predict(
    state: Motion,
    known: Vector,
    between: Vector,
    driven: Flag,
    gyro: Vector,
    walk: Vector,
    noise: Noise,
    repeats_gyro: bool,
    dt: Scalar,
) -> Motion:
    """Advance by ``dt`` [s] with a known acceleration [rad/s²], if ``driven``.

    ``gyro`` is the mean reading since, whose bias walks by ``walk`` [rad/s/sqrt(s)].
    """
    step, zeros = column(dt), namespace(state.rate).zeros_like(state.rate)
    keep = exp(-step / CORRELATED)
    rate = clip(state.rate + (known + state.unknown) * step, -MAX_BODY_RATE, MAX_BODY_RATE)
    turning = gyro - state.bias if repeats_gyro else 0.5 * (state.rate + rate)
    drive = noise.unknown * (1.0 - keep**2)
    loose = where(column(driven), (0.5 * between) ** 2 / 3.0, UNDRIVEN**2) * step**2  # uniform
    wander = (noise.wander + (SMEAR * norm(state.rate)) ** 2) * step
    sway = noise.sway * (1.0 - exp(-2.0 * step / LONGER))
    driven_by = [wander, walk**2 * step, drive * step**2 / 3.0 + loose, drive]
    Q = stacked([*driven_by, *[zeros] * 4, LEAN_WALK**2 * step + zeros, sway])
    P = _moved(_moved(state.covariance, repeats_gyro, dt).swapaxes(-1, -2), repeats_gyro, dt)
    return state._replace(
        q_xyzw=turn(state.q_xyzw, turning * step),
        rate=rate,
        unknown=keep * state.unknown,
        sway=exp(-step / LONGER) * state.sway,
        covariance=P + Q[..., None] * namespace(P).eye(STATES),
    )


def _moved(P: Array, repeats_gyro: bool, dt: Scalar) -> Array:
    """Rows of F P (..., 3, 10, 10) over ``dt`` [s]."""
    step = column(column(dt))
    rows = [P[..., k, :] for k in range(STATES)]
    by = -rows[BETA] if repeats_gyro else rows[OMEGA] + 0.5 * step * rows[D]
    rows[THETA] = rows[THETA] + step * by
    rows[OMEGA] = rows[OMEGA] + step * rows[D]
    rows[D] = exp(-step / CORRELATED) * rows[D]
    rows[SWAY] = exp(-step / LONGER) * rows[SWAY]
    return namespace(P).stack(rows, axis=-2)


def rate_vagueness(before: Motion, now: Motion, dt: Scalar) -> Vector:
    """Return how vague the rate is that was predicted from ``before`` over ``dt`` [s]: a variance [rad²/s²].

    It is that of white errors which average alike: of errors that correlate by rho from sample to sample,
    (1 + rho) / (1 - rho) times their own.
    """
    P, last = now.covariance[..., OMEGA, OMEGA], before.covariance[..., OMEGA, :]
    alike = clip(last[..., OMEGA] + column(dt) * last[..., D], 0.0, COLOURED * P)
    return P * (P + alike) / (P - alike)


def reckon(before: Vector, angles: Vector, turned: Vector, dt: Scalar) -> Vector:
    """Return angles that have ``turned`` from ``before``, and follow ``angles`` slowly [rad]."""
    return angles - exp(-column(dt) / CORRELATED) * wrap(angles - before - turned)


def take_gyro(state: Motion, gyro: Vector, noise: Vector, used: Mask) -> tuple[Motion, Gains]:
    """Correct the motion by a reading of the gyro [rad/s] whose noise has a variance."""
    P, rate = state.covariance, state.rate[..., None, :]
    across = P[..., BETA, :] + P[..., OMEGA, :] + (P[..., SCALE, :] * rate[..., None]).sum(axis=-2)  # P H'
    own = across[..., BETA] + across[..., OMEGA] + (across[..., SCALE] * rate).sum(axis=-1)
    return _correct(state, 0, gyro_error(state, gyro), across, own + noise, used, IS_SCALE)


def gyro_error(state: Motion, gyro: Vector) -> Vector:
    """What a gyro reads too much [rad/s], by the motion."""
    return gyro - state.rate - state.bias - (state.scale * state.rate[..., None, :]).sum(axis=-1)


def take_attitude(state: Motion, q_xyzw: Quaternion, noise: Vector, used: Mask) -> tuple[Motion, Gains]:
    """Correct the motion by a measured attitude whose noise has a variance [rad²]."""
    innovation = rotation_between(state.q_xyzw, q_xyzw) + state.lag * state.rate - state.sway
    P = state.covariance
    across = P[..., THETA, :] + P[..., SWAY, :] - P[..., LAG, :] * column(state.rate)
    own = across[..., THETA] + across[..., SWAY] - across[..., LAG] * state.rate
    noise = noise + (JITTER * norm(state.rate)) ** 2
    return _correct(state, 1, innovation, across, own + noise, used, NONE)


def take_tilt(state: Motion, force: Vector, noise: Vector, used: Mask) -> tuple[Motion, Gains]:
    """Correct roll and pitch by a specific force that is gravity's [m/s²]; ``noise`` is its variance.

    What it reads along z does not count: a fault of that would be a tilt wherever the vehicle tilts.
    """
    vertical, (x, y, _) = earth_z_in_body(state.q_xyzw), components(force / STANDARD_GRAVITY)
    innovation = cross(stacked([x, y, vertical[..., 2]]), vertical) - state.lean
    across = state.covariance[..., THETA, :] + state.covariance[..., LEAN, :]
    own = across[..., THETA] + across[..., LEAN] + column(largest(noise)) / STANDARD_GRAVITY**2
    return _correct(state, 2, innovation, across, own, used & np.array([True, True, False]), NONE)


def _correct(
    state: Motion,
    sensor: int,
    innovation: Vector,
    across: Array,
    variance: Vector,
    used: Mask,
    kept: Array,
) -> tuple[Motion, Gains]:
    """Correct the motion by an innovation, but for the states that are ``kept`` (10,): 1 there."""
    loud = state.loud[..., sensor, :]
    bound = innovation * innovation / (LOUD * exp(LOUDER * larger(loud - SEVERAL, 0.0)))
    variance = larger(variance, SMALL)
    louder = where(bound > variance, loud + 1.0, larger(loud - 1.0, 0.0))
    own = np.eye(3)[sensor][:, None] * column(used).swapaxes(-1, -2)
    variance = larger(variance, bound)
    best = where(column(used), across / column(variance), 0.0)
    gain = best * (1.0 - kept)
    moved = moved_by(state, gain * column(innovation))
    P = state.covariance - best[..., :, None] * across[..., None, :] * (1.0 - kept[:, None] * kept)
    heard = state.loud + own * (louder - loud)[..., None, :]
    return moved._replace(covariance=P, loud=heard), Gains(innovation, variance, gain, used)


def moved_by(state: Motion, change: Array) -> Motion:
    """Add a change (..., 3, 10) of the states."""
    return state._replace(
        q_xyzw=turn(state.q_xyzw, change[..., THETA]),
        bias=state.bias + change[..., BETA],
        rate=state.rate + change[..., OMEGA],
        unknown=state.unknown + change[..., D],
        scale=state.scale + change[..., SCALE],
        lag=state.lag + change[..., LAG],
        lean=state.lean + change[..., LEAN],
        sway=state.sway + change[..., SWAY],
    )
