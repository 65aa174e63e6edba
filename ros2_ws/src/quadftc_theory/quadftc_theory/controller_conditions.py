"""Where Theorem 2 of Wang, Huang and Zhang (2021) holds for a controller, and what any controller needs."""

from __future__ import annotations

import dataclasses

import numpy as np

from quadftc_control.controllers.ismc import Ismc
from quadftc_control.controllers.pid import Pid
from quadftc_control.controllers.smc import Smc
from quadftc_theory import conditions
from quadftc_theory.conditions import (
    Circumstances,
    Condition,
    Floats,
    Series,
    Trace,
    Verdict,
    per_axis,
    verdict,
)

BRIEF = 0.01  # 1; share of the time for which a gain may be too small and Theorem 2 still hold otherwise


@conditions.conditions_of(Ismc)
@conditions.conditions_of(Smc)
def theorem_2_conditions(controller: Ismc, given: Circumstances) -> list[Condition]:
    """Judge the conditions of Theorem 2, of either controller."""
    return [
        _surface(controller),
        _switching_gain(controller, given),
        _layer(controller, given.dt),
        _authority(np.asarray(controller.k_c3), given),
    ]


@conditions.conditions_of(Pid)
def pid_conditions(controller: Pid, given: Circumstances) -> list[Condition]:
    """Judge the authority; there is no theorem on this loop here."""
    return [_authority(np.zeros(3), given)]


@conditions.conditions_along_of(Ismc)
@conditions.conditions_along_of(Smc)
def reaching_law(controller: Ismc, trace: Trace, given: Circumstances) -> list[Condition]:
    """Judge (47), each axis by itself: V3' <= -eta |S| where |S| > Phi.

    eta is what k_c3 exceeds the error by; without a margin (47) promises nothing, and V3 may not rise.
    """
    S, phi = trace.sliding_variable, np.asarray(controller.phi)
    eta = np.maximum(np.asarray(controller.k_c3) - _to_hold_against(controller, given)[0].peak, 0.0)
    outside = (np.abs(S) > phi) & ~trace.saturated
    name = "(47): V3' <= -eta |S| along the run"
    found = conditions.falls(name, 0.5 * S * S, trace.stamp_ns, -eta * np.abs(S), outside)
    largest = np.nanmax(np.abs(S) / phi, axis=0)
    text = f"{found.text}; |S| up to {per_axis(largest)} Phi"
    numbers = {**found.numbers, "largest_S_over_phi": largest.tolist(), "eta": eta.tolist()}
    return [dataclasses.replace(found, text=text, numbers=numbers)]


def _to_hold_against(controller: Ismc, given: Circumstances) -> tuple[Series, str]:
    """What the switching has to hold against: d - d^, or all of d where nothing estimates it [rad/s²]."""
    return (given.disturbance, "D_d") if isinstance(controller, Smc) else (given.disturbance_error, "D_e")


def _surface(controller: Ismc) -> Condition:
    """The motion on S = 0: x1e'' + k_c2 x1e' + k_c1 x1e = 0; without k_c1, x1e' + k_c2 x1e = 0."""
    if isinstance(controller, Smc):
        poles = [np.roots([1.0, k_c2]) for k_c2 in controller.k_c2]
    else:
        poles = [np.roots([1.0, *gains]) for gains in zip(controller.k_c2, controller.k_c1, strict=True)]
    slowest = [float(np.max(each.real)) for each in poles]
    text = f"slowest pole of each axis at {per_axis(slowest)} rad/s"
    numbers = {"poles": [[[pole.real, pole.imag] for pole in each] for each in poles]}
    return Condition("motion on S = 0 Hurwitz", verdict(max(slowest) < 0.0), text, numbers)


def _switching_gain(controller: Ismc, given: Circumstances) -> Condition:
    """k_c3 >= eta + D_e (Theorem 2), over time."""
    error, symbol = _to_hold_against(controller, given)
    gain, largest = np.asarray(controller.k_c3), error.peak
    eta, short = gain - largest, np.any(np.abs(error.values) >= gain, axis=1)
    time_short = float(short.sum() * given.dt)
    numbers = {"k_c3": gain.tolist(), symbol: largest.tolist(), "eta": eta.tolist(), "time_short": time_short}
    name = f"Theorem 2: k_c3 >= eta + {symbol}"
    text = f"k_c3 = {per_axis(gain)}, {symbol} = {per_axis(largest)} rad/s² ({error.origin}); "
    if not short.any():
        return Condition(name, Verdict.PASS, text + f"eta = {per_axis(eta)} rad/s²", numbers)
    first = float(np.argmax(short)) * given.dt
    text += f"too small for {time_short:.3g} s, first at {first:.3g} s: S may leave its layer"
    outcome = Verdict.DEPENDS if np.mean(short) <= BRIEF else Verdict.FAIL
    return Condition(name, outcome, text, numbers)


def _layer(controller: Ismc, dt: float) -> Condition:
    """The boundary layer against sampling: inside it S' = -(k_c3/phi) S, stable in steps if < 2/dt."""
    rate = np.asarray(controller.k_c3) / np.asarray(controller.phi)
    text = f"k_c3/Phi = {per_axis(rate)} 1/s, sampled at {1.0 / dt:.4g} Hz: |S| shrinks by up to "
    text += f"{100.0 * np.max(rate) * dt:.2g} % a sample; chatter from {2.0 / dt:.4g} 1/s on"
    numbers = {"rate": rate.tolist(), "limit": 2.0 / dt}
    name = "(41): Phi thick enough for the sampling"
    return Condition(name, verdict(np.all(rate * dt < 2.0)), text, numbers)


def _authority(k_c3: Floats, given: Circumstances) -> Condition:
    """The torque that the rotors can give against what the scenario may ask for, axis by axis."""
    inertia, authority = given.vehicle.inertia, given.vehicle.authority
    must = inertia * (given.disturbance.peak + np.asarray(given.acceleration.value))
    all_of_it = must + inertia * k_c3
    text = (
        f"rotors give {per_axis(authority)} N m; disturbance and reference take {per_axis(must, 2)} N m, "
        f"with all of k_c3 {per_axis(all_of_it, 2)} N m"
    )
    outcome = Verdict.PASS
    if np.any(must >= authority):
        outcome, text = Verdict.FAIL, text + ": too weak"
    elif np.any(authority < all_of_it):
        outcome, text = Verdict.DEPENDS, text + ": the torque is cut while S is far out"
    margin = authority / np.maximum(must, 1e-12)
    numbers = {"authority": authority.tolist(), "required": must.tolist(), "ratio": margin.tolist()}
    return Condition("authority against the disturbance", outcome, text, numbers)
