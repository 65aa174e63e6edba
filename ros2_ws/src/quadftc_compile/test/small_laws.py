"""Laws to be compiled in tests."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Components, Flag, Scalar, Vector, branch, exp, namespace, where
from quadftc_model.numbers import prepared
from quadftc_model.parameters import Checked, parameter


class Inputs(NamedTuple):
    """What a law sees."""

    value: Vector  # [rad]
    there: Flag  # it was measured


class State(NamedTuple):
    """What a law remembers."""

    mean: Vector  # [rad]
    count: Scalar  # samples that were there


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LowPass(Checked):
    """A low-pass filter of what is there."""

    time: float = parameter(0.5, unit="s", low=1e-3, doc="time constant")
    gain: tuple[float, ...] = parameter((1.0, 2.0, 3.0), doc="of each axis")
    order: int = parameter(1, low=1, high=4, doc="filters in a row, all alike")

    @prepared
    def product(self) -> float:
        """Product of the gains [1]."""
        return float(np.prod(self.gain))

    def example(self) -> Inputs:
        """Return inputs as it takes them."""
        return Inputs(np.zeros(3), np.bool_(True))

    def init(self, inputs: Inputs) -> State:
        """Start at the value."""
        return State(inputs.value, namespace(inputs.value).zeros_like(inputs.value[..., 0]))

    def resumed(self, inputs: Inputs, words: Vector) -> State:
        """Start at a mean that is known."""
        return self.init(inputs)._replace(mean=words)

    def step(self, state: State, inputs: Inputs, dt: Scalar) -> tuple[State, Vector]:
        """Follow the value."""
        xp = namespace(inputs.value)
        share = 1.0 - exp(-dt / self.time)
        mean = state.mean
        for _ in range(self.order):
            mean = mean + share * (inputs.value - mean)
        mean = where(inputs.there[..., None], mean, state.mean)
        count = branch(inputs.there, lambda: state.count + 1.0, lambda: state.count)
        return State(mean, count), self.product * xp.asarray(self.gain) * mean


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Branching(LowPass):
    """A law that branches on data."""

    def step(self, state: State, inputs: Inputs, dt: Scalar) -> tuple[State, Vector]:
        """Do one thing or the other."""
        if inputs.value[0] > 0.0:
            return state, inputs.value
        return super().step(state, inputs, dt)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Floating(LowPass):
    """A law that makes a number of Python from an array."""

    def step(self, state: State, inputs: Inputs, dt: Scalar) -> tuple[State, Vector]:
        """Do so."""
        size = float(inputs.value[0])
        return state, size * inputs.value


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rotation(Checked):
    """Products of complex numbers in pairs, which compilers like to fuse; its state is one array."""

    def example(self) -> Components:
        """Return inputs as it takes them."""
        return np.zeros(8)

    def init(self, inputs: Components) -> Components:
        """Start at the inputs."""
        return inputs

    def step(self, state: Components, inputs: Components, dt: Scalar) -> tuple[Components, Components]:
        """Multiply with the inputs."""
        xp = namespace(inputs)
        (a, b), (c, d) = (each.reshape(4, 2).T for each in (state, inputs))
        product = xp.stack([a * c - b * d, a * d + b * c], axis=-1).reshape(8)
        return product, dt * product + inputs


class Reserved(NamedTuple):
    """A state whose fields are words of C."""

    double: Vector
    short: Scalar


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Keywords(Checked):
    """A law that is called in words of C."""

    register: float = parameter(0.5, doc="share of the news")

    def init(self, inputs: Inputs) -> Reserved:
        """Start at the value."""
        return Reserved(inputs.value, 0.0 * inputs.value[..., 0])

    def step(self, state: Reserved, inputs: Inputs, dt: Scalar) -> tuple[Reserved, Vector]:
        """Follow the value."""
        double = state.double + self.register * (inputs.value - state.double)
        return Reserved(double, state.short + dt), double
