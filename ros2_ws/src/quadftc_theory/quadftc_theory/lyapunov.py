"""The Lyapunov functions (30) of the sliding-mode fault observer along a recorded run, against (35).

    V1 = z1~' P1 z1~,      V1' <= -2 eta_1 |P1 z1~|
    V2 = z-bar~' P-bar z-bar~,   V2' <= -2 eta_2 |P-bar z-bar~|

The observer is run again on what it was given; z1~ and z-bar~ = (z2~, z3~) are against the truth of the bag.
P-bar solves the Lyapunov equation of A-bar - L-bar C-bar with Q = I. Why V2 need not fall: docs/theory.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov  # pyright: ignore[reportUnknownVariableType]

from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_model.rotations import wrap
from quadftc_model.samples import FaultObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import Stepper
from quadftc_theory.conditions import Condition, Trace, falls

Floats = NDArray[np.float64]


def sliding_mode_along(observer: SlidingMode, trace: Trace, eta_1: float, eta_2: float) -> list[Condition]:
    """Judge (35) at every sample.

    Parameters
    ----------
    observer : SlidingMode
    trace : Trace
    eta_1, eta_2 : float
        Margins of (28) and (29). Without a margin (35) promises nothing; it is then held to not rising.
    """
    z1, z2, e3 = _errors(observer, trace)
    V1 = observer.p1 * np.sum(z1 * z1, axis=1)
    required_1 = -2.0 * max(eta_1, 0.0) * observer.p1 * np.linalg.norm(z1, axis=1)
    one_step = float(np.median(np.diff(trace.stamp_ns))) / 1e9 * (observer.xi + observer.epsilon_1)
    first = falls(
        "(35): V1' <= -2 eta_1 |P1 z1~| along the run",
        V1,
        trace.stamp_ns,
        required_1,
        np.linalg.norm(z1, axis=1) > one_step,
    )
    P = _p_bar(observer.L1, observer.L2)
    z_bar = np.stack([z2, e3], axis=1)  # (n, 2, 3): the same P-bar on each axis
    P_z = np.einsum("ij,njk->nik", P, z_bar)
    V2 = np.sum(z_bar * P_z, axis=(1, 2))
    required_2 = -2.0 * max(eta_2, 0.0) * np.sqrt(np.sum(P_z * P_z, axis=(1, 2)))
    size = np.linalg.norm(e3, axis=1)
    second = falls(
        "(35): V2' <= -2 eta_2 |P-bar z-bar~| along the run",
        V2,
        trace.stamp_ns,
        required_2,
        size > observer.delta,
    )
    largest = float(np.degrees(np.nanmax(np.abs(z2)))) if np.any(np.isfinite(z2)) else float("nan")
    layers = float(np.max(size)) / observer.delta
    text = f"{second.text}; |e3| up to {layers:.3g} delta, angle error up to {largest:.3g} deg"
    numbers = {**second.numbers, "largest_e3": float(np.max(size)), "largest_z2_deg": largest}
    return [first, Condition(second.name, second.verdict, text, numbers, second.needed)]


def _errors(observer: SlidingMode, trace: Trace) -> tuple[Floats, Floats, Floats]:
    """z1~, z2~ and h3 - h3^ (n, 3) of every sample."""
    stepper = Stepper[FaultObserverInputs, object](observer)  # pyright: ignore[reportArgumentType]
    count = len(trace.stamp_ns)
    z1, z2, e3 = (np.full((count, 3), np.nan) for _ in range(3))
    torque, there = np.zeros(3), np.asarray(True)
    for k in range(count):
        sample = sanitised(ImuSample(trace.q_xyzw[k], trace.gyro[k], np.zeros(3), there, there, there))
        if stepper.step(int(trace.stamp_ns[k]), FaultObserverInputs(sample, torque)) is None:
            continue
        state = stepper.state
        z1[k] = trace.body_rate[k] - state.z1
        z2[k] = wrap(trace.angles[k] - state.z2)
        e3[k] = state.e3
        if np.all(np.isfinite(trace.torque[k])):
            torque = trace.torque[k]
    return z1, z2, e3


def _p_bar(L1: float, L2: float) -> Floats:
    """P-bar of one axis (2, 2): (A-bar - L-bar C-bar)' P + P (A-bar - L-bar C-bar) = -I."""
    closed = np.array([[0.0, -L1], [1.0, -L2]])
    return np.asarray(solve_continuous_lyapunov(closed.T, -np.eye(2)), np.float64)
