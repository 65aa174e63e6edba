"""Fault injection as a pure step with explicit state, for many flights at once.

The same faults act in the same order as in :class:`quadftc_sim.injection.FaultInjector`, which serves one
vehicle, takes injections at run time and leaves out what does not act now.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from quadftc_model.arrays import Array, chosen, namespace
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import ImuSample
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection


class FaultDraws(NamedTuple):
    """Random numbers of one injection for one sample."""

    normal: Array  # (..., 3) standard normal
    uniform: Array  # (..., 3) in [0, 1)


class InjectionState(NamedTuple):
    """One injection at the last sample."""

    fault: Any  # state of the fault
    begun: Array  # (...,) bool: it has been stepped


class Faulty(NamedTuple):
    """A sample with its faults."""

    sample: ImuSample
    attitude: Array  # (..., 3) true fault of the attitude [rad]; NaN where the channel is no number


def begin(injections: Sequence[Injection], sample: ImuSample) -> tuple[InjectionState, ...]:
    """State before the first sample."""
    nothing = namespace(sample.q_xyzw).zeros_like(sample.attitude_valid)
    return tuple(
        InjectionState(injection.law.init(_healthy(injection.channel, sample)), nothing)
        for injection in injections
    )


def inject(
    injections: Sequence[Injection],
    states: Sequence[InjectionState],
    sample: ImuSample,
    time: Array,
    dt: float,
    draws: Sequence[FaultDraws | None],
) -> tuple[tuple[InjectionState, ...], Faulty]:
    """Put the faults on a sample.

    Parameters
    ----------
    injections, states : sequences
        Injections on the channel ``imu`` are left out: whether a sample is withheld depends on no flight.
    sample : ImuSample
    time, dt : array (...,), float
        Scenario time and time since the sample before [s].
    draws : sequence
        One for each injection; None for faults that are not random.
    """
    xp = namespace(sample.q_xyzw)
    angles = euler_from_quaternion(sample.q_xyzw)
    values = {"attitude": angles, "gyro": sample.body_rate, "accelerometer": sample.specific_force}
    there = {
        "attitude": sample.attitude_valid,
        "gyro": sample.rate_valid,
        "accelerometer": sample.force_valid,
    }
    turned = xp.zeros_like(sample.attitude_valid)
    new_states: list[InjectionState] = []
    for injection, state, draw in zip(injections, states, draws, strict=True):
        channel = injection.channel
        if channel == "imu":
            new_states.append(state)
            continue
        healthy = values[channel]
        zeros = xp.zeros_like(healthy)
        inputs = FaultInputs(healthy, time - injection.start, *(draw or (zeros, zeros)))
        acts = (injection.start <= time) & (time < injection.stop)
        runs = acts | (time < injection.start) if injection.law.has_memory else acts
        before = chosen(state.begun, state.fault, injection.law.init(healthy))
        after, output = injection.law.step(before, inputs, dt)
        new_states.append(InjectionState(chosen(runs, after, before), state.begun | runs))
        values[channel] = xp.where(acts[..., None] & injection.mask, output.value, healthy)
        there[channel] = there[channel] & (output.valid | ~acts)
        turned = turned | acts if channel == "attitude" else turned
    faulty = ImuSample(
        xp.where(turned[..., None], quaternion_from_euler(values["attitude"]), sample.q_xyzw),
        values["gyro"],
        values["accelerometer"],
        there["attitude"],
        there["gyro"],
        there["accelerometer"],
    )
    fault = xp.where(turned[..., None], wrap(values["attitude"] - angles), 0.0)
    return tuple(new_states), Faulty(faulty, fault)


def _healthy(channel: str, sample: ImuSample) -> Array:
    if channel == "gyro":
        return sample.body_rate
    if channel == "accelerometer":
        return sample.specific_force
    return euler_from_quaternion(sample.q_xyzw)
