"""Where Theorem 2 of Wang, Huang and Zhang (2021) holds for a controller, and what any controller needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_control.controllers.ismc import Ismc
from quadftc_control.controllers.pid import Pid
from quadftc_control.controllers.smc import Smc
from quadftc_theory.conditions import (
    Circumstances,
    Condition,
    Series,
    Trace,
    Verdict,
    conditions_along_of,
    conditions_of,
    falls,
    per_axis,
    verdict,
)

Floats = NDArray[np.float64]

BRIEF = 0.01  # 1; share of the time for which a gain may be too small and Theorem 2 still hold otherwise


@conditions_of(Ismc)
def ismc_conditions(controller: Ismc, given: Circumstances) -> list[Condition]:
    """Judge the conditions of Theorem 2."""
    return [
        surface_condition(controller.k_c1, controller.k_c2),
        switching_gain_condition(controller.k_c3, given.disturbance_error, given.dt, "D_e"),
        layer_condition(controller.k_c3, controller.phi, given.dt),
        authority_condition(controller.k_c3, given),
    ]


@conditions_along_of(Ismc)
def ismc_conditions_along(controller: Ismc, trace: Trace, given: Circumstances) -> list[Condition]:
    """Judge (47)."""
    return [sliding_mode_along(controller.k_c3, controller.phi, given.disturbance_error.peak, trace)]


@conditions_of(Smc)
def smc_conditions(controller: Smc, given: Circumstances) -> list[Condition]:
    """Judge the conditions of Theorem 2 with nothing estimated: the whole disturbance is the error."""
    return [
        surface_condition(None, controller.k_c2),
        switching_gain_condition(controller.k_c3, given.disturbance, given.dt, "D_d"),
        layer_condition(controller.k_c3, controller.phi, given.dt),
        authority_condition(controller.k_c3, given),
    ]


@conditions_along_of(Smc)
def smc_conditions_along(controller: Smc, trace: Trace, given: Circumstances) -> list[Condition]:
    """Judge (47)."""
    return [sliding_mode_along(controller.k_c3, controller.phi, given.disturbance.peak, trace)]


@conditions_of(Pid)
def pid_conditions(controller: Pid, given: Circumstances) -> list[Condition]:
    """Judge the authority; there is no theorem on this loop here."""
    return [authority_condition((0.0, 0.0, 0.0), given)]


def surface_condition(k_c1: Sequence[float] | None, k_c2: Sequence[float]) -> Condition:
    """Judge the motion on S = 0: x1e'' + k_c2 x1e' + k_c1 x1e = 0; without k_c1, x1e' + k_c2 x1e = 0."""
    poles = [np.roots([1.0, b] if k_c1 is None else [1.0, b, k_c1[axis]]) for axis, b in enumerate(k_c2)]
    slowest = [float(np.max(each.real)) for each in poles]
    text = f"slowest pole of each axis at {per_axis(slowest)} rad/s"
    return Condition(
        "motion on S = 0 Hurwitz",
        verdict(all(value < 0.0 for value in slowest)),
        text,
        {"poles": [[[pole.real, pole.imag] for pole in each] for each in poles]},
    )


def switching_gain_condition(k_c3: Sequence[float], error: Series, dt: float, symbol: str) -> Condition:
    """Judge k_c3 >= eta + D_e (Theorem 2), over time.

    Parameters
    ----------
    k_c3 : three floats
        Switching gain [rad/s²].
    error : Series
        What the switching has to hold against, d - d^, or d where nothing estimates it [rad/s²].
    dt : float
        Sampling period [s].
    symbol : str
        ``D_e`` or ``D_d``.
    """
    gain = np.asarray(k_c3)
    largest = error.peak
    eta = gain - largest
    short = np.any(np.abs(error.values) >= gain, axis=1)
    numbers = {
        "k_c3": gain.tolist(),
        symbol: largest.tolist(),
        "eta": eta.tolist(),
        "time_short": float(short.sum() * dt),
    }
    name = f"Theorem 2: k_c3 >= eta + {symbol}"
    text = f"k_c3 = {per_axis(gain)}, {symbol} = {per_axis(largest)} rad/s² ({error.origin}); "
    if not short.any():
        return Condition(name, Verdict.PASS, text + f"eta = {per_axis(eta)} rad/s²", numbers)
    first = float(np.argmax(short)) * dt
    text += f"too small for {short.sum() * dt:.3g} s, first at {first:.3g} s: S may leave its layer"
    outcome = Verdict.DEPENDS if np.mean(short) <= BRIEF else Verdict.FAIL
    return Condition(name, outcome, text, numbers)


def layer_condition(k_c3: Sequence[float], phi: Sequence[float], dt: float) -> Condition:
    """Judge the boundary layer against sampling: inside it S' = -(k_c3/phi) S, stable in steps if < 2/dt."""
    rate = np.asarray(k_c3) / np.asarray(phi)
    text = f"k_c3/Phi = {per_axis(rate)} 1/s, sampled at {1.0 / dt:.4g} Hz: |S| shrinks by up to "
    text += f"{100.0 * np.max(rate) * dt:.2g} % a sample; chatter from {2.0 / dt:.4g} 1/s on"
    return Condition(
        "(41): Phi thick enough for the sampling",
        verdict(bool(np.all(rate * dt < 2.0))),
        text,
        {"rate": rate.tolist(), "limit": 2.0 / dt},
    )


def authority_condition(k_c3: Sequence[float], given: Circumstances) -> Condition:
    """Judge the torque that the rotors can give against what the scenario may ask for, axis by axis."""
    inertia, authority = given.vehicle.inertia, given.vehicle.authority
    must = inertia * (given.disturbance.peak + np.asarray(given.acceleration.value))
    all_of_it = must + inertia * np.asarray(k_c3)
    margin, reserve = authority / np.maximum(must, 1e-12), authority - all_of_it
    text = (
        f"rotors give {per_axis(authority)} N m; disturbance and reference take {per_axis(must, 2)} N m, "
        f"with all of k_c3 {per_axis(all_of_it, 2)} N m"
    )
    if np.any(must >= authority):
        outcome, text = Verdict.FAIL, text + ": too weak"
    elif np.any(reserve < 0.0):
        outcome, text = Verdict.DEPENDS, text + ": the torque is cut while S is far out"
    else:
        outcome = Verdict.PASS
    numbers = {"authority": authority.tolist(), "required": must.tolist(), "ratio": margin.tolist()}
    return Condition("authority against the disturbance", outcome, text, numbers)


def sliding_mode_along(k_c3: Sequence[float], phi: Sequence[float], error: Floats, trace: Trace) -> Condition:
    """Judge (47) along a recorded run, each axis by itself: V3' <= -eta |S| where |S| > Phi.

    eta is what k_c3 exceeds D_e by.

    Parameters
    ----------
    k_c3, phi : three floats
        Switching gain [rad/s²] and boundary layer [rad/s].
    error : array (3,)
        D_e [rad/s²].
    trace : Trace
    """
    S = trace.sliding_variable
    eta = np.maximum(
        np.asarray(k_c3) - error, 0.0
    )  # without a margin (47) promises nothing: not rising, then
    outside = (np.abs(S) > np.asarray(phi)) & ~trace.saturated
    found = falls(
        "(47): V3' <= -eta |S| along the run", 0.5 * S * S, trace.stamp_ns, -eta * np.abs(S), outside
    )
    largest = np.nanmax(np.abs(S) / np.asarray(phi), axis=0)
    text = f"{found.text}; |S| up to {per_axis(largest)} Phi"
    numbers = {**found.numbers, "largest_S_over_phi": largest.tolist(), "eta": eta.tolist()}
    return Condition(found.name, found.verdict, text, numbers, found.needed)
