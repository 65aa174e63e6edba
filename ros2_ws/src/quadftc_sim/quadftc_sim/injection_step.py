"""Fault injection as a pure step with explicit state, for one vehicle or many flights at once.

`quadftc_sim.injector.FaultInjector` runs it for one vehicle whose injections come and go.
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
    """A sample with its faults, and the truth about them; NaN where a channel is not a number."""

    sample: ImuSample
    present: Array  # (...,) bool; False: the sample is withheld
    attitude: Array  # (..., 3) true fault of the attitude [rad]
    gyro: Array  # (..., 3) [rad/s]
    accelerometer: Array  # (..., 3) [m/s²]


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
        They act in their order.
    sample : ImuSample
    time, dt : array (...,), float
        Scenario time and time since the sample before [s].
    draws : sequence
        One for each injection; None for faults that are not random.
    """
    xp = namespace(sample.q_xyzw)
    angles = euler_from_quaternion(sample.q_xyzw)
    values = {
        "attitude": angles,
        "gyro": sample.body_rate,
        "accelerometer": sample.specific_force,
        "imu": xp.zeros_like(sample.body_rate),
    }
    there = {
        "attitude": sample.attitude_valid,
        "gyro": sample.rate_valid,
        "accelerometer": sample.force_valid,
        "imu": xp.ones_like(sample.rate_valid),
    }
    turned = xp.zeros_like(sample.attitude_valid)  # whether a fault acts on the attitude
    time = xp.asarray(time)
    new_states: list[InjectionState] = []
    for injection, state, draw in zip(injections, states, draws, strict=True):
        channel = injection.channel
        healthy = values[channel]
        zeros = xp.zeros_like(healthy)
        inputs = FaultInputs(healthy, time - injection.start, *(draw or (zeros, zeros)))
        acts = (injection.start <= time) & (time < injection.stop)
        # A fault with a memory, such as a delay, sees the samples before its onset too.
        runs = acts | (time < injection.start) if injection.law.has_memory else acts
        before = chosen(state.begun, state.fault, injection.law.init(healthy))
        after, output = injection.law.step(before, inputs, dt)
        new_states.append(InjectionState(chosen(runs, after, before), state.begun | runs))
        values[channel] = xp.where(acts[..., None] & injection.mask, output.value, healthy)
        there[channel] = there[channel] & (output.valid | ~acts)
        turned = turned | acts if channel == "attitude" else turned
    # An attitude without a fault is kept as it is: a detour by Euler angles would round it.
    faulty = ImuSample(
        xp.where(turned[..., None], quaternion_from_euler(values["attitude"]), sample.q_xyzw),
        values["gyro"],
        values["accelerometer"],
        there["attitude"],
        there["gyro"],
        there["accelerometer"],
    )
    return tuple(new_states), Faulty(
        faulty,
        there["imu"],
        xp.where(turned[..., None], wrap(values["attitude"] - angles), 0.0),
        values["gyro"] - sample.body_rate,
        values["accelerometer"] - sample.specific_force,
    )


def _healthy(channel: str, sample: ImuSample) -> Array:
    if channel == "gyro":
        return sample.body_rate
    if channel == "accelerometer":
        return sample.specific_force
    if channel == "imu":
        return namespace(sample.body_rate).zeros_like(sample.body_rate)
    return euler_from_quaternion(sample.q_xyzw)
