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
from quadftc_theory.conditions import DEG, Circumstances, Condition, advise, assess, conditions_of
from quadftc_theory.sliding_mode_conditions import NEGLIGIBLE_DRIFT, NEGLIGIBLE_LEAK


@conditions_of(NoDiagnosis)
def no_diagnosis_conditions(observer: NoDiagnosis, given: Circumstances) -> Iterator[Condition]:
    """Say what an undiagnosed fault does: the attitude settles where the sensor reads the reference."""
    size = given.fault.value
    here = f"here up to {size / DEG:.3g} deg ({given.fault.origin})"
    text = f"none: the attitude follows a fault f to -f; {here}"
    yield advise("fault tolerance", size <= 0.0, text, fault=size)


@conditions_of(Supervised)
def supervised_conditions(observer: Supervised, given: Circumstances) -> Iterator[Condition]:
    """Judge what it asks for: a gyro without faults, and no attitude fault at the first sample."""
    yield _faultless_gyro(given, "the scenario puts a fault on it", "its bias, scale and delay are estimated")
    text = "a fault that is there at the first sample is taken for the attitude"
    yield advise("healthy start", False, text)


@conditions_of(AugmentedKalman)
def augmented_kalman_conditions(observer: AugmentedKalman, given: Circumstances) -> Iterator[Condition]:
    """Judge the filter's noise model against the noise given; the start and the zeros at s = 0."""
    yield _faultless_gyro(given)
    attitude, walk, bias = given.attitude_noise.value, given.gyro_noise.value, given.gyro_bias.value
    text = (
        f"attitude {attitude / DEG:.3g} of {observer.attitude_noise / DEG:.3g} deg, angle random walk "
        f"{walk / DEG:.3g} of {observer.gyro_noise / DEG:.3g} deg/sqrt(s), gyro bias up to "
        f"{bias / DEG:.3g} of 2 x {observer.gyro_bias / DEG:.3g} deg/s; attitude errors must be white"
    )
    within = attitude <= observer.attitude_noise and walk <= observer.gyro_noise
    yield assess("noise within the filter's model", within and bias <= 2.0 * observer.gyro_bias, text)
    floor = walk * math.sqrt(given.duration)
    text = "the fault must be 0 at the first sample: the zeros at s = 0 keep what is wrong then; the angle "
    text += f"random walk adds {floor / DEG:.3g} deg in {given.duration:.3g} s"
    yield advise("healthy start", False, text, floor=floor)
    yield _pitch(given)


@conditions_of(EdwardsSpurgeon)
def edwards_spurgeon_conditions(observer: EdwardsSpurgeon, given: Circumstances) -> Iterator[Condition]:
    """Judge the reach of nu, and what the zeros at s = 0 do: leak and drift."""
    size, length, duration = given.fault.value, given.fault_length.value, given.duration
    leak, bias, reach = observer.leak, given.gyro_bias.value, observer.rho / observer.a_f
    yield _faultless_gyro(given)
    text = f"e: -{observer.a_s:.3g} 1/s; angle error on the surface: -{leak:.3g} 1/s"
    yield assess("observer's poles", leak > 0.0, text, poles=[-observer.a_s, -leak])
    text = f"reaches {reach / DEG:.3g} deg; |f_s| up to {size / DEG:.3g} deg ({given.fault.origin})"
    yield assess("rho > a_f |f_s|", observer.rho > observer.a_f * size, text, reach=reach, fault=size)
    share = -math.expm1(-leak * length)
    text = f"of a constant fault of {length:.3g} s, {100.0 * share:.2g} % leak away"
    yield advise("leak of the fault estimate", share <= NEGLIGIBLE_LEAK, text, share=share)
    each = -math.expm1(-leak * duration) / leak if leak > 0.0 else duration
    error = each * bias
    text = f"{error / DEG:.3g} deg after {duration:.3g} s with {bias / DEG:.3g} deg/s"
    yield assess("drift by a gyro bias", error <= NEGLIGIBLE_DRIFT, text, per_bias=each, error=error)
    yield _pitch(given)


@conditions_of(Threshold)
def threshold_conditions(observer: Threshold, given: Circumstances) -> Iterator[Condition]:
    """Say whether the faults given are above the thresholds, and how far the dead reckoning drifts."""
    size, growth, bias = given.fault.value, given.fault_growth.value, given.gyro_bias.value
    yield _faultless_gyro(given)
    slowest = "" if math.isinf(growth) else f", slowest {growth / DEG:.3g} deg/s"
    text = f"finds a step or ramp of more than {observer.angle_threshold / DEG:.3g} deg, faster than "
    text += f"{observer.rate_threshold / DEG:.3g} deg/s; here up to {size / DEG:.3g} deg{slowest}"
    found = size == 0.0 or (size > observer.angle_threshold and growth > observer.rate_threshold)
    yield assess("faults above the thresholds", found, text, needed=False, fault=size)
    text, below = f"{bias / DEG:.3g} deg/s; above it, every axis is faulty", bias < observer.rate_threshold
    yield assess("gyro bias below rate_threshold", below, text, gyro_bias=bias)
    drift = bias * min(given.fault_length.value, observer.patience)
    text = f"the residual has drifted by {drift / DEG:.3g} deg at the end of the longest fault; recovers "
    text += f"below {observer.recovery_angle / DEG:.3g} deg, else after {observer.patience:.3g} s"
    within = drift < observer.recovery_angle
    yield assess("recovery within recovery_angle", within, text, needed=False, drift=drift)
    yield _pitch(given)


def _faultless_gyro(
    given: Circumstances,
    if_faulty: str = "a fault on it is taken for a fault of the attitude",
    otherwise: str = "no fault on it",
) -> Condition:
    faulty = "gyro" in given.faulty_channels
    return assess("gyro without fault", not faulty, if_faulty if faulty else otherwise)


def _pitch(given: Circumstances) -> Condition:
    steep = given.tilt.value + given.fault.value
    text = f"up to {steep / DEG:.3g} deg with the fault; beyond {MAX_PITCH / DEG:.3g} deg it dead-reckons"
    return advise("pitch away from 90 deg", steep < MAX_PITCH, text, tilt=steep)
