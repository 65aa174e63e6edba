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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.disturbance_observer import DisturbanceObserver, register
from quadftc_model.arrays import (
    Array,
    Flag,
    Scalar,
    Vector,
    chosen,
    column,
    exp,
    namespace,
    sin,
    stacked,
    where,
)
from quadftc_model.numbers import prepared
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
        moved = chosen(dt > 0.0, self._moved(state, inputs, where(dt > 0.0, dt, 1.0)), state)
        return moved, moved.zeta @ self.C_d

    def _moved(self, state: State, inputs: DisturbanceObserverInputs, dt: Scalar) -> State:
        inertia, known = self.vehicle.inertia, column(inputs.rate_valid)
        Phi, CdGamma, gain = self._discretised(dt)
        # predict x2 by the trapezoidal rule; without a body rate, f stays
        rate = where(known, inputs.body_rate, state.x2)
        f = 0.5 * (gyroscopic_acceleration(inertia, state.x2) + gyroscopic_acceleration(inertia, rate))
        predicted = state.x2 + dt * (f + inputs.torque / inertia) + state.zeta @ CdGamma
        # correct zeta by nu, once there has been a body rate to start from
        x2 = where(known, rate, predicted)
        nu = where(column(state.started), x2 - predicted, 0.0)
        zeta = state.zeta @ Phi.T + nu[..., None] * gain
        return State(zeta, x2, state.started | inputs.rate_valid)

    def _discretised(self, dt: Scalar) -> tuple[Array, Array, Array]:
        """Phi (n, n), C_d Gamma (n,) and the gain l (n,) of a step, in closed form."""
        change, CdGamma = _blocks(self.model, self.frequency, dt)
        xp, n = namespace(change), len(CdGamma)
        gain = _gain(change / dt, CdGamma / dt, (exp(-self.bandwidth * dt) - 1.0) / dt)
        return xp.eye(n) + change, CdGamma, gain

    def poles(self, dt: float) -> Matrix:
        """Poles (n,) [rad/s] of the observer stepped by ``dt`` [s]: log of the eigenvalues over dt."""
        Phi, CdGamma, gain = self._discretised(dt)
        eigenvalues = np.asarray(np.linalg.eigvals(Phi - np.outer(gain, CdGamma)), np.complex128)
        return np.asarray(np.log(eigenvalues) / dt)

    @prepared
    def C_d(self) -> Matrix:
        """C_d of (42), (n,): the first state of each block."""
        return np.array(_OUTPUTS[self.model])


def _blocks(model: str, frequency: Scalar, dt: Scalar) -> tuple[Array, Array]:
    """Phi - I (n, n), that is exp(A_d dt) - I, and C_d Gamma (n,) of the exosystem of a model."""
    sine, half = sin(frequency * dt), sin(0.5 * frequency * dt)
    fall = 2.0 * half * half  # 1 - cos, without cancellation
    turn, integral = [[-fall, sine], [-sine, -fall]], [sine / frequency, fall / frequency]
    zero = 0.0 * dt
    rows, output = {
        "constant": ([[zero]], [dt]),
        "ramp": ([[zero, dt], [zero, zero]], [dt, 0.5 * dt * dt]),
        "harmonic": (turn, integral),
        "constant+harmonic": ([[zero] * 3, *([zero, *row] for row in turn)], [dt, *integral]),
    }[model]
    return namespace(sine).stack([stacked(row) for row in rows]), stacked(output)


def _gain(D: Array, c: Array, pole: Array) -> Array:
    """Gain l (n,) that puts all eigenvalues of D - l c at ``pole``: Ackermann's formula.

    l = (D - pole I)^n v, where v is the last column of the inverse of the observability matrix, of rows c,
    c D, c D²: a cross product over a determinant. In the delta operator, D = (Phi - I) / dt, observability
    stays well conditioned as dt goes to 0.
    """
    xp, n = namespace(D), len(c)
    if n == 3:
        last, v = c @ D @ D, xp.cross(c, c @ D)
    elif n == 2:
        last, v = c @ D, stacked([-c[1], c[0]])
    else:
        last, v = c, xp.ones(1)
    v = v / (last @ v)
    for _ in range(n):
        v = D @ v - pole * v
    return v


_OUTPUTS = {
    "constant": (1.0,),
    "ramp": (1.0, 0.0),
    "harmonic": (1.0, 0.0),
    "constant+harmonic": (1.0, 1.0, 0.0),
}
