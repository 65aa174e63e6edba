"""Where the assumptions of Wang, Huang and Zhang (2021) on disturbances hold, (42)-(44), and D_e."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.disturbance_observer import DisturbanceObserver
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_fdi.disturbance_observers.none import NoDisturbanceObserver
from quadftc_model.samples import DisturbanceObserverInputs
from quadftc_theory import conditions
from quadftc_theory.conditions import Circumstances, Condition, Floats, Verdict, per_axis, verdict

FOLLOWED = 0.01  # 1; share of the disturbance that the error may settle at and still count as followed


def estimation_error(observer: DisturbanceObserver, disturbance: Floats, noise: Floats, dt: float) -> Floats:
    """Run an observer on a disturbance and return d - d^ (44), (n, 3) [rad/s²].

    Each axis turns alone and without torque, so that its rate is the integral of its disturbance.

    Parameters
    ----------
    disturbance, noise : array (n, 3)
        d over time [rad/s²], piecewise linear between the samples, and noise of the gyro [rad/s].
    dt : float
        Sampling period [s].
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
def bounded_disturbance(observer: object, given: Circumstances) -> list[Condition]:
    """Judge Assumption 4, all that is left without an estimate: that the disturbance is bounded."""
    peak = given.disturbance.peak
    text, bounded = f"D_d = {per_axis(peak)} rad/s² ({given.disturbance.origin})", np.all(np.isfinite(peak))
    return [Condition("Assumption 4: |d| <= D_d", verdict(bounded), text, {"D_d": peak.tolist()})]


@conditions.conditions_of(Exosystem)
def exosystem_conditions(observer: Exosystem, given: Circumstances) -> Iterator[Condition]:
    """Judge (42)-(44) at the sampling period given.

    Assumption 5, d of the exosystem: whether the error vanishes; Assumption 6, its bound D_e.
    """
    poles: NDArray[np.complex128] = observer.poles(given.dt).astype(np.complex128)
    numbers = {"poles": [[float(pole.real), float(pole.imag)] for pole in poles]}
    text = f"poles at {', '.join(f'{pole:.4g}' for pole in np.unique(np.round(poles.real, 6)))} rad/s"
    yield Condition("A_d - lambda C_d Hurwitz", verdict(np.all(poles.real < 0.0)), text, numbers)
    yield from bounded_disturbance(observer, given)

    error = given.disturbance_error
    largest, typical = error.peak, np.median(np.abs(error.values), axis=0)
    quiet = np.all(typical <= FOLLOWED * np.maximum(given.disturbance.peak, 1e-12) + 1e-9)
    text = f"exosystem '{observer.model}': error of the estimate below {per_axis(typical, 2)} rad/s² half"
    text += " of the time"
    text += "" if quiet else ", not 0: the disturbance is not of this exosystem, the estimate lags"
    followed, numbers = Verdict.PASS if quiet else Verdict.DEPENDS, {"median_error": typical.tolist()}
    yield Condition("Assumption 5: d of the exosystem (42)", followed, text, numbers, needed=False)
    text, bounded = (
        f"D_e = {per_axis(largest)} rad/s² at worst ({error.origin})",
        np.all(np.isfinite(largest)),
    )
    yield Condition("Assumption 6: |d - d^| <= D_e", verdict(bounded), text, {"D_e": largest.tolist()})
