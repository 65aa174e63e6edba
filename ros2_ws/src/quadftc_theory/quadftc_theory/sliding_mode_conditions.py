"""Where Theorem 1 of Wang, Huang and Zhang (2021) holds for the sliding-mode fault observer, and how well.

Conditions on gains: A1s and A-bar - L-bar C-bar Hurwitz, (18), (26), (28), (29); and what the paper does not
say: leak of the estimate, drift by a gyro bias, the smallest ramp that can be told from such a drift.
docs/theory.md derives the formulas.
"""

from __future__ import annotations

import math

import numpy as np

from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_theory.conditions import (
    Circumstances,
    Condition,
    Trace,
    Verdict,
    conditions_along_of,
    conditions_of,
    verdict,
)
from quadftc_theory.decoupling import augment, decouple
from quadftc_theory.linear_form import attitude_model
from quadftc_theory.linear_systems import stable
from quadftc_theory.lyapunov import sliding_mode_along
from quadftc_theory.structure_conditions import structure_conditions

DEG = math.pi / 180.0
HEALTHY_TIME = 20.0  # s; over which a gyro bias can be averaged before a fault comes
DETECTED = 2.33 + 3.29  # 1; standard deviations: missed once in 100 times, reported falsely once in 1000
NEGLIGIBLE_LEAK = 0.01  # 1; share of a fault that may leak away unnoticed while it lasts
NEGLIGIBLE_DRIFT = 0.05 * DEG  # rad; error of the estimate that counts as none (docs/theory.md)


@conditions_of(SlidingMode)
def sliding_mode_conditions(observer: SlidingMode, given: Circumstances) -> list[Condition]:
    """Judge the observer in the circumstances given."""
    model = attitude_model(observer.vehicle.inertia)
    return [
        *structure_conditions(model),
        _faultless_rates(given),
        *_hurwitz(observer),
        _fault_bound(observer, given),
        _disturbance_bound(observer, given),
        *_gains(observer, given),
        _leak(observer, given),
        _drift(observer, given),
        _smallest_ramp(given),
    ]


@conditions_along_of(SlidingMode)
def lyapunov_conditions(observer: SlidingMode, trace: Trace, given: Circumstances) -> list[Condition]:
    """Judge (35) along a recorded run."""
    return sliding_mode_along(observer, trace, *gain_margins(observer, given))


def leak_time_constant(observer: SlidingMode, fault: float = 0.0) -> float:
    """Time constant [s] with which the estimate of a constant fault leaks: (T8) of docs/theory.md.

    Parameters
    ----------
    observer : SlidingMode
        Without L1-bar nothing leaks: inf.
    fault : float
        Size of the fault [rad]; the larger, the faster it leaks. 0: the limit of small faults, (T7).
    """
    rho = observer.epsilon_s + observer.epsilon_2
    left = 1.0 - min(fault / rho, 1.0)  # 1 - kappa
    if observer.L1 <= 0.0:
        return math.inf
    return (observer.L2 + rho / observer.delta * left**2) / (observer.L1 * left) if left > 0.0 else 0.0


def drift(observer: SlidingMode, duration: float) -> float:
    """Error of the estimate [rad] after ``duration`` [s] for each rad/s of gyro bias."""
    tau = leak_time_constant(observer)
    return duration if math.isinf(tau) else -tau * math.expm1(-duration / tau)


def kinematic_lipschitz(tilt: float, body_rate: float) -> float:
    """Lipschitz constant [1/s] over the angles of D2 f, which is (4) less (5), for |roll|, |pitch| <= tilt.

    With q² + r² <= body_rate², its derivative by pitch is at most body_rate sec²(tilt) sqrt(1 + sin²(tilt)),
    that by roll body_rate sqrt(1 + 2 tan²(tilt)).
    """
    cosine = max(math.cos(tilt), 1e-6)
    by_pitch = math.sqrt(1.0 + math.sin(tilt) ** 2) / cosine**2
    by_roll = math.sqrt(1.0 + 2.0 * math.tan(tilt) ** 2)
    return body_rate * math.hypot(by_pitch, by_roll)


def _faultless_rates(given: Circumstances) -> Condition:
    """h1 of (12) is the gyro: it may carry neither a fault nor a bias."""
    name = "(12): h1, the gyro, without fault and bias"
    bias = given.gyro_bias.value
    if "gyro" in given.faulty_channels:
        text = "the scenario puts a fault on the gyro: z1 and z2 are both wrong"
        return Condition(name, Verdict.FAIL, text)
    text = f"gyro bias up to {bias / DEG:.3g} deg/s ({given.gyro_bias.origin}), no fault on the gyro"
    return Condition(name, verdict(bias == 0.0), text, {"gyro_bias": bias})


def _hurwitz(observer: SlidingMode) -> list[Condition]:
    A1s = -observer.a1 * np.eye(3)
    P1 = observer.p1 * np.eye(3)
    residual = float(np.max(np.abs(A1s.T @ P1 + P1 @ A1s + observer.q1 * np.eye(3))))
    system = augment(decouple(attitude_model(observer.vehicle.inertia)))
    L = np.vstack([observer.L1 * np.eye(3), observer.L2 * np.eye(3)])
    poles = np.linalg.eigvals(system.A - L @ system.C)
    found = sorted({f"{pole:.3g}" if abs(pole.imag) > 1e-9 else f"{pole.real:.3g}" for pole in poles})
    return [
        Condition(
            "A1s Hurwitz, P1 > 0",
            verdict(stable(A1s) and observer.p1 > 0.0 and residual < 1e-9 * observer.q1),
            f"poles at {-observer.a1:.3g} rad/s; P1 = {observer.p1:.3g} I solves its Lyapunov equation",
            {"poles": [-observer.a1] * 3, "p1": observer.p1, "residual": residual},
        ),
        Condition(
            "A-bar - L-bar C-bar Hurwitz",
            verdict(stable(system.A - L @ system.C)),
            f"poles at {', '.join(found)} rad/s (each three times)",
            {"poles": [[pole.real, pole.imag] for pole in poles]},
        ),
    ]


def _fault_bound(observer: SlidingMode, given: Circumstances) -> Condition:
    size = given.fault.value
    text = f"epsilon_s = {observer.epsilon_s / DEG:.3g} deg, "
    text += f"|f_s| up to {size / DEG:.3g} deg ({given.fault.origin})"
    return Condition(
        "(9), (19): epsilon_s >= |f_s|",
        verdict(observer.epsilon_s >= size),
        text,
        {"epsilon_s": observer.epsilon_s, "fault": size},
    )


def _disturbance_bound(observer: SlidingMode, given: Circumstances) -> Condition:
    size = given.disturbance.norm
    text = f"xi = {observer.xi:.3g} rad/s², |Delta_d| up to {size:.3g} rad/s² ({given.disturbance.origin})"
    return Condition(
        "(18): xi >= |Delta_d|",
        verdict(observer.xi >= size),
        text,
        {"xi": observer.xi, "disturbance": size},
    )


def gain_margins(observer: SlidingMode, given: Circumstances) -> tuple[float, float]:
    """eta_1 [rad/s²] of (28) and eta_2 [rad] of (29); a negative one: the gain is too small.

    (28): A2 = 0, and D1 f is computed from the measured rate, so nothing stands against epsilon_1.
    (29): corrected as in docs/theory.md, section 4, to epsilon_2 >= |z2~| + eta_2: what the injection has to
    hold against is the error of the angles itself, which a gyro bias builds up until the end.
    """
    return observer.epsilon_1, observer.epsilon_2 - _state_error(observer, given)


def _gains(observer: SlidingMode, given: Circumstances) -> list[Condition]:
    eta_1, eta_2 = gain_margins(observer, given)
    error, lipschitz = _state_error(observer, given), _lipschitz(observer, given)
    text_28 = (
        f"epsilon_1 = {observer.epsilon_1:.3g} rad/s² > 0: A2-bar = 0 and f comes from the measured rate, so "
        f"the error of the angles does not enter; eta_1 = {eta_1:.3g} rad/s²"
    )
    why = "gyro bias times duration" if error > 0.0 else "healthy start, no gyro bias"
    text_29 = (
        f"epsilon_2 = {observer.epsilon_2 / DEG:.3g} deg, |z2~| up to {error / DEG:.3g} deg (assumed: "
        f"{why}); as printed, (29) would ask for L_f |z-bar~| = {lipschitz * error / DEG:.3g} deg, L_f = "
        f"{lipschitz:.3g} 1/s at tilts up to {given.tilt.value / DEG:.3g} deg and rates up to "
        f"{given.body_rate.value / DEG:.3g} deg/s ({given.tilt.origin})"
    )
    numbers = {"epsilon_2": observer.epsilon_2, "eta_2": eta_2, "lipschitz": lipschitz, "state_error": error}
    return [
        Condition("(28): epsilon_1", verdict(eta_1 > 0.0), text_28, {"eta_1": eta_1}),
        Condition("(29), corrected: epsilon_2 > |z2~|", verdict(eta_2 > 0.0), text_29, numbers),
    ]


def _lipschitz(observer: SlidingMode, given: Circumstances) -> float:
    if observer.kinematics != "full":
        return 0.0
    return kinematic_lipschitz(given.tilt.value, given.body_rate.value)


def _state_error(observer: SlidingMode, given: Circumstances) -> float:
    """Error of the angles [rad] that the gyro bias has built up by the end."""
    return given.gyro_bias.value * drift(observer, given.duration)


def _leak(observer: SlidingMode, given: Circumstances) -> Condition:
    small, large = leak_time_constant(observer), leak_time_constant(observer, given.fault.value)
    share = -math.expm1(-given.fault_length.value / large) if large > 0.0 else 1.0
    text = (
        f"time constant {small:.4g} s = (L2 + (epsilon_s + epsilon_2)/delta)/L1 for small faults, "
        f"{large:.4g} s at {given.fault.value / DEG:.3g} deg: of a constant fault of "
        f"{given.fault_length.value:.3g} s, {100.0 * share:.2g} % leak away"
    )
    outcome = Verdict.PASS if share <= NEGLIGIBLE_LEAK else Verdict.DEPENDS
    numbers = {"time_constant": small, "time_constant_at_fault": large, "share": share}
    return Condition("leak of the fault estimate", outcome, text, numbers, needed=False)


def _drift(observer: SlidingMode, given: Circumstances) -> Condition:
    each = drift(observer, given.duration)
    error = each * given.gyro_bias.value
    text = (
        f"{each:.3g} deg after {given.duration:.3g} s for each deg/s of gyro bias; up to "
        f"{error / DEG:.3g} deg with {given.gyro_bias.value / DEG:.3g} deg/s"
    )
    return Condition(
        "drift by a gyro bias",
        verdict(error <= NEGLIGIBLE_DRIFT),
        text,
        {"per_bias": each, "error": error},
    )


def smallest_ramp(given: Circumstances) -> float:
    """Slowest ramp [rad/s] that any observer can tell from a gyro bias, (T18) of docs/theory.md.

    The gyro bias is averaged over ``HEALTHY_TIME``, the ramp over the length of the longest fault.
    """
    walk = given.gyro_noise.value
    length = given.fault_length.value or HEALTHY_TIME
    if walk == 0.0:
        return 0.0
    memory = given.attitude_noise.value * math.sqrt(given.dt) / walk  # s
    spans = (HEALTHY_TIME, length)
    variance = sum(walk**2 / span * (1.0 + 2.0 * memory / span) for span in spans)
    return DETECTED * math.sqrt(variance)


def _smallest_ramp(given: Circumstances) -> Condition:
    """A ramp slower than the gyro bias is known is a gyro bias, for any observer."""
    bias, slowest, floor = given.gyro_bias.value, given.fault_growth.value, smallest_ramp(given)
    text = f"{bias / DEG:.3g} deg/s, the gyro bias that this observer takes for zero; "
    text += f"{floor / DEG:.3g} deg/s for the best observer after {HEALTHY_TIME:.0f} healthy seconds (T18); "
    text += "no fault grows here" if math.isinf(slowest) else f"slowest here {slowest / DEG:.3g} deg/s"
    numbers = {"ramp": bias, "best": floor, "slowest_fault": None if math.isinf(slowest) else slowest}
    outcome = Verdict.PASS if slowest > bias else Verdict.DEPENDS
    return Condition("smallest detectable ramp", outcome, text, numbers, needed=False)
