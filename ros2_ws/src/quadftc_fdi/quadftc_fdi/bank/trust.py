"""Axes of a sensor that are not believed: what they read too much, and when they are right again.

An attitude that is not believed is left out, and the gyro takes its place. A gyro that is not believed is a
gyro whose bias walks quickly: it still says how the rate changes from sample to sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadftc_fdi.bank import inference, modes
from quadftc_fdi.bank.inference import Bank, Posterior
from quadftc_fdi.bank.motion import BETA, STATES, Motion, moved_by
from quadftc_model.arrays import (
    Array,
    Flag,
    Mask,
    Scalar,
    Vector,
    clip,
    column,
    exp,
    larger,
    log,
    namespace,
    where,
)

FAULTY_WALK = 0.1  # rad/s/sqrt(s); of the bias of a gyro that is not believed
BACK = 0.3  # s; for which a gyro's bias must be what it was
AGREES = 1.0  # s; for which an attitude must agree
SEEN, JUMP = 12.0, 9.0  # 1; log-likelihood from which an end was seen, at 1e-3 a sample; square of a jump
AVERAGE = 0.02  # s; over which the size of a fault of the attitude is averaged
BOUND = 20.0  # 1; log-likelihood of a single reading, at most


class Trust(NamedTuple):
    """What is known of a sensor's axes."""

    faulty: Mask
    age: Vector  # of the fault [s]
    size: Vector  # reading less motion
    other: Vector  # of the attitude the largest size; of the gyro its bias before the fault
    evidence: Vector  # log-likelihood ratio that the fault is over
    calm: Vector  # for how long it has looked healthy [s]


def full_trust(like: Vector) -> Trust:
    """Start with all axes believed."""
    zeros = namespace(like).zeros_like(like)
    return Trust(zeros > 0.0, zeros, zeros, zeros, zeros, zeros)


def take_over(motion: Motion, bank: Bank, posterior: Posterior, mode: Array) -> tuple[Motion, Bank, Scalar]:
    """Believe the likeliest onset of a mode (..., modes): return motion, bank and age of that onset [s]."""
    xp = namespace(posterior.log_weight)
    own = where(mode[..., None], posterior.log_weight, 2.0 * inference.LOWEST)
    pick = mode[..., None] & (own == own.max(axis=(-1, -2), keepdims=True))

    def of(part: Array) -> Array:
        return where(pick, part, 0.0).sum(axis=(-1, -2))

    # what a faulty gyro reads too much is its bias from now on
    bias = modes.pattern(modes.GYRO)[:, None, :, None] * inference.shape_of(bank)[..., None, :, :, :]
    bias = bias[..., None, :, :, :, :] * np.equal(np.arange(STATES), BETA)[:, None, None, None, None]
    picked = where(pick[..., None, None, None, :, :], bank.U + bias, 0.0).sum(axis=(-1, -2))
    U = xp.moveaxis(picked, -3, -1)  # (..., 3, 2, 8)
    b = xp.stack([of(posterior.b[..., k, :, :]) for k in range(2)], axis=-1)
    first, mixed, last = (of(posterior.covariance[..., k, :, :]) for k in range(3))
    spread = xp.stack([xp.stack([first, mixed], axis=-1), xp.stack([mixed, last], axis=-1)], axis=-2)
    change = (U * b[..., None, :, None]).sum(axis=-2)
    P = motion.covariance + U.swapaxes(-1, -2) @ spread[..., None, :, :] @ U
    axes = (mode[..., None] & (modes.AXIS[:, None] == np.arange(3))).any(axis=-2)
    return moved_by(motion, change)._replace(covariance=P), inference.forget(bank, axes), of(bank.age)


def watch_gyro(state: Trust, named: Mask, age: Scalar, motion: Motion, before: Vector, dt: Scalar) -> Trust:
    """Watch a gyro until its bias [rad/s] is what it was ``before``."""
    begins = named & ~state.faulty
    usual = where(begins, before, state.other)
    size = motion.bias - usual
    agrees = size * size < 4.0 * motion.covariance[..., BETA, BETA]
    calm = where(named, 0.0, (state.calm + dt) * agrees)
    faulty = (state.faulty | named) & (calm < BACK)
    return _kept(faulty, where(begins, column(age), state.age + dt), size, usual, state.evidence, calm)


def watch_attitude(
    state: Trust,
    named: Mask,
    age: Scalar,
    off: Vector,
    variance: Vector,
    noise: Vector,
    there: Flag,
    dt: Scalar,
) -> Trust:
    """Watch an attitude that reads ``off`` [rad] by the motion, with a variance, of which noise is a part."""
    begins, present = named & ~state.faulty, column(there)
    news, spread = off - state.size, 1.2 * noise
    ended, goes_on = off * off / variance, news * news / spread
    ratio = clip(0.5 * (goes_on - ended - log(variance / spread)), -BOUND, BOUND)
    jumped = present & (goes_on > JUMP)  # what agrees for other reasons tells nothing new with each sample
    evidence = where(jumped, state.evidence + ratio, (1.0 - dt / AVERAGE) * state.evidence)
    evidence = where(begins, 0.0, larger(evidence, 0.0))
    size = where(begins, off, state.size + (1.0 - exp(-dt / AVERAGE)) * news * present)
    peak = where(begins, abs(off), larger(state.other, abs(size)))
    small = abs(size) < 0.5 * peak
    agrees = (size * size < 4.0 * variance) & small | (size * size < variance)
    calm = where(begins, 0.0, (state.calm + dt) * (agrees & present))
    over = ~begins & ((evidence > SEEN) & (abs(off) < 0.5 * peak) | (calm > AGREES))
    faulty = (state.faulty | named) & ~over
    return _kept(faulty, where(begins, column(age), state.age + dt), size, peak, evidence, calm)


def _kept(faulty: Mask, *parts: Vector) -> Trust:
    return Trust(faulty, *(where(faulty, part, 0.0) for part in parts))
