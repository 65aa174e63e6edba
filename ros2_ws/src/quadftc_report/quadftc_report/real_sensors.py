"""What the paper does not say: how a fault observer fares on sensors that are not ideal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from quadftc_flight.run_directory import RecordedRun
from quadftc_model.parameters import parameters_of
from quadftc_model.samples import AXES
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.drift import AxisDrift, Drift, measure_drift
from quadftc_report.measures import axis_metric, complete
from quadftc_report.performance import compared_text
from quadftc_report.statements import Paragraph, paragraph
from quadftc_report.wording import axes_text, each_axis, listing, period, plain, quantity, sentence, spread
from quadftc_sim.sensors import ImuSensor

TITLE = "What the paper does not say"

AGREEMENT = 0.1  # relative; a slope this close to what the bias explains is explained (ours)
NEGLIGIBLE = 0.02  # deg/s; a slope too small to be told from the noise of the attitude (ours)
_AGREE = f"{100.0 * AGREEMENT:g} %"
REACHED = 0.9  # share of the bound of the estimate from which on it counts as reached (ours)


def beyond_the_paper(comparisons: Sequence[Comparison]) -> list[Paragraph]:
    """Tell, for every run with a fault observer on sensors that are not ideal, how its estimate drifts.

    Returns
    -------
    list of Paragraph
        One for each such run, then one that says why; empty if there is no such run.
    """
    found: list[Paragraph] = []
    explained = False
    for comparison in comparisons:
        for run in comparison.runs if not comparison.ideal else ():
            if has_observer(run):
                drift = measure_drift(run)
                explained = explained or (drift is not None and bool(_explained(drift)))
                title = f"{comparison.key}, {comparison.label(run)} ({run.scheme.observer.kind})"
                sentences = _run_sentences(comparison, run, drift)
                found.append(paragraph(f"{comparison.key}-{comparison.label(run)}", title, sentences))
    if explained:
        found.append(Paragraph("why", "Why the estimate follows the gyro's bias", _WHY))
    return found


_WHY = (
    "With the attitude and the gyro as outputs, the observer's error system has three invariant zeros at s ="
    " 0: a constant error of the attitude and a constant fault look the same in every measurement.",
    "What tells them apart is the integral of the gyro from a start that counts as healthy, and that takes a"
    " bias of the gyro for motion: the fault estimate runs away at the rate of the bias.",
    "No gain mends this, as no gain moves an invariant zero; the paper's simulations have no gyro bias"
    " (docs/theory.md).",
)


def _run_sentences(comparison: Comparison, run: RecordedRun, drift: Drift | None) -> Iterator[str]:
    yield f"The sensors are not the paper's ideal ones: {sensor_text(run.scenario.sensor)}."
    if drift is None:
        yield "How the estimate drifts while the sensor is healthy cannot be told from this recording."
    else:
        yield from _drift_sentences(drift)
        yield from _end_sentences(run, drift)
    for other in comparison.runs:
        if not has_observer(other) and other.duration == run.duration:
            yield from _consequence(comparison, run, other)


def sensor_text(sensor: ImuSensor) -> str:
    """Tell the errors of an IMU: ``attitude noise of 0.1 deg, a gyro bias of up to 1 deg/s``."""
    parts: list[str] = []
    for spec in parameters_of(ImuSensor):
        value = float(getattr(sensor, spec.name))
        if value:
            angle = spec.unit.startswith("rad")
            unit = spec.unit.replace("rad", "deg", 1) if angle else spec.unit.replace("^2", "²")
            size = f"{plain(math.degrees(value) if angle else value)} {unit}".removesuffix(" 1")
            parts.append(_SENSOR_WORDS.get(spec.name, spec.name.replace("_", " ") + " {}").format(size))
    return ", ".join(parts)


_SENSOR_WORDS = {
    "attitude_noise": "attitude noise of {}",
    "gyro_noise": "a gyro angle random walk of {}",
    "gyro_bias": "a gyro bias of up to {}",
    "gyro_bias_walk": "a gyro rate random walk of {}",
    "accelerometer_noise": "accelerometer noise of {}",
    "delay": "a delay in samples of {}",
}


def _explained(drift: Drift) -> list[str]:
    """The axes whose drift is no noise, and what the bias explains."""
    return [
        axis
        for axis, found in drift.axes.items()
        if abs(found.expected) > NEGLIGIBLE
        and abs(found.slope - found.expected) <= max(AGREEMENT * abs(found.expected), NEGLIGIBLE)
    ]


def _column(drift: Drift, name: str) -> dict[str, float | None]:
    return {axis: getattr(found, name) for axis, found in drift.axes.items()}


def _drift_sentences(drift: Drift) -> Iterator[str]:
    largest = max(found.bias_error for found in drift.axes.values())
    yield sentence(
        f"{period(drift.start, drift.stop)}, before any fault, the gyro is biased by",
        each_axis(_column(drift, "bias"), "deg/s"),
        f"(mean of imu/data less plant/rate, standard error at most {quantity(largest, 'deg/s')})",
    )
    yield sentence(
        "in that time the error of the fault estimate changes at",
        each_axis(_column(drift, "slope"), "deg/s"),
        "(straight line, least squares),",
        f"that is {each_axis(_shares(drift, _by_bias), '')} times the bias",
    )
    explained = _explained(drift)
    expected = each_axis(_column(drift, "expected"), "deg/s")
    strong = [axis for axis, found in drift.axes.items() if abs(found.expected) > NEGLIGIBLE]
    if not strong:
        yield f"The bias is too small to make the estimate drift: it explains {expected}."
        return
    words = f"At the recorded attitudes and rates the kinematics (4) turn this bias into {expected}"
    if not explained:
        yield f"{words}; the estimate does not follow it."
        return
    shares = {axis: share for axis, share in _shares(drift, _by_expected).items() if axis in strong}
    yield f"{words}; the measured slope is {each_axis(shares, '')} times that."
    rest = [axis for axis in strong if axis not in explained]
    otherwise = f"; {axes_text(rest)} it is not" if rest else ""
    yield sentence(f"{axes_text(explained)} the drift is the gyro's bias, within {_AGREE}{otherwise}")
    turned = [axis for axis in explained if _is_turned(drift.axes[axis])]
    if turned:
        yield f"On {listing(turned)} most of it is the bias of the other axes, as the vehicle tilts."


def _by_bias(found: AxisDrift) -> float | None:
    return found.slope / found.bias if found.bias else None


def _by_expected(found: AxisDrift) -> float | None:
    return found.slope / found.expected if found.expected else None


def _shares(drift: Drift, share: Callable[[AxisDrift], float | None]) -> dict[str, float | None]:
    return {axis: share(found) for axis, found in drift.axes.items()}


def _is_turned(found: AxisDrift) -> bool:
    """Whether an axis drifts more by the others' bias than by its own."""
    return abs(found.expected + found.bias) > 0.5 * abs(found.expected)


def _end_sentences(run: RecordedRun, drift: Drift) -> Iterator[str]:
    yield sentence(
        f"at {plain(drift.stop)} s the estimate is wrong by",
        f"{each_axis(_column(drift, 'error_at_stop'), 'deg')}, at the end of the recording by",
        each_axis(_column(drift, "error_at_end"), "deg"),
    )
    law = run.scheme.observer.law
    bound = math.degrees(getattr(law, "epsilon_s", 0.0) + getattr(law, "epsilon_2", 0.0))
    norms = np.degrees(np.linalg.norm(run.flight.fault_estimate, axis=1))
    reached = float(np.nanmax(norms))
    if bound > 0.0 and reached > REACHED * bound:
        yield (
            f"It stops growing because (26) bounds the norm of the estimate by epsilon_s + epsilon_2 ="
            f" {quantity(bound, 'deg')}, of which it reaches {quantity(reached, 'deg')}."
        )


def _consequence(comparison: Comparison, run: RecordedRun, other: RecordedRun) -> Iterator[str]:
    path = "tracking_rmse_deg"
    own, without = complete(axis_metric(run, path)), complete(axis_metric(other, path))
    if own is None or without is None:
        return
    yield sentence(
        f"the vehicle tracks with an RMSE of {each_axis(own, 'deg')}, the RMSE of the estimate being",
        f"{each_axis(axis_metric(run, 'fault_estimate_rmse_deg'), 'deg')};",
        f"{comparison.title(other)}, which trusts its sensor, tracks with {spread(without, 'deg')}",
    )
    yield compared_text(comparison, run, other)
    worse = [axis for axis in AXES if own[axis] > without[axis]]
    if len(worse) == len(AXES):
        yield "Here this fault tolerance is WORSE THAN NONE on every axis."
    elif worse:
        yield f"Here this fault tolerance is worse than none {axes_text(worse)}."
    else:
        yield "Here this fault tolerance is better than none on every axis."
