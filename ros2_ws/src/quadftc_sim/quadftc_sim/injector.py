"""Fault injection: the step of a closed loop, for one vehicle or many, and the injector of one vehicle.

Both are made of the same laws, each of which can be compiled on its own:

    sample -> `Split` -> one `ChannelFault` after the other -> `Join` -> sample
    healthy rotors -> one `RotorsFault` after the other -> their condition

So a closed loop that runs `inject`, and a `FaultInjector`, whose injections come and go, give the same
numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Flag, Scalar, Vector, chosen, column, namespace, where
from quadftc_model.composition import Calls
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import ImuSample, RotorCondition, level_sample
from quadftc_model.stepper import Engine, NumpyRunner, Runner, seconds
from quadftc_sim.fault import FaultInputs
from quadftc_sim.injection import Injection, fault_generators
from quadftc_sim.rotor_fault import ROTOR, healthy_rotors, with_fault


class FaultDraws(NamedTuple):
    """Random numbers of one injection for one sample."""

    normal: Vector  # standard normal
    uniform: Vector  # in [0, 1)


class InjectionState(NamedTuple):
    """One injection at the last sample."""

    fault: object  # state of the fault
    begun: Flag  # it has been stepped


class Channel(NamedTuple):
    """One channel of a sample, with the faults so far."""

    value: Vector  # Euler angles [rad], body rate [rad/s] or specific force [m/s²]; of the whole IMU zeros
    valid: Flag  # it is there
    faulty: Flag  # a fault acts on it


class Channels(NamedTuple):
    """The channels of a sample that a fault can be on."""

    attitude: Channel
    gyro: Channel
    accelerometer: Channel
    imu: Channel  # all of it


class Faulty(NamedTuple):
    """A sample with its faults, and the truth about them; NaN where a channel is not a number."""

    sample: ImuSample
    present: Flag  # False: the sample is withheld
    attitude: Vector  # true fault of the attitude [rad]
    gyro: Vector  # [rad/s]
    accelerometer: Vector  # [m/s²]
    rotors: RotorCondition | None = None  # None: on the test stand


class ChannelInputs(NamedTuple):
    """What a fault sees of a sample."""

    channel: Channel
    time: Scalar  # scenario time of the sample [s]
    dt: float  # since the sample before [s]; 0 at the first of all, at which few faults begin
    draws: FaultDraws | None  # None: the fault is not random


class JoinInputs(NamedTuple):
    """A sample, its channels as they were, and as the faults have left them."""

    sample: ImuSample
    healthy: Channels
    channels: Channels


class RotorInputs(NamedTuple):
    """Condition of the rotors with the faults so far."""

    condition: RotorCondition
    time: Scalar  # scenario time [s]


@dataclasses.dataclass(frozen=True, eq=False)
class Split:
    """A sample as channels, of three numbers each."""

    def example(self) -> ImuSample:
        """Return inputs as at a first sample."""
        return level_sample()

    def init(self, inputs: ImuSample) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: tuple[()], inputs: ImuSample, dt: float) -> tuple[tuple[()], Channels]:
        """Return the channels of a sample."""
        rate, none = inputs.body_rate, inputs.rate_valid & False
        return state, Channels(
            Channel(euler_from_quaternion(inputs.q_xyzw), inputs.attitude_valid, none),
            Channel(rate, inputs.rate_valid, none),
            Channel(inputs.specific_force, inputs.force_valid, none),
            Channel(namespace(rate).zeros_like(rate), inputs.rate_valid | True, none),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class ChannelFault:
    """One fault on one channel, from its start to its stop, on the axes of its mask."""

    injection: Injection

    @property
    def named_after(self) -> object:
        """What it is called after where it is compiled."""
        return self.injection.law

    def example(self) -> ChannelInputs:
        """Return inputs as at a first sample."""
        _, channels = Split().step((), level_sample(), 0.0)
        draws = FaultDraws(np.zeros(3), np.zeros(3)) if self.injection.law.is_random else None
        return ChannelInputs(getattr(channels, self.injection.channel), 0.0, 0.0, draws)

    def init(self, inputs: ChannelInputs) -> InjectionState:
        """Return the state before the first sample."""
        channel = inputs.channel
        return InjectionState(self.injection.law.init(channel.value), channel.faulty & False)

    def step(self, state: InjectionState, inputs: ChannelInputs, dt: float) -> tuple[InjectionState, Channel]:
        """Put the fault on a sample; the time step is in the inputs, as a fault may begin in mid-flight."""
        injection, law = self.injection, self.injection.law
        healthy, valid, faulty = inputs.channel
        xp = namespace(healthy)
        zeros, time = xp.zeros_like(healthy), xp.asarray(inputs.time)
        acts = (injection.start <= time) & (time < injection.stop)
        # a fault with a memory, such as a delay, sees the samples before its onset too
        runs = acts | (time < injection.start) if law.has_memory else acts
        before = chosen(state.begun, state.fault, law.init(healthy))
        draws = inputs.draws or FaultDraws(zeros, zeros)
        after, output = law.step(before, FaultInputs(healthy, time - injection.start, *draws), inputs.dt)
        state = InjectionState(chosen(runs, after, before), state.begun | runs)
        value = where(column(acts) & injection.mask, output.value, healthy)
        return state, Channel(value, valid & (output.valid | ~acts), faulty | acts)


@dataclasses.dataclass(frozen=True, eq=False)
class Join:
    """Channels as a sample again, and the truth: what the faults have made of each."""

    def example(self) -> JoinInputs:
        """Return inputs as at a first sample."""
        _, channels = Split().step((), level_sample(), 0.0)
        return JoinInputs(level_sample(), channels, channels)

    def init(self, inputs: JoinInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: tuple[()], inputs: JoinInputs, dt: float) -> tuple[tuple[()], Faulty]:
        """Return the sample; an attitude without a fault is kept, as Euler angles would round it."""
        attitude, gyro, accelerometer, imu = inputs.channels
        fault, gyro_fault, accelerometer_fault = (
            where(column(now.faulty), now.value - before.value, 0.0)
            for now, before in zip(inputs.channels[:3], inputs.healthy[:3], strict=True)
        )
        turned = quaternion_from_euler(attitude.value)
        sample = ImuSample(
            where(column(attitude.faulty), turned, inputs.sample.q_xyzw),
            gyro.value,
            accelerometer.value,
            attitude.valid,
            gyro.valid,
            accelerometer.valid,
        )
        return state, Faulty(sample, imu.valid, wrap(fault), gyro_fault, accelerometer_fault)


@dataclasses.dataclass(frozen=True, eq=False)
class RotorsFault:
    """One fault on rotors, from its start to its stop."""

    injection: Injection

    @property
    def named_after(self) -> object:
        """What it is called after where it is compiled."""
        return self.injection.law

    def example(self) -> RotorInputs:
        """Return inputs as at a first sample."""
        return RotorInputs(healthy_rotors(np.zeros(len(self.injection.mask))), 0.0)

    def init(self, inputs: RotorInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: tuple[()], inputs: RotorInputs, dt: float) -> tuple[tuple[()], RotorCondition]:
        """Return the condition with the fault."""
        return state, with_fault(inputs.condition, self.injection, inputs.time)


def laws_of(injections: Sequence[Injection]) -> dict[str, Any]:
    """Return the laws of injections by name, for `begin` and `inject`."""
    found: dict[str, Any] = {}
    if any(each.channel != ROTOR for each in injections):
        found |= {"split": Split(), "join": Join()}
    for number, each in enumerate(injections, 1):
        found[f"fault{number}"] = RotorsFault(each) if each.channel == ROTOR else ChannelFault(each)
    return found


def begin(calls: Calls, injections: Sequence[Injection]) -> tuple[object, ...]:
    """Return states to begin with; the injections are those for the period, see `Injection.for_period`."""
    return tuple(calls.init(f"fault{number}") for number in range(1, len(injections) + 1))


def inject(
    calls: Calls,
    injections: Sequence[Injection],
    states: Sequence[object],
    sample: ImuSample,
    condition: RotorCondition | None,
    time: Scalar,
    dt: Any,
    draws: Sequence[FaultDraws | None],
) -> tuple[tuple[object, ...], Faulty]:
    """Put the faults on a sample at a scenario time [s] (...), ``dt`` [s] after the one before.

    The injections act in their order, on rotors in healthy ``condition`` too; on the test stand there are
    none. ``draws`` has None for faults that are not random.
    """
    healthy: Any = None
    if any(each.channel != ROTOR for each in injections):
        _, healthy = calls.step("split", (), sample, dt)
    channels, after = healthy, list[object]()
    for number, (injection, state, drawn) in enumerate(zip(injections, states, draws, strict=True), 1):
        name, channel = f"fault{number}", injection.channel
        if channel == ROTOR:
            assert condition is not None
            new, condition = calls.step(name, state, RotorInputs(condition, time), dt)
        else:
            seen = ChannelInputs(getattr(channels, channel), time, dt, drawn)
            new, made = calls.step(name, state, seen, dt)
            channels = channels._replace(**{channel: made})
        after.append(new)
    if channels is None:
        return tuple(after), without_faults(sample, condition)
    _, faulty = calls.step("join", (), JoinInputs(sample, healthy, channels), dt)
    return tuple(after), faulty._replace(rotors=condition)


def without_faults(sample: ImuSample, condition: RotorCondition | None) -> Faulty:
    """Return a sample as it is without faults on sensors."""
    zeros = np.zeros(3)
    return Faulty(sample, np.True_, zeros, zeros, zeros, condition)


@dataclasses.dataclass
class _Scheduled:
    """An injection with its state and random numbers of its own."""

    injection: Injection
    generators: tuple[np.random.Generator, np.random.Generator]  # normal, uniform
    runner: Runner[Any, Any]
    state: object = None
    first: ChannelInputs | None = None  # what it saw first; None: it has not run
    is_fixed: bool = False  # it is one for the period

    def draw(self) -> FaultDraws | None:
        """Return the random numbers of the next sample."""
        if not self.injection.law.is_random:
            return None
        normal, uniform = self.generators
        return FaultDraws(normal.standard_normal(3), uniform.random(3))

    def run(self, inputs: ChannelInputs, choose: Engine) -> Channel:
        """Put the fault on a channel.

        The first time step says the period. A fault that depends on it begins again at what it saw first.
        """
        if not self.is_fixed and inputs.dt > 0.0:
            self.is_fixed = True
            injection = self.injection.for_period(inputs.dt)
            if injection is not self.injection:
                self.injection, self.runner = injection, choose(ChannelFault(injection))
                if self.first is not None:
                    self.state, _ = self.runner.first(self.first)
        if self.first is None:
            self.first = inputs
            self.state, channel = self.runner.first(inputs)
        else:
            self.state, channel = self.runner.step(self.state, inputs, inputs.dt)
        return channel


class FaultInjector:
    """All faults of one vehicle: those scheduled from the start are numbered from 1.

    ``seed`` is that of the random faults (noise, spikes, dropout); ``rotors`` how many a vehicle in free
    flight has, 0 on the test stand.

    ``engine`` says what runs the laws. One that would have to compile a law first (its ``is_ready`` says so)
    does that for the faults scheduled from the start. One that comes later must not wait: it runs in NumPy.
    So does a delay, of which the first two samples say how many samples it has; it only moves numbers.
    """

    def __init__(
        self,
        seed: int = 0,
        injections: Iterable[Injection] = (),
        rotors: int = 0,
        engine: Engine = NumpyRunner,
    ) -> None:
        self._seed, self._engine = seed, engine
        self._scheduled: dict[int, _Scheduled] = {}
        self._count = 0
        self._epoch_ns: int | None = None
        self._stamp_ns = 0
        self._healthy = healthy_rotors(np.zeros(rotors)) if rotors else None
        self._split, self._join = engine(Split()), engine(Join())
        for injection in injections:
            self._schedule(injection, engine)

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
    def begun(self) -> bool:
        """Whether there has been a sample."""
        return self._epoch_ns is not None

    @property
    def now(self) -> float:
        """Scenario time of the last sample [s]; 0 before the first."""
        return 0.0 if self._epoch_ns is None else seconds(self._stamp_ns - self._epoch_ns)

    def add(self, injection: Injection) -> int:
        """Schedule an injection; return its number."""
        return self._schedule(injection, self._choose)

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
        running = [
            each
            for each in self._scheduled.values()
            if each.injection.start <= time or each.injection.law.has_memory
        ]
        on_sensors, condition = list[_Scheduled](), self._healthy
        for each in running:
            if each.injection.channel != ROTOR:
                on_sensors.append(each)
            elif condition is not None:
                _, condition = each.runner.step((), RotorInputs(condition, time), dt)
        if not on_sensors:  # mostly
            return without_faults(sample, condition)
        _, healthy = self._split.step((), sample, dt)
        channels = healthy
        for each in on_sensors:
            name = each.injection.channel
            inputs = ChannelInputs(getattr(channels, name), time, dt, each.draw())
            channels = channels._replace(**{name: each.run(inputs, self._choose)})
        _, faulty = self._join.step((), JoinInputs(sample, healthy, channels), dt)
        return faulty._replace(rotors=condition)

    def _schedule(self, injection: Injection, choose: Engine) -> int:
        self._count += 1
        if injection.channel == ROTOR:
            self._healthy = healthy_rotors(np.zeros(len(injection.mask)))
        runner = choose(RotorsFault(injection) if injection.channel == ROTOR else ChannelFault(injection))
        generators = fault_generators(self._seed, self._count)
        self._scheduled[self._count] = _Scheduled(injection, generators, runner)
        return self._count

    def _choose(self, law: Any) -> Runner[Any, Any]:
        """Return what runs a law from now on, without having to wait."""
        is_ready = getattr(self._engine, "is_ready", None)
        waits = is_ready is not None and not is_ready(law, law.example())
        return NumpyRunner(law) if waits else self._engine(law)
