"""Where the other fault observers hold: supervised, augmented_kalman, edwards_spurgeon, threshold, none."""

from __future__ import annotations

import math
from collections.abc import Iterator

from quadftc_fdi.fault_observer import MAX_PITCH
from quadftc_fdi.fault_observers.augmented_kalman import AugmentedKalman
from quadftc_fdi.fault_observers.edwards_spurgeon import EdwardsSpurgeon
from quadftc_fdi.fault_observers.none import NoDiagnosis
from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_fdi.fault_observers.threshold import Threshold
from quadftc_theory.conditions import DEG, Circumstances, Condition, Verdict, conditions_of, verdict
from quadftc_theory.sliding_mode_conditions import NEGLIGIBLE_DRIFT, NEGLIGIBLE_LEAK


@conditions_of(NoDiagnosis)
def no_diagnosis_conditions(observer: NoDiagnosis, given: Circumstances) -> Iterator[Condition]:
    """Say what an undiagnosed fault does: the attitude settles where the sensor reads the reference."""
    size = math.degrees(given.fault.value)
    text = f"none: the attitude follows a fault f to -f; here up to {size:.3g} deg ({given.fault.origin})"
    outcome = Verdict.DEPENDS if size > 0.0 else Verdict.PASS
    yield Condition("fault tolerance", outcome, text, {"fault": given.fault.value}, needed=False)


@conditions_of(Supervised)
def supervised_conditions(observer: Supervised, given: Circumstances) -> Iterator[Condition]:
    """Judge what it asks for: a gyro without faults, and no attitude fault at the first sample."""
    yield _faultless_gyro(given, "the scenario puts a fault on it", "its bias, scale and delay are estimated")
    text = "a fault that is there at the first sample is taken for the attitude"
    yield Condition("healthy start", Verdict.DEPENDS, text, needed=False)


@conditions_of(AugmentedKalman)
def augmented_kalman_conditions(observer: AugmentedKalman, given: Circumstances) -> Iterator[Condition]:
    """Judge the filter's noise model against the noise given; the start and the zeros at s = 0."""
    yield _faultless_gyro(given)
    attitude, walk, bias = given.attitude_noise.value, given.gyro_noise.value, given.gyro_bias.value
    within = attitude <= observer.attitude_noise and walk <= observer.gyro_noise
    text = (
        f"attitude {attitude / DEG:.3g} of {observer.attitude_noise / DEG:.3g} deg, angle random walk "
        f"{walk / DEG:.3g} of {observer.gyro_noise / DEG:.3g} deg/sqrt(s), gyro bias up to "
        f"{bias / DEG:.3g} of 2 x {observer.gyro_bias / DEG:.3g} deg/s; attitude errors must be white"
    )
    covered = verdict(within and bias <= 2.0 * observer.gyro_bias)
    yield Condition("noise within the filter's model", covered, text)
    floor = walk * math.sqrt(given.duration)
    text = (
        "the fault must be 0 at the first sample: the zeros at s = 0 keep what is wrong then; the angle "
        f"random walk adds {floor / DEG:.3g} deg in {given.duration:.3g} s"
    )
    yield Condition("healthy start", Verdict.DEPENDS, text, {"floor": floor}, needed=False)
    yield _pitch(given)


@conditions_of(EdwardsSpurgeon)
def edwards_spurgeon_conditions(observer: EdwardsSpurgeon, given: Circumstances) -> Iterator[Condition]:
    """Judge the reach of nu, and what the zeros at s = 0 do: leak and drift."""
    size, length, duration = given.fault.value, given.fault_length.value, given.duration
    leak, bias, reach = observer.leak, given.gyro_bias.value, observer.rho / observer.a_f
    yield _faultless_gyro(given)
    text = f"e: -{observer.a_s:.3g} 1/s; angle error on the surface: -{leak:.3g} 1/s"
    yield Condition("observer's poles", verdict(leak > 0.0), text, {"poles": [-observer.a_s, -leak]})
    text = f"reaches {reach / DEG:.3g} deg; |f_s| up to {size / DEG:.3g} deg ({given.fault.origin})"
    holds = verdict(observer.rho > observer.a_f * size)
    yield Condition("rho > a_f |f_s|", holds, text, {"reach": reach, "fault": size})
    share = -math.expm1(-leak * length)
    text = f"of a constant fault of {length:.3g} s, {100.0 * share:.2g} % leak away"
    leaks = Verdict.PASS if share <= NEGLIGIBLE_LEAK else Verdict.DEPENDS
    yield Condition("leak of the fault estimate", leaks, text, {"share": share}, needed=False)
    each = -math.expm1(-leak * duration) / leak if leak > 0.0 else duration
    error = each * bias
    text = f"{error / DEG:.3g} deg after {duration:.3g} s with {bias / DEG:.3g} deg/s"
    numbers = {"per_bias": each, "error": error}
    yield Condition("drift by a gyro bias", verdict(error <= NEGLIGIBLE_DRIFT), text, numbers)
    yield _pitch(given)


@conditions_of(Threshold)
def threshold_conditions(observer: Threshold, given: Circumstances) -> Iterator[Condition]:
    """Say whether the faults given are above the thresholds, and how far the dead reckoning drifts."""
    size, growth, bias = given.fault.value, given.fault_growth.value, given.gyro_bias.value
    yield _faultless_gyro(given)
    found = size > observer.angle_threshold and growth > observer.rate_threshold
    slowest = "" if math.isinf(growth) else f", slowest {growth / DEG:.3g} deg/s"
    text = (
        f"finds a step or ramp of more than {observer.angle_threshold / DEG:.3g} deg, faster than "
        f"{observer.rate_threshold / DEG:.3g} deg/s; here up to {size / DEG:.3g} deg{slowest}"
    )
    outcome = verdict(found or size == 0.0)
    yield Condition("faults above the thresholds", outcome, text, {"fault": size}, needed=False)
    text, below = f"{bias / DEG:.3g} deg/s; above it, every axis is faulty", bias < observer.rate_threshold
    yield Condition("gyro bias below rate_threshold", verdict(below), text, {"gyro_bias": bias})
    drift = bias * min(given.fault_length.value, observer.patience)
    within = verdict(drift < observer.recovery_angle)
    text = (
        f"the residual has drifted by {drift / DEG:.3g} deg at the end of the longest fault; recovers "
        f"below {observer.recovery_angle / DEG:.3g} deg, else after {observer.patience:.3g} s"
    )
    yield Condition("recovery within recovery_angle", within, text, {"drift": drift}, needed=False)
    yield _pitch(given)


def _faultless_gyro(
    given: Circumstances,
    if_faulty: str = "a fault on it is taken for a fault of the attitude",
    otherwise: str = "no fault on it",
) -> Condition:
    faulty = "gyro" in given.faulty_channels
    return Condition("gyro without fault", verdict(not faulty), if_faulty if faulty else otherwise)


def _pitch(given: Circumstances) -> Condition:
    steep = given.tilt.value + given.fault.value
    text = f"up to {steep / DEG:.3g} deg with the fault; beyond {MAX_PITCH / DEG:.3g} deg it dead-reckons"
    outcome = Verdict.PASS if steep < MAX_PITCH else Verdict.DEPENDS
    return Condition("pitch away from 90 deg", outcome, text, {"tilt": steep}, needed=False)
