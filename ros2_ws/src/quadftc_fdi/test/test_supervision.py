"""The parts of the observer supervised, each by itself: anchors, residual tests, tracked fault, recovery."""

import math

import numpy as np
import pytest

from quadftc_fdi.supervision.anchors import (
    YOUNG,
    compare_anchors,
    go_back_to_anchor,
    set_anchors,
    update_anchors,
)
from quadftc_fdi.supervision.fault_track import (
    GRADUAL,
    clear_healthy,
    judge_recovery,
    start_track,
    track_fault,
    track_variance,
    tracker_gains,
)
from quadftc_fdi.supervision.inertial_filter import (
    correct,
    predict,
    start_filter,
)
from quadftc_fdi.supervision.measurement import predict_angles
from quadftc_fdi.supervision.residual_tests import (
    ResidualVariances,
    averaging_weights,
    collect_evidence,
    declare_faults,
    healthy_spread,
    start_evidence,
    update_evidence,
)
from quadftc_fdi.supervision.transition import ProcessNoise

DEG, DT = math.pi / 180.0, 0.004
ZEROS, EVERY, NONE = np.zeros(3), np.ones(3, bool), np.zeros(3, bool)
YES, NO = np.array([True]), np.array([False])
SIGMA = 0.1 * DEG  # of a healthy residual, white
VARIANCES = ResidualVariances(np.full(3, SIGMA**2), ZEROS, np.zeros((3, 3)))
THRESHOLD, LEARNING, RECOVERY, PATIENCE = 5.5, 200.0, 0.6, 20.0
ROLL = np.array([1.0, 0.0, 0.0])


class Flown:
    """A filter that corrects, its anchors, and a twin that has run on the gyro alone since they were set."""

    def __init__(self, seconds, seed=2):
        rng = np.random.default_rng(seed)
        std_devs = np.concatenate([[SIGMA] * 3, [1.0 * DEG] * 3, [0.01] * 9, [0.01]])
        self.filter = self.twin = start_filter(np.array([0.0, 0.0, 0.0, 1.0]), std_devs)
        self.anchors = set_anchors(self.filter.P)
        noise = ProcessNoise(np.array([1e-9]), np.array([0.0]))
        for _ in range(round(seconds / DT)):
            self.gyro = 0.2 * rng.standard_normal(3)
            self.filter, P, F = predict(self.filter, self.anchors.P, self.gyro, ZEROS, noise, DT)
            self.anchors = self.anchors._replace(corrections=F.of(self.anchors.corrections), P=P)
            self.twin, _, _ = predict(self.twin, P, self.gyro, ZEROS, noise, DT)
            self.prediction = predict_angles(self.filter, self.gyro)
            residual = 0.2 * SIGMA * rng.standard_normal(3)
            self.filter, dx = correct(self.filter, self.prediction, residual, np.full(3, SIGMA**2), EVERY)
            self.anchors, _ = update_anchors(self.anchors, self.filter.P, dx, NO, NO, DT, 1e9)
        self.prediction = predict_angles(self.filter, self.gyro)
        self.residuals, self.variances = compare_anchors(self.anchors, self.prediction, ZEROS)

    def go_back(self, back, known=1.0):
        return go_back_to_anchor(
            self.filter, self.prediction, self.anchors, self.residuals, back, NONE, known
        )


def test_an_anchor_is_where_the_filter_would_be_on_the_gyro_alone():
    flown = Flown(0.4)
    off = flown.prediction.angles - predict_angles(flown.twin, flown.gyro).angles
    np.testing.assert_allclose(flown.residuals[:, YOUNG], off, rtol=0.0, atol=0.02 * np.max(np.abs(off)))
    back, prediction, residual = flown.go_back(EVERY)
    np.testing.assert_allclose(back.q_xyzw, flown.twin.q_xyzw, atol=0.02 * np.max(np.abs(off)))
    np.testing.assert_array_equal(back.P, flown.anchors.P[1])
    np.testing.assert_allclose(np.diag(back.P), np.diag(flown.twin.P), rtol=1e-3)
    np.testing.assert_array_equal(residual, flown.residuals[:, YOUNG])
    np.testing.assert_allclose(np.diag(prediction.HPH), flown.variances[:, 2])
    assert np.all(flown.variances[:, 2] > flown.variances[:, 0])


def test_the_filter_stays_if_no_axis_asks_or_if_the_anchor_does_not_know_the_gyro():
    flown = Flown(0.4)
    assert flown.go_back(NONE)[0] is flown.filter
    np.testing.assert_array_equal(flown.go_back(EVERY, known=0.0)[0].x, flown.filter.x)


def test_the_young_anchor_replaces_the_old_one_at_half_the_greatest_age_unless_held():
    flown = Flown(0.4)
    arguments = (flown.anchors, flown.filter.P, np.zeros(16), NO)
    held, promoted = update_anchors(*arguments, YES, DT, 0.5)
    assert not promoted
    after, promoted = update_anchors(*arguments, NO, DT, 0.5)
    assert promoted
    assert after.age == 0.0
    np.testing.assert_array_equal(after.P, [held.P[1], flown.filter.P])
    np.testing.assert_array_equal(after.corrections[:, 0], held.corrections[:, 1])
    np.testing.assert_array_equal(after.corrections[:, 1], 0.0)


def run_tests(residual, evidence=None, count=1, trusted=EVERY):
    """Evidence and findings after samples of the same residual of the filter (3,)."""
    evidence = start_evidence(ZEROS) if evidence is None else evidence
    residuals = np.stack([residual] * 3 + [ZEROS] * 2, axis=-1)
    weights = averaging_weights(DT, 0.15)
    for _ in range(count):
        evidence, scores = collect_evidence(
            evidence, residuals, VARIANCES, trusted, weights, DT, THRESHOLD, LEARNING
        )
        found = declare_faults(scores, evidence.suspicion, trusted, THRESHOLD)
    return evidence, scores, found


def test_an_abrupt_fault_is_declared_in_one_sample_of_eight_or_three_of_five_standard_deviations():
    assert run_tests(8.0 * SIGMA * ROLL)[2].alarm.tolist() == [True, False, False]
    _, scores, found = run_tests(5.0 * SIGMA * ROLL, count=2)
    assert (found.alarm.any(), scores.suspect.tolist()) == (False, [True, False, False])
    _, _, found = run_tests(5.0 * SIGMA * ROLL, count=3)
    assert found.alarm[0]
    assert found.sudden[0]


def test_an_incipient_fault_is_declared_by_its_averages():
    evidence, _, found = run_tests(1.2 * SIGMA * ROLL, count=150)
    assert found.alarm.tolist() == [True, False, False]
    assert found.creeping[0]
    assert not found.sudden[0]
    assert evidence.suspicion[0] > 0.0


def test_healthy_noise_is_not_suspect_and_teaches_nothing():
    noise, evidence = np.random.default_rng(1), None
    for _ in range(2500):
        evidence, _, found = run_tests(SIGMA * noise.standard_normal(3), evidence)
        assert not found.alarm.any()
    assert np.all(evidence.learned[:, :3] < 1.1)


def test_less_evidence_is_enough_on_an_axis_when_another_is_faulty():
    weaker = np.array([0.0, 0.26 * SIGMA, 0.0])
    evidence, _, found = run_tests(weaker, count=300)
    assert not found.alarm.any()
    _, _, found = run_tests(weaker + 8.0 * SIGMA * ROLL, evidence)
    assert found.alarm.tolist() == [True, True, False]


def test_evidence_is_forgotten_on_restart_and_moves_with_the_anchors():
    evidence, _, _ = run_tests(SIGMA * ROLL, count=10)
    evidence = evidence._replace(means=evidence.means + np.arange(5.0))
    after = update_evidence(evidence, YES, np.array([False, False, True]))
    np.testing.assert_array_equal(after.means[1], [0.0, 1.0, 2.0, 4.0, 0.0])
    np.testing.assert_array_equal(after.means[2], 0.0)
    np.testing.assert_array_equal(after.sums[2], 0.0)


def tracked(residuals, jump_at=0, valid=EVERY):
    """Track of a sequence of residuals (n, 3), whose fault is declared at a sample."""
    track, gains = start_track(ZEROS), tracker_gains(DT, 0.06)
    for k, residual in enumerate(residuals):
        alarm = EVERY & (k == jump_at)
        track = track_fault(track, residual, VARIANCES, alarm, np.full(3, 0.02), valid, gains, DT)
    return track


def test_a_ramp_is_tracked_without_lag_and_a_jump_restarts_the_track():
    time = DT * np.arange(250)
    ramp = 0.5 * DEG * time[:, None] * ROLL
    track = tracked(ramp)
    np.testing.assert_allclose(track.fault, ramp[-1], atol=0.01 * DEG)
    np.testing.assert_allclose(track.slope, 0.5 * DEG * ROLL, rtol=0.02, atol=1e-9)
    assert track.age[0] == pytest.approx(0.02 + time[-1])
    jumped = tracked(np.concatenate([ramp, [ramp[-1] + 2.0 * DEG]]))
    np.testing.assert_allclose(jumped.fault, ramp[-1] + 2.0 * DEG, atol=1e-12)
    assert jumped.moved.tolist() == [1.0] * 3


def test_the_variance_of_the_tracked_fault_is_that_of_its_noise():
    noise = SIGMA * np.random.default_rng(4).standard_normal((40, 1000, 3))
    track = tracked(noise.transpose(1, 0, 2), jump_at=-1, valid=EVERY)
    said = track_variance(track, VARIANCES, tracker_gains(DT, 0.06))
    assert np.mean(track.fault**2) == pytest.approx(float(np.mean(said)), rel=0.25)


def test_the_track_of_a_healthy_axis_is_zero():
    track = clear_healthy(tracked(np.full((50, 3), DEG)), np.array([True, False, True]))
    assert track.fault[0] > 0.0
    assert all(np.all(np.asarray(part)[1] == 0.0) for part in track)


def seconds_to_trust(fault, moved=1.0, longest=30.0):
    """How long a fault [rad] that stands still lasts (inf: for ever), and whether it outlasted us."""
    track = start_track(ZEROS)._replace(fault=fault * ROLL, moved=np.full(3, moved))
    track = track._replace(means=np.stack([track.fault] * 2, axis=-1))
    spread = healthy_spread(VARIANCES, start_evidence(ZEROS).learned, averaging_weights(DT, 0.15))
    for k in range(round(longest / DT)):
        track = track._replace(samples=track.samples + 1.0, age=track.age + DT)
        judged = judge_recovery(
            track, EVERY, np.full(3, SIGMA**2), spread, np.zeros(1), RECOVERY, PATIENCE, DT
        )
        track = judged.track
        if judged.trusted[0]:
            return k * DT, bool(judged.outlasted[0])
    return math.inf, False


def test_a_fault_that_has_gone_is_over_after_the_recovery_time_or_longer_if_it_never_moved():
    gone, _ = seconds_to_trust(0.0)
    never_moved, _ = seconds_to_trust(0.0, moved=0.0)
    assert gone == pytest.approx(2.0 * RECOVERY, abs=0.1)  # first the averages must be known
    assert never_moved - gone == pytest.approx((GRADUAL - 1.0) * RECOVERY, abs=0.1)


def test_a_fault_that_stands_still_ends_when_patience_does():
    assert seconds_to_trust(2.0 * DEG, longest=PATIENCE - 1.0) == (math.inf, False)
    ended, outlasted = seconds_to_trust(2.0 * DEG)
    assert ended == pytest.approx(PATIENCE + RECOVERY, abs=0.1)
    assert outlasted
