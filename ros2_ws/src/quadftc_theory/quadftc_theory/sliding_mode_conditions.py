"""Where Theorem 1 of Wang, Huang and Zhang (2021) holds for the sliding-mode fault observer, and how well.

Conditions on gains: A1s and A-bar - L-bar C-bar Hurwitz, (18), (26), (28), (29); and leak, drift and smallest
ramp, which the paper leaves out. docs/theory.md derives the formulas.

Along a recorded run, the Lyapunov functions (30) against (35):

    V1 = z1~' P1 z1~,      V1' <= -2 eta_1 |P1 z1~|
    V2 = z-bar~' P-bar z-bar~,   V2' <= -2 eta_2 |P-bar z-bar~|

The observer is run again on what it was given; z1~ and z-bar~ = (z2~, z3~) are against the truth of the bag.
P-bar solves the Lyapunov equation of A-bar - L-bar C-bar with Q = I. Why V2 need not fall: docs/theory.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov  # pyright: ignore[reportUnknownVariableType]

from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_model.rotations import wrap
from quadftc_model.samples import FaultObserverInputs, ImuSample, sanitised
from quadftc_model.stepper import Stepper
from quadftc_theory import conditions
from quadftc_theory.conditions import DEG, Circumstances, Condition, Floats, Trace, advise, assess
from quadftc_theory.linear_model import attitude_model, augment, decouple, stable, structure_conditions

HEALTHY_TIME = 20.0  # s; over which a gyro bias can be averaged before a fault comes
DETECTED = 2.33 + 3.29  # 1; standard deviations: missed once in 100 times, reported falsely once in 1000
NEGLIGIBLE_LEAK = 0.01  # 1; share of a fault that may leak away unnoticed while it lasts
NEGLIGIBLE_DRIFT = 0.05 * DEG  # rad; error of the estimate that counts as none (docs/theory.md)


@conditions.conditions_of(SlidingMode)
def sliding_mode_conditions(observer: SlidingMode, given: Circumstances) -> Iterator[Condition]:
    """Judge the observer in the circumstances given."""
    yield from structure_conditions(attitude_model())
    name, bias = "(12): h1, the gyro, without fault and bias", given.gyro_bias.value
    text = f"gyro bias up to {bias / DEG:.3g} deg/s ({given.gyro_bias.origin}), no fault on the gyro"
    if "gyro" in given.faulty_channels:
        yield assess(name, False, "the scenario puts a fault on the gyro: z1 and z2 are both wrong")
    else:
        yield assess(name, bias == 0.0, text, gyro_bias=bias)

    a1, p1, eye = observer.a1, observer.p1, np.eye(3)
    residual = float(abs(observer.q1 - 2.0 * a1 * p1))
    text = f"poles at {-a1:.3g} rad/s; P1 = {p1:.3g} I solves its Lyapunov equation"
    holds = stable(-a1 * eye) and p1 > 0.0 and residual < 1e-9 * observer.q1
    yield assess("A1s Hurwitz, P1 > 0", holds, text, poles=[-a1] * 3, p1=p1, residual=residual)

    system = augment(decouple(attitude_model()))
    closed = system.A - np.vstack([observer.L1 * eye, observer.L2 * eye]) @ system.C
    poles = np.linalg.eigvals(closed)
    found = sorted({f"{pole:.3g}" if abs(pole.imag) > 1e-9 else f"{pole.real:.3g}" for pole in poles})
    text = f"poles at {', '.join(found)} rad/s (each three times)"
    yield assess("A-bar - L-bar C-bar Hurwitz", stable(closed), text, poles=conditions.pairs(poles))

    fault, bound = given.fault.value, observer.epsilon_s
    text = f"epsilon_s = {bound / DEG:.3g} deg, |f_s| up to {fault / DEG:.3g} deg ({given.fault.origin})"
    yield assess("(9), (19): epsilon_s >= |f_s|", bound >= fault, text, epsilon_s=bound, fault=fault)
    size, xi = given.disturbance.norm, observer.xi
    text = f"xi = {xi:.3g} rad/s², |Delta_d| up to {size:.3g} rad/s² ({given.disturbance.origin})"
    yield assess("(18): xi >= |Delta_d|", xi >= size, text, xi=xi, disturbance=size)

    yield from _gains(observer, given)
    yield from _leak_and_drift(observer, given)


@conditions.conditions_along_of(SlidingMode)
def lyapunov_conditions(observer: SlidingMode, trace: Trace, given: Circumstances) -> Iterator[Condition]:
    """Judge (35) at every sample of a run. Without a margin it promises nothing, and V may not rise."""
    eta_1, eta_2 = (max(eta, 0.0) for eta in gain_margins(observer, given))
    z1, z2, e3 = _errors(observer, trace)
    size_1, p1 = np.linalg.norm(z1, axis=1), observer.p1
    one_step = float(np.median(np.diff(trace.stamp_ns))) / 1e9 * (observer.xi + observer.epsilon_1)
    name, V1 = "(35): V1' <= -2 eta_1 |P1 z1~| along the run", p1 * np.sum(z1 * z1, axis=1)
    yield conditions.falls(name, V1, trace.stamp_ns, -2.0 * eta_1 * p1 * size_1, size_1 > one_step)

    # P-bar of one axis: (A-bar - L-bar C-bar)' P + P (A-bar - L-bar C-bar) = -I, the same on each
    closed = np.array([[0.0, -observer.L1], [1.0, -observer.L2]])
    P = np.asarray(solve_continuous_lyapunov(closed.T, -np.eye(2)), np.float64)
    z_bar = np.stack([z2, e3], axis=1)  # (n, 2, 3)
    P_z = np.einsum("ij,njk->nik", P, z_bar)
    size, layers = np.linalg.norm(e3, axis=1), float(np.max(np.linalg.norm(e3, axis=1))) / observer.delta
    largest = float(np.degrees(np.nanmax(np.abs(z2)))) if np.any(np.isfinite(z2)) else math.nan
    yield conditions.falls(
        "(35): V2' <= -2 eta_2 |P-bar z-bar~| along the run",
        np.sum(z_bar * P_z, axis=(1, 2)),
        trace.stamp_ns,
        required=-2.0 * eta_2 * np.sqrt(np.sum(P_z * P_z, axis=(1, 2))),
        outside=size > observer.delta,
        note=f"; |e3| up to {layers:.3g} delta, angle error up to {largest:.3g} deg",
        largest_e3=float(np.max(size)),
        largest_z2_deg=largest,
    )


def _errors(observer: SlidingMode, trace: Trace) -> tuple[Floats, Floats, Floats]:
    """z1~, z2~ and h3 - h3^ (n, 3) of every sample."""
    stepper = Stepper[FaultObserverInputs, object](observer)  # pyright: ignore[reportArgumentType]
    z1, z2, e3 = (np.full(trace.angles.shape, np.nan) for _ in range(3))
    torque, there = np.zeros(3), np.asarray(True)
    for k, stamp_ns in enumerate(trace.stamp_ns.tolist()):
        sample = sanitised(ImuSample(trace.q_xyzw[k], trace.gyro[k], np.zeros(3), there, there, there))
        if stepper.step(stamp_ns, FaultObserverInputs(sample, torque)) is None:
            continue
        z1[k] = trace.body_rate[k] - stepper.state.z1
        z2[k] = wrap(trace.angles[k] - stepper.state.z2)
        e3[k] = stepper.state.e3
        if np.all(np.isfinite(trace.torque[k])):
            torque = trace.torque[k]
    return z1, z2, e3


def leak_time_constant(observer: SlidingMode, fault: float = 0.0) -> float:
    """Time constant [s] with which the estimate of a constant fault [rad] leaks: (T8) of docs/theory.md.

    The fault stands for its estimate there, which makes up to 4 % less. The larger the fault, the faster it
    leaks; 0 is the limit of small faults, (T7). Without L1-bar nothing leaks: inf.
    """
    if observer.L1 <= 0.0:
        return math.inf
    rho = observer.epsilon_s + observer.epsilon_2
    left = 1.0 - min(fault / rho, 1.0)  # 1 - kappa
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


def gain_margins(observer: SlidingMode, given: Circumstances) -> tuple[float, float]:
    """eta_1 [rad/s²] of (28) and eta_2 [rad] of (29); a negative one: the gain is too small.

    (28): A2 = 0, and D1 f is computed from the measured rate, so nothing stands against epsilon_1.
    (29): corrected as in docs/theory.md, section 4, to epsilon_2 >= |z2~| + eta_2: what the injection has to
    hold against is the error of the angles itself, which a gyro bias builds up until the end.
    """
    return observer.epsilon_1, observer.epsilon_2 - given.gyro_bias.value * drift(observer, given.duration)


def smallest_ramp(given: Circumstances) -> float:
    """Slowest ramp [rad/s] that any observer can tell from a gyro bias, (T18) of docs/theory.md.

    The gyro bias is averaged over ``HEALTHY_TIME``, the ramp over the length of the longest fault.
    """
    if (walk := given.gyro_noise.value) == 0.0:
        return 0.0
    length = given.fault_length.value or HEALTHY_TIME
    memory = given.attitude_noise.value * math.sqrt(given.dt) / walk  # s
    variance = sum(walk**2 / span * (1.0 + 2.0 * memory / span) for span in (HEALTHY_TIME, length))
    return DETECTED * math.sqrt(variance)


def _gains(observer: SlidingMode, given: Circumstances) -> Iterator[Condition]:
    eta_1, eta_2 = gain_margins(observer, given)
    text = f"epsilon_1 = {observer.epsilon_1:.3g} rad/s² > 0: A2-bar = 0 and f comes from the measured rate, "
    text += f"so the error of the angles does not enter; eta_1 = {eta_1:.3g} rad/s²"
    yield assess("(28): epsilon_1", eta_1 > 0.0, text, eta_1=eta_1)
    error, lipschitz = given.gyro_bias.value * drift(observer, given.duration), 0.0
    if observer.kinematics == "full":
        lipschitz = kinematic_lipschitz(given.tilt.value, given.body_rate.value)
    why = "gyro bias times duration" if error > 0.0 else "healthy start, no gyro bias"
    text = (
        f"epsilon_2 = {observer.epsilon_2 / DEG:.3g} deg, |z2~| up to {error / DEG:.3g} deg (assumed: "
        f"{why}); as printed, (29) would ask for L_f |z-bar~| = {lipschitz * error / DEG:.3g} deg, L_f = "
        f"{lipschitz:.3g} 1/s at tilts up to {given.tilt.value / DEG:.3g} deg and rates up to "
        f"{given.body_rate.value / DEG:.3g} deg/s ({given.tilt.origin})"
    )
    numbers: dict[str, Any] = {"epsilon_2": observer.epsilon_2, "eta_2": eta_2, "lipschitz": lipschitz}
    yield assess("(29), corrected: epsilon_2 > |z2~|", eta_2 > 0.0, text, **numbers, state_error=error)


def _leak_and_drift(observer: SlidingMode, given: Circumstances) -> Iterator[Condition]:
    fault, length = given.fault.value, given.fault_length.value
    small, large = leak_time_constant(observer), leak_time_constant(observer, fault)
    share = -math.expm1(-length / large) if large > 0.0 else 1.0
    text = (
        f"time constant {small:.4g} s = (L2 + (epsilon_s + epsilon_2)/delta)/L1 for small faults, "
        f"{large:.4g} s at {fault / DEG:.3g} deg: of a constant fault of {length:.3g} s, "
        f"{100.0 * share:.2g} % leak away"
    )
    numbers: dict[str, Any] = {"time_constant": small, "time_constant_at_fault": large, "share": share}
    yield advise("leak of the fault estimate", share <= NEGLIGIBLE_LEAK, text, **numbers)

    each, bias = drift(observer, given.duration), given.gyro_bias.value
    error = each * bias
    text = f"{each:.3g} deg after {given.duration:.3g} s for each deg/s of gyro bias; up to "
    text += f"{error / DEG:.3g} deg with {bias / DEG:.3g} deg/s"
    yield assess("drift by a gyro bias", error <= NEGLIGIBLE_DRIFT, text, per_bias=each, error=error)

    # a ramp slower than the gyro bias is known is a gyro bias, for any observer
    slowest, floor = given.fault_growth.value, smallest_ramp(given)
    text = f"{bias / DEG:.3g} deg/s, the gyro bias that this observer takes for zero; "
    text += f"{floor / DEG:.3g} deg/s for the best observer after {HEALTHY_TIME:.0f} healthy seconds (T18); "
    text += "no fault grows here" if math.isinf(slowest) else f"slowest here {slowest / DEG:.3g} deg/s"
    known = None if math.isinf(slowest) else slowest
    yield advise("smallest detectable ramp", slowest > bias, text, ramp=bias, best=floor, slowest_fault=known)
