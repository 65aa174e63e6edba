r"""Which rotor is weak, and by how much: one step of the diagnosis of all rotors.

1. Average the residual of gyro and accelerometer against the rotors' thrust, and judge it (`evidence`).
2. A rotor that is blamed for `HOLD` is named. Its loss is estimated from then on (`losses`).
3. Where speeds are measured: a rotor that does not follow its command is named, too (`following`).
4. A named rotor is healthy again once its loss has been small, and it has followed, for `RECOVERED`.

The means and variances that residuals are judged by are learned while no rotor is named. So what is constant
from the start is no fault: a centre of mass that is off, a wrong inertia, a rotor that was always weak.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from quadftc_fdi.rotor_diagnosis import evidence, following, losses
from quadftc_fdi.rotor_diagnosis.evidence import Evidence, Judged, Residuals
from quadftc_fdi.rotor_diagnosis.following import Following
from quadftc_fdi.rotor_diagnosis.losses import Losses
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects
from quadftc_model import samples
from quadftc_model.arrays import (
    Array,
    Flag,
    Scalar,
    Vector,
    changed_where,
    clip,
    is_single,
    larger,
    namespace,
)
from quadftc_model.samples import FAULT_KINDS, RotorEstimate

HOLD = 0.011  # s; for how long a rotor is blamed before it is named
NEEDED = 1.5  # s; of learning, before a rotor is named
WEAK = 0.035  # 1; a loss that is none any more
CERTAIN = 2.5  # 1; standard deviations that a healthy rotor may be off
SHOWN, RECOVERED = 0.1, 0.5  # s; for how long a rotor has looked healthy that is recovering; that is healthy
NEW = 0.1  # s; age of a fault up to which its size is still being found
OFF = 0.9  # 1; loss of a rotor that is off
FLYING = 0.3  # 1; share of the weight that the rotors carry in flight, at least
DOUBTED = 0.2  # 1; pace of learning while a rotor is suspect
LOSS, STOPPED, STUCK = (FAULT_KINDS.index(name) for name in ("loss", "off", "stuck"))


class RotorMonitor(NamedTuple):
    """What is known of the rotors."""

    residuals: Residuals
    losses: Losses
    following: Following | None  # None: speeds are not measured
    rate: Vector  # of the last sample that was used [rad/s]
    thrusts: Array  # of the last sample (..., n)
    fresh: Flag  # there is such a sample just before
    blamed: Array  # for how long each rotor has been blamed (..., n) [s]
    suspected: Array  # for how long it has been suspect [s]
    named: Array  # by gyro and accelerometer
    age: Array  # of the fault of each rotor that is named, by whatever (..., n) [s]; 0: none
    calm: Array  # for how long it has looked healthy [s]
    ambiguous: Array  # another rotor explained it as well when it was named
    likely: Array  # l of the last sample (..., n)
    unsure: Array  # its thrust may be changing: suspect, just named, unlike its loss or command


class RotorInputs(NamedTuple):
    """What is seen at a sample."""

    thrusts: Array  # of n healthy rotors at these speeds, or at lagged commands (..., n), in the model's unit
    rate: Vector  # of the gyro, less its known bias [rad/s]
    force: Scalar  # specific force along body z [m/s²]
    known: Vector  # angular acceleration of other known causes: the body's rotation, drag [rad/s²]
    usable: Flag  # gyro and accelerometer are there, and healthy
    wanted: Array | None = (
        None  # thrusts that the lagged commands ask for (..., n); None: no speeds are measured
    )


def start_rotors(effects: Effects, inputs: RotorInputs) -> RotorMonitor:
    """Start at a sample."""
    thrusts = inputs.thrusts
    zeros = 0.0 * thrusts
    no = zeros > 1.0
    return RotorMonitor(
        evidence.start_residuals(effects, thrusts),
        losses.start_losses(thrusts),
        None if inputs.wanted is None else following.start_following(thrusts),
        inputs.rate,
        thrusts,
        inputs.usable & inputs.usable,
        *(zeros, zeros, no, zeros, zeros, no, zeros, no),
    )


def step_rotors(state: RotorMonitor, effects: Effects, inputs: RotorInputs, dt: float) -> RotorMonitor:
    """Advance by ``dt`` [s] to a sample."""
    xp, thrusts = namespace(inputs.thrusts), inputs.thrusts
    used = inputs.usable & state.fresh & _carried(effects, thrusts)
    residual = _residual(state, effects, inputs, used, dt)
    seen = evidence.average(state.residuals, residual, thrusts, state.losses.mean, dt)
    unsure = changed_where(state.named, lambda: losses.std_dev_of(state.losses), state.losses.mean)
    judged = evidence.judge(seen, effects, state.named, unsure, inputs.wanted is not None)
    suspect, named = judged.evidence.suspect, state.named
    busy = suspect | named | (state.suspected > 0.0) | state.unsure

    def doubt() -> Array:
        return used * ~named.any(axis=-1) * (1.0 - (1.0 - DOUBTED) * suspect.any(axis=-1))

    calm = changed_where(busy, doubt, 1.0 * used)
    state = state._replace(
        residuals=evidence.learn(seen, effects, judged.deviation, calm, dt),
        rate=xp.where(inputs.usable[..., None], inputs.rate, state.rate),
        thrusts=thrusts,
        fresh=inputs.usable & inputs.usable,
        likely=judged.evidence.likely,
    )
    state = changed_where(busy, lambda: _decide(state, effects, judged, used, dt), state)
    if inputs.wanted is not None and state.following is not None:
        state = _compare(state, state.following, effects, inputs.wanted, thrusts, dt)
    return state


def _decide(state: RotorMonitor, effects: Effects, judged: Judged, used: Flag, dt: float) -> RotorMonitor:
    """Name rotors by the evidence, and follow those that are named."""
    found, ready = judged.evidence, (used & (state.residuals.learned > NEEDED))[..., None]
    suspected = (state.suspected + dt) * (found.suspect & ready)
    blamed = (state.blamed + dt) * (found.alarm & ready)
    state = state._replace(suspected=suspected, blamed=blamed)
    new = (blamed > HOLD) & ~state.named
    state = changed_where(new, lambda: _name(state, new, found), state)
    none, seen = 0.0 * state.age, state.residuals
    change = changed_where(state.named, lambda: evidence.change_of(seen, effects, judged), none)
    state = changed_where(state.named, lambda: _follow(state, effects, change, used, dt), state)
    changing = state.named & ((state.age < NEW) | (change > losses.JUMPED))
    return state._replace(unsure=(suspected > 0.0) | changing)


def estimate_rotors(state: RotorMonitor) -> RotorEstimate:
    """Say what is known of each rotor."""
    xp, followed, named = namespace(state.age), state.following, state.named
    faulty = named if followed is None else named | followed.faulty
    learned: Any = state.residuals.learned
    suspect, starting = state.suspected > 0.0, (learned <= NEEDED)[..., None]
    none = 0.0 * state.age
    healthy = _known_estimate(len(state.age)) if is_single(state.age) else _healthy_estimate(none)

    def unsettled() -> RotorEstimate:
        states = xp.where(suspect, samples.SUSPECT, samples.HEALTHY)
        odds = clip(0.5 * (state.likely - evidence.ALARM), -30.0, 30.0)
        return healthy._replace(
            state=xp.where(starting, samples.STARTING, states).astype(xp.uint8),
            probability=suspect / (1.0 + xp.exp(-odds)),
        )

    healthy = changed_where(suspect | starting, unsettled, healthy)

    def untrusted() -> RotorEstimate:
        left = 1.0 - state.losses.mean
        kind = xp.where(left < 1.0 - OFF, STOPPED, LOSS)
        if followed is not None:
            # a rotor that keeps its speed gives what a healthy one does at this speed
            stopped = followed.share > OFF
            left = left * (1.0 - followed.share * (stopped | ~followed.still))
            stuck = xp.where(followed.still, STUCK, LOSS)
            kind = xp.where(followed.faulty, xp.where(stopped, STOPPED, stuck), kind)
        calm = state.calm if followed is None else xp.where(named, state.calm, followed.calm)
        shown = xp.where(calm > SHOWN, samples.RECOVERING, samples.FAULTY)
        return RotorEstimate(
            xp.where(faulty, shown, healthy.state).astype(xp.uint8),
            xp.where(faulty, left, 1.0),
            xp.where(faulty, losses.std_dev_of(state.losses), -1.0),
            xp.where(faulty, state.age, -1.0),
            xp.where(faulty, 1.0 - 0.5 * state.ambiguous, healthy.probability),
            (faulty * kind).astype(xp.uint8),
            faulty & state.ambiguous,
        )

    return changed_where(faulty, untrusted, healthy)


@functools.cache
def _known_estimate(rotors: int) -> RotorEstimate:
    """Return what is said of the healthy rotors of one vehicle; not to be written to."""
    estimate = _healthy_estimate(np.zeros(rotors))
    for column_of in estimate:
        column_of.setflags(write=False)
    return estimate


def _healthy_estimate(none: Array) -> RotorEstimate:
    """Return what is said of healthy rotors; ``none`` are zeros (..., n)."""
    xp, unknown = namespace(none), none - 1.0
    kind = none.astype(xp.uint8)
    return RotorEstimate(
        kind + np.uint8(samples.HEALTHY), none + 1.0, unknown, unknown, none, kind, none > 0.0
    )


def _carried(effects: Effects, thrusts: Array) -> Flag:
    """Whether the rotors carry the vehicle."""
    return thrusts.sum(axis=-1) > FLYING * thrusts.shape[-1] * effects.hover


def _residual(state: RotorMonitor, effects: Effects, inputs: RotorInputs, used: Flag, dt: float) -> Array:
    """Return r of a sample (..., 4); what explains nothing new where none is used."""
    xp = namespace(inputs.rate)
    now, mean = inputs.thrusts, 0.5 * (inputs.thrusts + state.thrusts)
    turned = (inputs.rate - state.rate) / larger(dt, 1e-6) - inputs.known
    turned = turned - (effects.rows[..., :3, :] @ mean[..., None])[..., 0]
    pushed = inputs.force - (effects.rows[..., 3, :] * now).sum(axis=-1)
    residual = xp.concatenate([turned, pushed[..., None]], axis=-1)

    def explained() -> Array:
        lost = (effects.rows @ (now * state.losses.mean)[..., None])[..., 0]
        return xp.where(used[..., None], residual, state.residuals.usual - lost)

    return changed_where(~used, explained, residual)


def _name(state: RotorMonitor, new: Array, found: Evidence) -> RotorMonitor:
    """Name rotors."""
    xp, n = namespace(state.age), new.shape[-1]
    age = xp.where(new, xp.maximum(state.suspected, state.blamed), state.age)
    opened = losses.open_losses(state.losses, new, found.loss)
    # the averages have seen the loss since its onset
    mean = state.residuals.mean
    seen = 1.0 - xp.exp(-(new * age)[..., None, :] / evidence.TIMES[:, None])
    known = mean[..., 4 + n :] + (new * opened.mean)[..., None, :] * seen * mean[..., 4 : 4 + n]
    residuals = state.residuals._replace(mean=xp.concatenate([mean[..., : 4 + n], known], axis=-1))
    return state._replace(
        residuals=residuals,
        losses=opened,
        named=state.named | new,
        age=age,
        calm=xp.where(new, 0.0, state.calm),
        ambiguous=(state.ambiguous & ~new) | (new & ~found.alone),
    )


def _follow(state: RotorMonitor, effects: Effects, change: Array, used: Flag, dt: float) -> RotorMonitor:
    """Estimate the losses of the rotors that are named, and acquit who has recovered."""
    xp, counts = namespace(state.age), state.named & used[..., None]
    lost = losses.correct_losses(state.losses, state.residuals, effects, counts, change, dt)
    small = xp.maximum(CERTAIN * losses.std_dev_of(lost), WEAK)
    calm = (state.calm + dt * counts) * (state.named & (lost.mean < small) & (small < 0.15))
    back = calm > RECOVERED
    lost = losses.close_losses(lost, back)
    still = state.named & ~back
    age = (state.age + dt) * still
    return state._replace(
        losses=lost, named=still, age=age, calm=calm * still, ambiguous=state.ambiguous & still
    )


def _compare(
    state: RotorMonitor, before: Following, effects: Effects, wanted: Array, thrusts: Array, dt: float
) -> RotorMonitor:
    """Name rotors that do not follow their commands, too."""
    followed = following.step_following(before, thrusts, wanted, effects.hover, dt)

    def follow() -> Array:
        new = followed.faulty & ~before.faulty & ~state.named
        age = state.age + dt * (followed.faulty & before.faulty & ~state.named) + new * followed.apart
        return age * (followed.faulty | state.named)

    age = changed_where(followed.faulty | before.faulty, follow, state.age)
    return state._replace(following=followed, age=age, unsure=state.unsure | (followed.apart > 0.0))
