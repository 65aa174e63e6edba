"""Where the other fault observers hold: supervised, threshold, none."""

from __future__ import annotations

import math
from collections.abc import Iterator

from quadftc_fdi.fault_observer import MAX_PITCH
from quadftc_fdi.fault_observers.none import NoDiagnosis
from quadftc_fdi.fault_observers.supervised import Supervised
from quadftc_fdi.fault_observers.threshold import Threshold
from quadftc_theory.conditions import DEG, Circumstances, Condition, advise, assess, conditions_of


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
    yield faultless_gyro(given, "the scenario puts a fault on it", "its bias, scale and delay are estimated")
    text = "a fault that is there at the first sample is taken for the attitude"
    yield advise("healthy start", False, text)


@conditions_of(Threshold)
def threshold_conditions(observer: Threshold, given: Circumstances) -> Iterator[Condition]:
    """Say whether the faults given are above the thresholds, and how far the dead reckoning drifts."""
    size, growth, bias = given.fault.value, given.fault_growth.value, given.gyro_bias.value
    yield faultless_gyro(given)
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
    yield gentle_pitch(given)


def faultless_gyro(
    given: Circumstances,
    if_faulty: str = "a fault on it is taken for a fault of the attitude",
    otherwise: str = "no fault on it",
) -> Condition:
    """Judge whether the gyro, by which an observer holds the attitude, is without a fault."""
    faulty = "gyro" in given.faulty_channels
    return assess("gyro without fault", not faulty, if_faulty if faulty else otherwise)


def gentle_pitch(given: Circumstances) -> Condition:
    """Say how steep the vehicle gets, beyond which an observer that compares Euler angles dead-reckons."""
    steep = given.tilt.value + given.fault.value
    text = f"up to {steep / DEG:.3g} deg with the fault; beyond {MAX_PITCH / DEG:.3g} deg it dead-reckons"
    return advise("pitch away from 90 deg", steep < MAX_PITCH, text, tilt=steep)
