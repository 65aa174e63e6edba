"""Fault injection: a pure step for one vehicle or many flights at once, and the injector of one vehicle.

The batch engine runs the step; `FaultInjector` runs it for a vehicle whose injections come and go.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Flag, Scalar, Vector, chosen, is_single, namespace
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import ImuSample, RotorCondition
from quadftc_model.stepper import seconds
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.rotor_fault import ROTOR, rotor_condition


class FaultDraws(NamedTuple):
    """Random numbers of one injection for one sample."""

    normal: Vector  # standard normal
    uniform: Vector  # in [0, 1)


class InjectionState(NamedTuple):
    """One injection at the last sample."""

    fault: Any  # state of the fault
    begun: Flag  # it has been stepped


class Faulty(NamedTuple):
    """A sample with its faults, and the truth about them; NaN where a channel is not a number."""

    sample: ImuSample
    present: Flag  # False: the sample is withheld
    attitude: Vector  # true fault of the attitude [rad]
    gyro: Vector  # [rad/s]
    accelerometer: Vector  # [m/s²]
    rotors: RotorCondition | None = None  # None: all are healthy, and always were


def begin(injections: Sequence[Injection], sample: ImuSample) -> tuple[InjectionState, ...]:
    """State before the first sample."""
    nothing, values = namespace(sample.q_xyzw).zeros_like(sample.attitude_valid), _channels(sample)
    return tuple(
        InjectionState(() if each.channel == ROTOR else each.law.init(values[each.channel]), nothing)
        for each in injections
    )


def inject(
    injections: Sequence[Injection],
    states: Sequence[InjectionState],
    sample: ImuSample,
    time: Scalar,
    dt: float,
    draws: Sequence[FaultDraws | None],
) -> tuple[tuple[InjectionState, ...], Faulty]:
    """Put the faults on a sample at a scenario time [s] (...,), ``dt`` [s] after the one before.

    The injections act in their order; ``draws`` has None for faults that are not random. Those on rotors
    only give the condition of the rotors.
    """
    xp = namespace(sample.q_xyzw)
    values, time = _channels(sample), xp.asarray(time)[()]
    angles, zeros = values["attitude"], values["imu"]
    there = {
        "attitude": sample.attitude_valid,
        "gyro": sample.rate_valid,
        "accelerometer": sample.force_valid,
        "imu": sample.rate_valid | True,
    }
    turned: Flag | None = None  # whether a fault acts on the attitude; None: none ever does
    new_states: list[InjectionState] = []
    for injection, state, draw in zip(injections, states, draws, strict=True):
        channel = injection.channel
        if channel == ROTOR:
            new_states.append(state)
            continue
        healthy = values[channel]
        inputs = FaultInputs(healthy, time - injection.start, *(draw or (zeros, zeros)))
        acts: Any = (injection.start <= time) & (time < injection.stop)
        # A fault with a memory, such as a delay, sees the samples before its onset too.
        runs = acts | (time < injection.start) if injection.law.has_memory else acts
        before = chosen(state.begun, state.fault, injection.law.init(healthy))
        after, output = injection.law.step(before, inputs, dt)
        new_states.append(InjectionState(chosen(runs, after, before), state.begun | runs))
        values[channel] = chosen(acts, xp.where(injection.mask, output.value, healthy), healthy)
        there[channel] = there[channel] & (output.valid | ~acts)
        if channel == "attitude":
            turned = acts if turned is None else turned | acts
    attitude, gyro, force, _ = values.values()
    *valid, present = there.values()
    q_xyzw, fault = sample.q_xyzw, zeros
    if turned is not None:  # an attitude without a fault is kept: a detour by Euler angles would round it
        q_xyzw = chosen(turned, quaternion_from_euler(attitude), q_xyzw)
        fault = chosen(turned, wrap(attitude - angles), zeros)
    truth = (fault, gyro - sample.body_rate, force - sample.specific_force)
    faulty = ImuSample(q_xyzw, gyro, force, *valid)
    return tuple(new_states), Faulty(faulty, present, *truth, condition_of_rotors(injections, time))


def condition_of_rotors(injections: Iterable[Injection], time: Scalar) -> RotorCondition | None:
    """Return the condition of the rotors at a scenario time [s] (...); None without faults on rotors."""
    on_rotors = [each for each in injections if each.channel == ROTOR]
    return rotor_condition(on_rotors, on_rotors[0].mask.shape[-1], time) if on_rotors else None


def _channels(sample: ImuSample) -> dict[str, Array]:
    """Return the three numbers of each channel (..., 3)."""
    rate = sample.body_rate
    return {
        "attitude": euler_from_quaternion(sample.q_xyzw),
        "gyro": rate,
        "accelerometer": sample.specific_force,
        "imu": np.zeros(3) if is_single(rate) else namespace(rate).zeros_like(rate),
    }


@dataclasses.dataclass
class _Scheduled:
    """An injection with its state and random numbers of its own."""

    injection: Injection
    generators: tuple[np.random.Generator, np.random.Generator]  # normal, uniform
    state: InjectionState | None = None

    def draw(self) -> FaultDraws | None:
        """Return the random numbers of the next sample."""
        if not self.injection.law.is_random:
            return None
        normal, uniform = self.generators
        return FaultDraws(normal.standard_normal(3), uniform.random(3))


class FaultInjector:
    """All faults of one vehicle: those scheduled from the start are numbered from 1.

    ``seed`` is that of the random faults (noise, spikes, dropout).
    """

    def __init__(self, seed: int = 0, injections: Iterable[Injection] = ()) -> None:
        self._seed = seed
        self._scheduled: dict[int, _Scheduled] = {}
        self._count = 0
        self._epoch_ns: int | None = None
        self._stamp_ns = 0
        self._rotors = 0  # of a vehicle that has had a fault on a rotor
        for injection in injections:
            self.add(injection)

    @property
    def injections(self) -> dict[int, Injection]:
        """The injections that wait or act, by number."""
        return {number: each.injection for number, each in self._scheduled.items()}

    @property
    def active(self) -> dict[int, Injection]:
        """The injections that act on the present sample, by number."""
        now = self.now
        return {number: injection for number, injection in self.injections.items() if injection.start <= now}

    @property
    def now(self) -> float:
        """Scenario time of the last sample [s]; 0 before the first."""
        return 0.0 if self._epoch_ns is None else seconds(self._stamp_ns - self._epoch_ns)

    def add(self, injection: Injection) -> int:
        """Schedule an injection; return its number."""
        self._count += 1
        if injection.channel == ROTOR:
            self._rotors = len(injection.mask)
        self._scheduled[self._count] = _Scheduled(injection, fault_generators(self._seed, self._count))
        return self._count

    def clear(self, number: int = 0) -> int:
        """End one injection, or all (0); return how many ended."""
        before = len(self._scheduled)
        self._scheduled = {known: each for known, each in self._scheduled.items() if number not in (0, known)}
        return before - len(self._scheduled)

    def apply(self, stamp_ns: int, sample: ImuSample) -> Faulty:
        """Put the faults on the sample of a stamp [ns]; the first sample's is scenario time 0."""
        if self._epoch_ns is None:
            self._epoch_ns = self._stamp_ns = stamp_ns
        dt = seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        time = self.now
        self._scheduled = {n: each for n, each in self._scheduled.items() if time < each.injection.stop}
        scheduled = [(each, each.injection) for each in self._scheduled.values()]
        on_rotors = [fault for _, fault in scheduled if fault.channel == ROTOR]
        rotors = rotor_condition(on_rotors, self._rotors, time) if self._rotors else None
        running = [
            each
            for each, fault in scheduled
            if fault.channel != ROTOR and (fault.start <= time or fault.law.has_memory)
        ]
        if not running:  # mostly; the step costs as much as an observer
            zeros = np.zeros(3)
            return Faulty(sample, np.bool_(True), zeros, zeros, zeros, rotors)
        injections = [each.injection for each in running]
        states = [each.state or begin([each.injection], sample)[0] for each in running]
        after, faulty = inject(injections, states, sample, time, dt, [each.draw() for each in running])
        for each, state in zip(running, after, strict=True):
            each.state = state
        return faulty._replace(rotors=rotors)
