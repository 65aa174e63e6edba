"""The disturbance observer (43) of Wang et al. (2021), after Chen (2004): disturbances of an exosystem (42).

    (36)  x2' = f(x2) + B_u u + d
    (42)  zeta' = A_d zeta,  d = C_d zeta
    (43)  z' = (A_d - lambda C_d) z + A_d mu - lambda (C_d mu + f(x2) + B_u u)
          zeta^ = z + mu,  mu = lambda x2

Each axis has its own zeta. The paper's (43) prints C where C_d is meant. Its error obeys zeta~' = (A_d -
lambda C_d) zeta~ whatever the vehicle does.

Discretisation. In terms of zeta^, (43) is zeta^' = A_d zeta^ + lambda (x2' - f - B_u u - C_d zeta^).
Integrated over a sample, with Phi = exp(A_d dt) and Gamma = int_0^dt exp(A_d s) ds exact and the trapezoidal
rule for f:

    zeta^+ = Phi zeta^ + l nu,   nu = x2+ - x2 - int (f + B_u u) - C_d Gamma zeta^

so a disturbance of the exosystem is followed to rounding at any rate. l puts the poles of Phi - l C_d Gamma
at exp(-bandwidth dt), all of them, which for the constant exosystem is lambda = bandwidth exactly.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from quadftc_fdi.disturbance_conditions import exosystem_conditions
from quadftc_fdi.disturbance_observer import DisturbanceObserver, register
from quadftc_model.arrays import Array, namespace
from quadftc_model.conditions import Circumstances, Condition
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.samples import DisturbanceObserverInputs

Matrix = NDArray[np.float64]


class ExosystemState(NamedTuple):
    """Observer state at the last sample."""

    zeta: Array  # (..., 3, n) estimate of the exosystem's state; its output is d^ [rad/s²]
    x2: Array  # (..., 3) body rate, measured or, where the gyro was absent, predicted [rad/s]
    started: Array  # (...,) bool: there has been a measured body rate


@register("exosystem")
@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
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

    def init(self, inputs: DisturbanceObserverInputs) -> ExosystemState:
        """Start with no disturbance, at the first body rate."""
        rate = inputs.body_rate
        xp = namespace(rate)
        zeta = xp.stack([xp.zeros_like(rate)] * len(self.A_d), axis=-1)
        return ExosystemState(zeta, rate, inputs.rate_valid)

    def step(
        self, state: ExosystemState, inputs: DisturbanceObserverInputs, dt: float
    ) -> tuple[ExosystemState, Array]:
        """Advance by ``dt`` [s]; a sample without body rate is predicted, not corrected."""
        if dt == 0.0:
            return state, state.zeta @ self.C_d
        xp = namespace(inputs.body_rate)
        if state.zeta.shape[-1] != len(self.C_d):  # the model was changed in flight
            state = state._replace(zeta=self.init(inputs).zeta)
        inertia = self.vehicle.inertia
        Phi, CdGamma, gain = _discretised(self.model, self.frequency, self.bandwidth, dt)
        rate = xp.where(inputs.rate_valid[..., None], inputs.body_rate, state.x2)
        f = 0.5 * (gyroscopic_acceleration(inertia, state.x2) + gyroscopic_acceleration(inertia, rate))
        predicted = state.x2 + dt * (f + inputs.torque / inertia) + state.zeta @ CdGamma
        x2 = xp.where(inputs.rate_valid[..., None], rate, predicted)
        nu = xp.where(state.started[..., None], x2 - predicted, 0.0)
        zeta = state.zeta @ Phi.T + nu[..., None] * gain
        return ExosystemState(zeta, x2, state.started | inputs.rate_valid), zeta @ self.C_d

    def conditions(self, given: Circumstances) -> list[Condition]:
        """Judge (42)-(44) at the sampling period given."""
        return exosystem_conditions(self.poles(given.dt), self.model, given)

    def poles(self, dt: float) -> Matrix:
        """Poles (n,) [rad/s] of the observer stepped by ``dt`` [s]: log of the eigenvalues over dt."""
        Phi, CdGamma, gain = _discretised(self.model, self.frequency, self.bandwidth, dt)
        eigenvalues = np.linalg.eigvals(Phi - np.outer(gain, CdGamma))
        return np.asarray(np.log(eigenvalues.astype(np.complex128)) / dt)

    @property
    def A_d(self) -> Matrix:
        """A_d of (42), (n, n) [1/s]."""
        return exosystem(self.model, self.frequency)[0]

    @property
    def C_d(self) -> Matrix:
        """C_d of (42), (n,)."""
        return exosystem(self.model, self.frequency)[1]


@functools.lru_cache(maxsize=256)
def exosystem(model: str, frequency: float) -> tuple[Matrix, Matrix]:
    """A_d (n, n) and C_d (n,) of (42) by name: blocks joined by ``+``.

    Raises
    ------
    ValueError
        If a block is not ``constant``, ``ramp`` or ``harmonic``.
    """
    blocks = {
        "constant": np.zeros((1, 1)),
        "ramp": np.array([[0.0, 1.0], [0.0, 0.0]]),
        "harmonic": np.array([[0.0, frequency], [-frequency, 0.0]]),
    }
    names = model.split("+")
    unknown = [name for name in names if name not in blocks]
    if unknown:
        raise ValueError(f"model = {model!r}: '{unknown[0]}' is none of {', '.join(blocks)}")
    size = sum(len(blocks[name]) for name in names)
    A_d, C_d = np.zeros((size, size)), np.zeros(size)
    at = 0
    for name in names:
        n = len(blocks[name])
        A_d[at : at + n, at : at + n] = blocks[name]
        C_d[at] = 1.0
        at += n
    return _frozen(A_d), _frozen(C_d)


@functools.lru_cache(maxsize=256)
def _discretised(model: str, frequency: float, bandwidth: float, dt: float) -> tuple[Matrix, Matrix, Matrix]:
    """Phi (n, n), C_d Gamma (n,) and the gain l (n,) of a step; kept, as a flight has few different steps."""
    A_d, C_d = exosystem(model, frequency)
    n = len(A_d)
    # exp([[A_d, I], [0, 0]] dt) = [[Phi, Gamma], [0, I]] (Van Loan 1978)
    total: Matrix = expm(  # pyright: ignore
        np.block([[A_d, np.eye(n)], [np.zeros((n, 2 * n))]]) * dt
    )
    Phi, CdGamma = total[:n, :n], C_d @ total[:n, n:]
    return _frozen(Phi), _frozen(CdGamma), _frozen(_gain(Phi, CdGamma, math.exp(-bandwidth * dt), dt))


def _gain(Phi: Matrix, CdGamma: Matrix, pole: float, dt: float) -> Matrix:
    """Gain l (n,) that puts all eigenvalues of Phi - l C_d Gamma at ``pole``: Ackermann's formula.

    In the delta operator, (Phi - I) / dt: the observability matrix stays well conditioned as dt goes to 0.
    """
    n = len(Phi)
    D, c = (Phi - np.eye(n)) / dt, CdGamma / dt
    observability = np.stack([c @ np.linalg.matrix_power(D, k) for k in range(n)])
    wanted = np.linalg.matrix_power(D - (pole - 1.0) / dt * np.eye(n), n)
    gain: Matrix = wanted @ np.linalg.solve(observability, np.eye(n)[:, -1])  # pyright: ignore
    return gain


def _frozen(matrix: Matrix) -> Matrix:
    matrix.setflags(write=False)
    return matrix
