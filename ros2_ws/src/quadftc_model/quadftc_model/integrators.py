"""Fixed-step integrators over states that are tuples of arrays."""

from __future__ import annotations

from collections.abc import Callable

from quadftc_model.arrays import Array

State = tuple[Array, ...]
Derivative = Callable[[float, State], State]  # of (time, state)


def rk4(derivative: Derivative, time: float, state: State, dt: float) -> State:
    """One step ``dt`` [s] of the classical Runge-Kutta method of order 4, from ``time`` [s] on."""
    half = 0.5 * dt
    k1 = derivative(time, state)
    k2 = derivative(time + half, _shifted(state, k1, half))
    k3 = derivative(time + half, _shifted(state, k2, half))
    k4 = derivative(time + dt, _shifted(state, k3, dt))
    sixth = dt / 6.0
    return tuple(
        x + sixth * (a + 2.0 * (b + c) + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
    )


def _shifted(state: State, slope: State, step: float) -> State:
    return tuple(x + step * k for x, k in zip(state, slope, strict=True))
