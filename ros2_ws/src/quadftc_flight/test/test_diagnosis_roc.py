"""Receiver operating characteristics with known answers."""

import dataclasses
from statistics import NormalDist

import numpy as np
import pytest

from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_flight.diagnosis_metrics.roc import (
    Roc,
    detection_scores,
    estimate_over_std_dev,
    estimate_size,
    roc,
)
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import VECTORS, Flight, unknown_flight
from quadftc_model.samples import HEALTHY

NORMAL = NormalDist()
ROLL = FaultEvent("roll", "step", 10.0, 20.0)


def still() -> Flight:
    """30 s at 10 Hz, nothing estimated."""
    flight = unknown_flight(np.arange(1, 301) * 100_000_000)
    columns = {name: np.zeros((300, 3)) for name in VECTORS}
    return dataclasses.replace(flight, fault_state=np.full((300, 3), HEALTHY, np.uint8), **columns)


def faulty() -> Flight:
    flight = still()
    fault = np.zeros((300, 3))
    fault[100:200, 0] = 0.02
    return dataclasses.replace(flight, fault=fault)


def probability_at(curve: Roc, false_alarm_share: float) -> float:
    """The largest detection probability at no more than a share of false alarms."""
    last = int(np.searchsorted(curve.false_alarm_share, false_alarm_share, side="right")) - 1
    return float(curve.detection_probability[max(last, 0)])


def detection_roc(flight: Flight, within: float) -> Roc:
    """The curve of the size of the estimate: healthy samples against faults found within a delay."""
    healthy, highest = detection_scores(flight, [ROLL], estimate_size, within)
    labels = np.arange(len(healthy) + len(highest)) >= len(healthy)
    return roc(np.concatenate([healthy, highest]), labels)


def test_curve_of_two_gaussians_is_the_one_of_theory():
    rng = np.random.default_rng(1)
    distance, count = 1.5, 20_000
    labels = rng.random(2 * count) < 0.5
    curve = roc(rng.standard_normal(2 * count) + distance * labels, labels)
    assert curve.area == pytest.approx(NORMAL.cdf(distance / 2**0.5), abs=0.01)
    for share in (0.01, 0.1, 0.5):
        expected = NORMAL.cdf(distance + NORMAL.inv_cdf(share))
        assert probability_at(curve, share) == pytest.approx(expected, abs=0.02)


def test_score_that_separates_has_area_one_and_guessing_one_half():
    perfect = roc([0.1, 0.2, 0.9, 1.0], [False, False, True, True])
    assert (perfect.area, probability_at(perfect, 0.0)) == (1.0, 1.0)
    assert roc([0.3, 0.3, 0.3, 0.3], [False, True, False, True]).area == 0.5
    assert roc([0.9, 0.1], [False, True]).area == 0.0


@pytest.mark.parametrize(
    ("score", "labels", "message"),
    [
        ([1.0, np.nan], [True, False], "NaN"),
        ([1.0, 2.0], [True, True], "no healthy score among 2"),
        ([1.0, 2.0], [False, False], "no faulty score among 2"),
        ([], [], "no faulty score among 0"),
        ([1.0, 2.0], [True, False, True], "inconsistent"),
    ],
)
def test_scores_that_give_no_curve_are_refused(score, labels, message):
    with pytest.raises(ValueError, match=message):
        roc(score, labels)


def test_fault_counts_as_found_by_its_largest_score_within_the_delay():
    flight = faulty()
    estimate = np.zeros((300, 3))
    estimate[:, 1] = 0.005  # always wrong by this much
    estimate[120:200, 0] = 0.02  # 2 s after the onset
    flight = dataclasses.replace(flight, fault_estimate=estimate)
    in_time = detection_roc(flight, within=2.5)
    assert (in_time.area, probability_at(in_time, 0.0)) == (1.0, 1.0)
    too_late = detection_roc(flight, within=1.0)
    assert probability_at(too_late, 0.0) == 0.0
    assert too_late.area < 0.5


def test_healthy_is_what_is_outside_faults_and_their_grace():
    flight = faulty()
    after = np.zeros((300, 3))
    after[150:160, 0] = 0.02
    after[200 : 200 + round(10 * GRACE_TIME), 0] = -0.02  # let go within the grace
    score = dataclasses.replace(flight, fault_estimate=after)
    assert probability_at(detection_roc(score, within=9.0), 0.0) == 1.0


def test_score_is_the_estimate_over_the_deviation_that_is_given():
    flight = faulty()
    std_dev = np.full((300, 3), 0.01)
    std_dev[:, 2] = -1.0  # none on yaw
    estimate = np.full((300, 3), -0.03)
    score = estimate_over_std_dev(dataclasses.replace(flight, fault_estimate=estimate, fault_std_dev=std_dev))
    np.testing.assert_allclose(score[:, :2], 3.0)
    assert np.isnan(score[:, 2]).all()


def test_fault_of_size_zero_is_no_fault_to_be_found():
    with pytest.raises(ValueError, match="no faulty score"):
        detection_roc(still(), within=1.0)
