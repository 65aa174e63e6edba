"""Where Theorem 2 of Wang, Huang and Zhang (2021) and its assumptions on disturbances, (42)-(44), hold.

And what any controller needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from quadftc_control.controllers.ismc import Ismc
from quadftc_control.controllers.pid import Pid
from quadftc_control.controllers.smc import Smc
from quadftc_fdi.disturbance_observer import DisturbanceObserver
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_fdi.disturbance_observers.none import NoDisturbanceObserver
from quadftc_model.samples import DisturbanceObserverInputs
from quadftc_theory import conditions
from quadftc_theory.conditions import Circumstances, Condition, Floats, Verdict, assess, per_axis

FOLLOWED = 0.01  # 1; share of the disturbance that the error may settle at and still count as followed
BRIEF = 0.01  # 1; share of the time for which a gain may be too small and Theorem 2 still hold otherwise


def estimation_error(observer: DisturbanceObserver, disturbance: Floats, noise: Floats, dt: float) -> Floats:
    """Run an observer on a disturbance and return d - d^ (44), (n, 3) [rad/s²].

    Each axis turns alone and without torque. Its rate is the integral of its disturbance (n, 3) [rad/s²],
    which is piecewise linear between the samples, plus the ``noise`` (n, 3) of the gyro [rad/s].
    """
    steps = 0.5 * dt * (disturbance[1:] + disturbance[:-1])
    rates = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) + noise
    there, still = np.ones(3, np.bool_), np.zeros((3, 3))
    estimate = np.empty_like(disturbance)
    state = observer.init(DisturbanceObserverInputs(np.diag(rates[0]), there, still))
    for k, rate in enumerate(rates):
        inputs = DisturbanceObserverInputs(np.diag(rate), there, still)
        state, found = observer.step(state, inputs, dt if k else 0.0)
        estimate[k] = np.diagonal(found)
    return disturbance - estimate


@conditions.conditions_of(NoDisturbanceObserver)
def bounded_disturbance(observer: object, given: Circumstances) -> Iterator[Condition]:
    """Judge Assumption 4, all that is left without an estimate: that the disturbance is bounded."""
    peak = given.disturbance.peak
    text = f"D_d = {per_axis(peak)} rad/s² ({given.disturbance.origin})"
    yield assess("Assumption 4: |d| <= D_d", np.all(np.isfinite(peak)), text, D_d=peak.tolist())


@conditions.conditions_of(Exosystem)
def exosystem_conditions(observer: Exosystem, given: Circumstances) -> Iterator[Condition]:
    """Judge (42)-(44) at the sampling period given.

    Assumption 5, d of the exosystem: whether the error vanishes; Assumption 6, its bound D_e.
    """
    poles = observer.poles(given.dt)
    text = f"poles at {', '.join(f'{pole:.4g}' for pole in np.unique(np.round(poles.real, 6)))} rad/s"
    yield assess("A_d - lambda C_d Hurwitz", np.all(poles.real < 0.0), text, poles=conditions.pairs(poles))
    yield from bounded_disturbance(observer, given)

    error = given.disturbance_error
    largest, typical = error.peak, np.median(np.abs(error.values), axis=0)
    quiet = np.all(typical <= FOLLOWED * np.maximum(given.disturbance.peak, 1e-12) + 1e-9)
    lag = "" if quiet else ", not 0: the disturbance is not of this exosystem, the estimate lags"
    text = f"exosystem '{observer.model}': error of the estimate below {per_axis(typical, 2)} rad/s² half"
    name, text = "Assumption 5: d of the exosystem (42)", f"{text} of the time{lag}"
    yield conditions.advise(name, quiet, text, median_error=typical.tolist())
    text = f"D_e = {per_axis(largest)} rad/s² at worst ({error.origin})"
    yield assess("Assumption 6: |d - d^| <= D_e", np.all(np.isfinite(largest)), text, D_e=largest.tolist())


@conditions.conditions_of(Ismc)
@conditions.conditions_of(Smc)
def theorem_2_conditions(controller: Ismc, given: Circumstances) -> Iterator[Condition]:
    """Judge the conditions of Theorem 2, of either controller."""
    # the motion on S = 0: x1e'' + k_c2 x1e' + k_c1 x1e = 0; without k_c1, x1e' + k_c2 x1e = 0
    gains = (controller.k_c2,) if isinstance(controller, Smc) else (controller.k_c2, controller.k_c1)
    roots = [np.roots([1.0, *axis]) for axis in zip(*gains, strict=True)]
    slowest = [float(np.max(each.real)) for each in roots]
    text, poles = f"slowest pole of each axis at {per_axis(slowest)} rad/s", [*map(conditions.pairs, roots)]
    yield assess("motion on S = 0 Hurwitz", max(slowest) < 0.0, text, poles=poles)

    yield _switching_gain(controller, given)

    # inside the boundary layer S' = -(k_c3/phi) S, stable in steps if < 2/dt
    rate, dt = np.asarray(controller.k_c3) / np.asarray(controller.phi), given.dt
    text = f"k_c3/Phi = {per_axis(rate)} 1/s, sampled at {1.0 / dt:.4g} Hz: |S| shrinks by up to "
    text += f"{100.0 * np.max(rate) * dt:.2g} % a sample; chatter from {2.0 / dt:.4g} 1/s on"
    name, thick = "(41): Phi thick enough for the sampling", np.all(rate * dt < 2.0)
    yield assess(name, thick, text, rate=rate.tolist(), limit=2.0 / dt)

    yield authority(np.asarray(controller.k_c3), given)


@conditions.conditions_of(Pid)
def pid_conditions(controller: Pid, given: Circumstances) -> list[Condition]:
    """Judge the authority; there is no theorem on this loop here."""
    return [authority(np.zeros(3), given)]


@conditions.conditions_along_of(Ismc)
@conditions.conditions_along_of(Smc)
def reaching_law(controller: Ismc, trace: conditions.Trace, given: Circumstances) -> Iterator[Condition]:
    """Judge (47), each axis by itself: V3' <= -eta |S| where |S| > Phi.

    eta is what k_c3 exceeds the error by; without a margin (47) promises nothing, and V3 may not rise.
    """
    S, phi = trace.sliding_variable, np.asarray(controller.phi)
    eta = np.maximum(np.asarray(controller.k_c3) - _to_hold_against(controller, given)[0].peak, 0.0)
    largest = np.nanmax(np.abs(S) / phi, axis=0)
    yield conditions.falls(
        "(47): V3' <= -eta |S| along the run",
        0.5 * S * S,
        trace.stamp_ns,
        required=-eta * np.abs(S),
        outside=(np.abs(S) > phi) & ~trace.saturated,
        note=f"; |S| up to {per_axis(largest)} Phi",
        largest_S_over_phi=largest.tolist(),
        eta=eta.tolist(),
    )


def _to_hold_against(controller: Ismc, given: Circumstances) -> tuple[conditions.Series, str]:
    """What the switching has to hold against: d - d^, or all of d where nothing estimates it [rad/s²]."""
    return (given.disturbance, "D_d") if isinstance(controller, Smc) else (given.disturbance_error, "D_e")


def _switching_gain(controller: Ismc, given: Circumstances) -> Condition:
    """k_c3 >= eta + D_e (Theorem 2), over time."""
    error, symbol = _to_hold_against(controller, given)
    gain, largest = np.asarray(controller.k_c3), error.peak
    eta, short = gain - largest, np.any(np.abs(error.values) >= gain, axis=1)
    time_short = float(short.sum() * given.dt)
    text = f"k_c3 = {per_axis(gain)}, {symbol} = {per_axis(largest)} rad/s² ({error.origin}); "
    if short.any():
        first = float(np.argmax(short)) * given.dt
        text += f"too small for {time_short:.3g} s, first at {first:.3g} s: S may leave its layer"
    else:
        text += f"eta = {per_axis(eta)} rad/s²"
    name, otherwise = f"Theorem 2: k_c3 >= eta + {symbol}", Verdict.FAIL
    if np.mean(short) <= BRIEF:
        otherwise = Verdict.DEPENDS
    numbers: dict[str, Any] = {"k_c3": gain.tolist(), symbol: largest.tolist(), "eta": eta.tolist()}
    return assess(name, not short.any(), text, otherwise, **numbers, time_short=time_short)


def authority(k_c3: Floats, given: Circumstances) -> Condition:
    """The torque that the rotors can give against what the scenario may ask for, axis by axis."""
    inertia, authority = given.vehicle.inertia, given.vehicle.authority
    must = inertia * (given.disturbance.peak + np.asarray(given.acceleration.value))
    all_of_it = must + inertia * k_c3
    text = f"rotors give {per_axis(authority)} N m; disturbance and reference take {per_axis(must, 2)} N m, "
    outcome, text = Verdict.PASS, text + f"with all of k_c3 {per_axis(all_of_it, 2)} N m"
    if np.any(must >= authority):
        outcome, text = Verdict.FAIL, text + ": too weak"
    elif np.any(authority < all_of_it):
        outcome, text = Verdict.DEPENDS, text + ": the torque is cut while S is far out"
    margin = authority / np.maximum(must, 1e-12)
    numbers = {"authority": authority.tolist(), "required": must.tolist(), "ratio": margin.tolist()}
    return Condition("authority against the disturbance", outcome, text, numbers)
