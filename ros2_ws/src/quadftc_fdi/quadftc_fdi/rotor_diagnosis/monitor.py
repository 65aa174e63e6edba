r"""Which rotor is weak, and by how much: one step of the diagnosis of all rotors.

1. Average the residual of gyro and accelerometer against the rotors' thrust, and judge it (`evidence`). Where
   the gyro is not believed, a rate by attitude and torque stands in, as far as it is known.
2. A rotor that is blamed for `HOLD` is named. Its loss is estimated from then on (`losses`).
3. Where speeds are measured: a rotor that does not follow its command is named, too (`following`).
4. One that others explain as well is named, but ambiguous: later residuals say whether it is another one.
5. A named rotor is healthy again once its loss has been small, and it has followed, for `RECOVERED`.

The means and variances that residuals are judged by are learned while no rotor is named. So what is constant
from the start is no fault: a centre of mass that is off, a wrong inertia, a rotor that was always weak.
"""

from __future__ import annotations

from typing import NamedTuple

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
    branch,
    chosen,
    clip,
    column,
    exp,
    larger,
    namespace,
    stacked,
    where,
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
    following: Following  # as far as speeds are measured
    rate: Vector  # of the last sample [rad/s]
    thrusts: Array  # of the last sample (..., n)
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
    rate: Vector  # of the gyro, less its known bias; where it is not believed, of attitude and torque [rad/s]
    vague: Vector  # variance of the latter [rad²/s²]; 0 where the gyro is believed
    force: Scalar  # specific force along body z [m/s²]
    known: Vector  # angular acceleration of other known causes: the body's rotation, drag [rad/s²]
    deaf: Flag  # the accelerometer is absent or faulty, and says nothing
    wanted: Array  # thrusts that the lagged commands ask for (..., n)
    measured: Flag  # the thrusts are those of measured speeds


def start_rotors(effects: Effects, inputs: RotorInputs) -> RotorMonitor:
    """Start at a sample."""
    thrusts = inputs.thrusts
    zeros = namespace(thrusts).zeros_like(thrusts)
    no = zeros > 1.0
    return RotorMonitor(
        evidence.start_residuals(effects, thrusts),
        losses.start_losses(thrusts),
        following.start_following(thrusts),
        inputs.rate,
        thrusts,
        *(zeros, zeros, no, zeros, zeros, no, zeros, no),
    )


def step_rotors(state: RotorMonitor, effects: Effects, inputs: RotorInputs, dt: Scalar) -> RotorMonitor:
    """Advance by ``dt`` [s] to a sample."""
    thrusts, named = inputs.thrusts, state.named
    used = _carried(effects, thrusts)
    residual = _residual(state, effects, inputs, used, dt)
    seen = evidence.average(state.residuals, residual, thrusts, state.losses.mean, inputs.vague, dt)
    unheard, std_dev = evidence.unheard(seen, inputs.vague, inputs.deaf), losses.std_dev_of(state.losses)
    others = std_dev, unheard, inputs.measured
    judged = evidence.judge(seen, effects, named, named & ~named, *others)
    # who else may it be that is ambiguous?
    again = branch(
        state.ambiguous.any(axis=-1),
        lambda: evidence.judge(seen, effects, named & ~state.ambiguous, state.ambiguous, *others).evidence,
        lambda: judged.evidence,
    )
    suspect = judged.evidence.suspect
    busy = suspect | named | (state.suspected > 0.0) | state.unsure
    heard = ~(inputs.vague > 0.0).any(axis=-1) & ~inputs.deaf
    calm = used * ~named.any(axis=-1) * heard * where(suspect.any(axis=-1), DOUBTED, 1.0)
    state = state._replace(
        residuals=evidence.learn(seen, effects, judged.deviation, calm, dt),
        rate=inputs.rate,
        thrusts=thrusts,
        likely=judged.evidence.likely,
    )
    state = branch(
        busy.any(axis=-1), lambda: _decide(state, effects, judged, again, used, unheard, dt), lambda: state
    )
    return chosen(inputs.measured, _compare(state, effects, inputs.wanted, thrusts, dt), state)


def _decide(
    state: RotorMonitor,
    effects: Effects,
    judged: Judged,
    again: Evidence,
    used: Flag,
    unheard: Array,
    dt: Scalar,
) -> RotorMonitor:
    """Name rotors by the evidence, and follow those that are named.

    ``again`` is the evidence where ambiguous losses are not taken out.
    """
    found, ready = judged.evidence, column(used & (state.residuals.learned > NEEDED))
    suspected = (state.suspected + dt) * (found.suspect & ready)
    rival = column(state.ambiguous.any(axis=-1)) & again.alone & ~state.named
    blamed = (state.blamed + dt) * ((found.alarm | rival) & ready)
    replaced = state.ambiguous & column((rival & (blamed > HOLD)).any(axis=-1))
    state = _withdraw(state._replace(suspected=suspected, blamed=blamed), replaced)
    found = found._replace(loss=where(rival, again.loss, found.loss), alone=found.alone | rival)
    state = _name(state, (blamed > HOLD) & ~state.named, found)
    state = state._replace(ambiguous=state.ambiguous & ~(again.alone & ready))
    change = evidence.change_of(state.residuals, effects, judged)
    state = _follow(state, effects, change, used, unheard, dt)
    changing = state.named & ((state.age < NEW) | (change > losses.JUMPED))
    return state._replace(unsure=(suspected > 0.0) | changing)


def estimate_rotors(state: RotorMonitor) -> RotorEstimate:
    """Say what is known of each rotor."""
    xp, followed, named = namespace(state.age), state.following, state.named
    faulty, suspect = named | followed.faulty, state.suspected > 0.0
    # healthy ones
    starting = column(state.residuals.learned <= NEEDED)
    trusted = where(starting, samples.STARTING, where(suspect, samples.SUSPECT, samples.HEALTHY))
    odds = clip(0.5 * (state.likely - evidence.ALARM), -30.0, 30.0)
    likely = where(suspect, 1.0 / (1.0 + exp(-odds)), 0.0)
    # faulty ones; a rotor that keeps its speed gives what a healthy one does at this speed
    left = 1.0 - state.losses.mean
    kind = where(left < 1.0 - OFF, STOPPED, LOSS)
    stopped = followed.share > OFF
    left = left * (1.0 - followed.share * (stopped | ~followed.still))
    kind = where(followed.faulty, where(stopped, STOPPED, where(followed.still, STUCK, LOSS)), kind)
    shown = where(named, state.calm, followed.calm) > SHOWN
    distrusted = where(shown, samples.RECOVERING, samples.FAULTY)
    return RotorEstimate(
        where(faulty, distrusted, trusted).astype(xp.uint8),
        where(faulty, left, 1.0),
        where(faulty, losses.std_dev_of(state.losses), -1.0),
        where(faulty, state.age, -1.0),
        where(faulty, 1.0 - 0.5 * state.ambiguous, likely),
        where(faulty, kind, 0).astype(xp.uint8),
        faulty & state.ambiguous,
    )


def _carried(effects: Effects, thrusts: Array) -> Flag:
    """Whether the rotors carry the vehicle."""
    return thrusts.sum(axis=-1) > FLYING * thrusts.shape[-1] * effects.hover


def _residual(state: RotorMonitor, effects: Effects, inputs: RotorInputs, used: Flag, dt: Scalar) -> Array:
    """Return r of a sample (..., 4); what explains nothing new where none is used."""
    now, mean = inputs.thrusts, 0.5 * (inputs.thrusts + state.thrusts)
    turned = (inputs.rate - state.rate) / larger(dt, 1e-6) - inputs.known - mean @ effects.columns[:, :3]
    pushed = column(inputs.force) - now @ effects.columns[:, 3:]
    residual = namespace(turned).concatenate([turned, pushed], axis=-1)
    lost = (now * state.losses.mean) @ effects.columns
    deaf = stacked([inputs.deaf & ~inputs.deaf] * 3 + [inputs.deaf])
    return where(column(used) & ~deaf, residual, state.residuals.usual - lost)


def _withdraw(state: RotorMonitor, wrong: Array) -> RotorMonitor:
    """Take back names."""
    n, mean = wrong.shape[-1], state.residuals.mean
    known = where(wrong[..., None, :], 0.0, mean[..., 4 + n :])
    mean = namespace(mean).concatenate([mean[..., : 4 + n], known], axis=-1)
    return state._replace(
        residuals=state.residuals._replace(mean=mean),
        losses=losses.close_losses(state.losses, wrong),
        named=state.named & ~wrong,
        blamed=where(wrong, 0.0, state.blamed),
        ambiguous=state.ambiguous & ~wrong,
    )


def _name(state: RotorMonitor, new: Array, found: Evidence) -> RotorMonitor:
    """Name rotors."""
    n, mean = new.shape[-1], state.residuals.mean
    age = where(new, larger(state.suspected, state.blamed), state.age)
    opened = losses.open_losses(state.losses, new, found.loss)
    # the averages have seen the loss since its onset
    seen = 1.0 - exp(-(new * age)[..., None, :] / evidence.TIMES[:, None])
    known = mean[..., 4 + n :] + (new * opened.mean)[..., None, :] * seen * mean[..., 4 : 4 + n]
    mean = namespace(mean).concatenate([mean[..., : 4 + n], known], axis=-1)
    return state._replace(
        residuals=state.residuals._replace(mean=mean),
        losses=opened,
        named=state.named | new,
        age=age,
        calm=where(new, 0.0, state.calm),
        ambiguous=(state.ambiguous & ~new) | (new & ~found.alone),
    )


def _follow(
    state: RotorMonitor, effects: Effects, change: Array, used: Flag, unheard: Array, dt: Scalar
) -> RotorMonitor:
    """Estimate the losses of the rotors that are named, and acquit who has recovered."""
    counts = state.named & column(used)
    lost = losses.correct_losses(state.losses, state.residuals, effects, counts, change, unheard, dt)
    small = larger(CERTAIN * losses.std_dev_of(lost), WEAK)
    calm = (state.calm + dt * counts) * (state.named & (lost.mean < small) & (small < 0.15))
    back = calm > RECOVERED
    lost = losses.close_losses(lost, back)
    still = state.named & ~back
    age = where(state.named, (state.age + dt) * still, state.age)
    return state._replace(
        losses=lost, named=still, age=age, calm=calm * still, ambiguous=state.ambiguous & still
    )


def _compare(
    state: RotorMonitor, effects: Effects, wanted: Array, thrusts: Array, dt: Scalar
) -> RotorMonitor:
    """Name rotors that do not follow their commands, too."""
    before = state.following
    followed = following.step_following(before, thrusts, wanted, effects.hover, dt)
    new = followed.faulty & ~before.faulty & ~state.named
    age = state.age + dt * (followed.faulty & before.faulty & ~state.named) + new * followed.apart
    age = age * (followed.faulty | state.named)
    return state._replace(following=followed, age=age, unsure=state.unsure | (followed.apart > 0.0))
