"""Receiver operating characteristics with known answers."""

from statistics import NormalDist

import numpy as np
import pytest

from quadftc_flight.diagnosis_metrics.roc import Roc, roc

NORMAL = NormalDist()


def probability_at(curve: Roc, false_alarm_share: float) -> float:
    """The largest detection probability at no more than a share of false alarms."""
    last = int(np.searchsorted(curve.false_alarm_share, false_alarm_share, side="right")) - 1
    return float(curve.detection_probability[max(last, 0)])


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
