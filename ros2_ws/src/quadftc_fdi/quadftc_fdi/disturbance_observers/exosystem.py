"""The disturbance observer (43) of Wang et al. (2021), after Chen (2004): disturbances of an exosystem (42).

    (36)  x2' = f(x2) + B_u u + d
    (42)  zeta' = A_d zeta,  d = C_d zeta
    (43)  z' = (A_d - lambda C_d) z + A_d mu - lambda (C_d mu + f(x2) + B_u u)
          zeta^ = z + mu,  mu = lambda x2

Each axis has its own zeta; (43) prints C for C_d. Its error obeys zeta~' = (A_d - lambda C_d) zeta~.

Discretisation. In terms of zeta^, (43) is zeta^' = A_d zeta^ + lambda (x2' - f - B_u u - C_d zeta^).
Integrated over a sample, with Phi = exp(A_d dt) and Gamma = int_0^dt exp(A_d s) ds exact and the trapezoidal
rule for f:

    zeta^+ = Phi zeta^ + l nu,   nu = x2+ - x2 - int (f + B_u u) - C_d Gamma zeta^

so a disturbance of the exosystem is followed to rounding at any rate. l puts the poles of Phi - l C_d Gamma
at exp(-bandwidth dt), all of them, which for the constant exosystem is lambda = bandwidth exactly.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.disturbance_observer import DisturbanceObserver, register
from quadftc_model.arrays import Array, Flag, Scalar, Vector, cache_numbers, chosen, exp, namespace
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.samples import DisturbanceObserverInputs

Matrix = NDArray[np.float64]


class State(NamedTuple):
    """Observer state at the last sample."""

    zeta: Array  # (..., 3, n) estimate of the exosystem's state; its output is d^ [rad/s²]
    x2: Vector  # body rate, measured or, where the gyro was absent, predicted [rad/s]
    started: Flag  # there has been a measured body rate


@register("exosystem")
class Exosystem(DisturbanceObserver):
    """Observer of constant, growing or oscillating disturbances, the same model on each axis."""

    model: str = parameter(
        "constant",
        choices=("constant", "ramp", "harmonic", "constant+harmonic"),
        doc="exosystem (42): A_d = 0, a double integrator, an oscillator, or both blocks",
    )
    bandwidth: float = parameter(10.0, unit="rad/s", low=1e-6, doc="lambda of (43): all poles are at -lambda")
    frequency: float = parameter(
        1.0, unit="rad/s", low=1e-6, doc="frequency of the harmonic exosystem, which must be known"
    )

    def init(self, inputs: DisturbanceObserverInputs) -> State:
        """Start with no disturbance, at the first body rate."""
        rate = inputs.body_rate
        xp = namespace(rate)
        zeta = xp.stack([xp.zeros_like(rate)] * len(self.C_d), axis=-1)
        return State(zeta, rate, inputs.rate_valid)

    def resumed(self, inputs: DisturbanceObserverInputs, estimate: Vector) -> State:
        """Resume with the whole disturbance in the first block of (42)."""
        state = self.init(inputs)
        first = np.eye(len(self.C_d))[0]
        return state._replace(zeta=state.zeta + estimate[..., None] * first)

    def step(self, state: State, inputs: DisturbanceObserverInputs, dt: float) -> tuple[State, Vector]:
        """Advance by ``dt`` [s]; a sample without body rate is predicted, not corrected."""
        if isinstance(dt, float) and dt == 0.0:
            return state, state.zeta @ self.C_d
        xp = namespace(inputs.body_rate)
        if state.zeta.shape[-1] != len(self.C_d):  # the model was changed in flight
            state = state._replace(zeta=self.init(inputs).zeta)
        inertia = self.vehicle.inertia
        Phi, CdGamma, gain = _discretised(self.model, self.frequency, self.bandwidth, dt)
        # predict x2 by the trapezoidal rule; without a body rate, f stays
        rate = chosen(inputs.rate_valid, inputs.body_rate, state.x2)
        f = 0.5 * (gyroscopic_acceleration(inertia, state.x2) + gyroscopic_acceleration(inertia, rate))
        predicted = state.x2 + dt * (f + inputs.torque / inertia) + state.zeta @ CdGamma
        # correct zeta by nu, once there has been a body rate to start from
        x2 = chosen(inputs.rate_valid, rate, predicted)
        nu = xp.where(state.started[..., None], x2 - predicted, 0.0)
        zeta = state.zeta @ Phi.T + nu[..., None] * gain
        return State(zeta, x2, state.started | inputs.rate_valid), zeta @ self.C_d

    def poles(self, dt: float) -> Matrix:
        """Poles (n,) [rad/s] of the observer stepped by ``dt`` [s]: log of the eigenvalues over dt."""
        Phi, CdGamma, gain = _discretised(self.model, self.frequency, self.bandwidth, dt)
        eigenvalues = np.asarray(np.linalg.eigvals(Phi - np.outer(gain, CdGamma)), np.complex128)
        return np.asarray(np.log(eigenvalues) / dt)

    @functools.cached_property
    def C_d(self) -> Matrix:
        """C_d of (42), (n,): the first state of each block."""
        return np.concatenate([np.eye(_SIZES[name])[0] for name in self.model.split("+")])


@cache_numbers
def _discretised(model: str, frequency: Scalar, bandwidth: Scalar, dt: Scalar) -> tuple[Array, Array, Array]:
    """Phi (n, n), C_d Gamma (n,) and the gain l (n,) of a step, in closed form."""
    xp = namespace(1.0 * frequency * bandwidth * dt)
    blocks = {name: _block(name, frequency, dt, xp) for name in model.split("+")}
    n, at = sum(_SIZES[name] for name in blocks), 0
    rows: list[Any] = []
    for change, _ in blocks.values():  # rows of Phi - I, with zeros around the block
        left, right = xp.zeros(at), xp.zeros(n - at - len(change))
        rows += [xp.concatenate([left, xp.stack([xp.asarray(x) for x in row]), right]) for row in change]
        at += len(change)
    D = xp.stack(rows) / dt
    CdGamma = xp.stack([xp.asarray(x) for _, integral in blocks.values() for x in integral])
    gain = _gain(D, CdGamma / dt, (exp(-bandwidth * dt) - 1.0) / dt, xp)
    return xp.eye(n) + dt * D, CdGamma, gain


def _block(name: str, frequency: Array, dt: Array, xp: Any) -> tuple[list[list[Array]], list[Array]]:
    """Phi - I and C_d Gamma of one block: exp(A_d dt) - I, and the first row of its integral."""
    if name == "constant":
        return [[0.0 * dt]], [dt]
    if name == "ramp":
        return [[0.0 * dt, dt], [0.0 * dt, 0.0 * dt]], [dt, 0.5 * dt * dt]
    sine, half = xp.sin(frequency * dt), xp.sin(0.5 * frequency * dt)
    fall = 2.0 * half * half  # 1 - cos, without cancellation
    return [[-fall, sine], [-sine, -fall]], [sine / frequency, fall / frequency]


def _gain(D: Array, c: Array, pole: Array, xp: Any) -> Array:
    """Gain l (n,) that puts all eigenvalues of D - l c at ``pole``: Ackermann's formula.

    In the delta operator, D = (Phi - I) / dt: observability stays well conditioned as dt goes to 0.
    """
    n = D.shape[-1]
    observability, wanted = [c], xp.eye(n)
    for _ in range(n - 1):
        observability.append(observability[-1] @ D)
    for _ in range(n):
        wanted = wanted @ (D - pole * xp.eye(n))
    return wanted @ xp.linalg.solve(xp.stack(observability), xp.eye(n)[:, -1:])[:, 0]


_SIZES = {"constant": 1, "ramp": 2, "harmonic": 2}
