"""Where `augmented_kalman` and `edwards_spurgeon` hold, for ``quadftc check``."""

from __future__ import annotations

import math
from collections.abc import Iterator

from published_observers.augmented_kalman import AugmentedKalman
from published_observers.edwards_spurgeon import EdwardsSpurgeon
from quadftc_theory.baseline_conditions import faultless_gyro, gentle_pitch
from quadftc_theory.conditions import DEG, Circumstances, Condition, advise, assess, conditions_of
from quadftc_theory.sliding_mode_conditions import NEGLIGIBLE_DRIFT, NEGLIGIBLE_LEAK


@conditions_of(AugmentedKalman)
def augmented_kalman_conditions(observer: AugmentedKalman, given: Circumstances) -> Iterator[Condition]:
    """Judge the filter's noise model against the noise given; the start and the zeros at s = 0."""
    yield faultless_gyro(given)
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
    yield gentle_pitch(given)


@conditions_of(EdwardsSpurgeon)
def edwards_spurgeon_conditions(observer: EdwardsSpurgeon, given: Circumstances) -> Iterator[Condition]:
    """Judge the reach of nu, and what the zeros at s = 0 do: leak and drift."""
    size, length, duration = given.fault.value, given.fault_length.value, given.duration
    leak, bias, reach = observer.leak, given.gyro_bias.value, observer.rho / observer.a_f
    yield faultless_gyro(given)
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
    yield gentle_pitch(given)
