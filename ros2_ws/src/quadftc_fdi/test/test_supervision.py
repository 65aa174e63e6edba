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
    SOONEST,
    clear_healthy,
    judge_recovery,
    start_track,
    track_fault,
    track_variance,
    tracker_gains,
)
from quadftc_fdi.supervision.inertial_filter import correct, predict, start_filter
from quadftc_fdi.supervision.measurement import predict_angles
from quadftc_fdi.supervision.residual_tests import (
    averaging_weights,
    collect_evidence,
    declare_faults,
    start_evidence,
    update_evidence,
)
from quadftc_fdi.supervision.sensor_noise import (
    AVERAGED,
    LONG,
    MIDDLE,
    RATES,
    SAMPLE,
    at_rate,
    cautious_variances,
    learn_noise,
    rate_weights,
    settle_noise,
    start_noise,
)
from quadftc_fdi.supervision.transition import ProcessNoise

DEG, DT = math.pi / 180.0, 0.004
ZEROS, EVERY, NONE = np.zeros(3), np.ones(3, bool), np.zeros(3, bool)
YES, NO = np.array([True]), np.array([False])
SIGMA = 0.1 * DEG  # of a healthy residual, white
VARIANCES = np.tile(SIGMA**2 * DT / (2.0 * AVERAGED + DT), (3, 1))  # of white noise
THRESHOLD, RECOVERY, PATIENCE = 5.5, 0.6, 20.0
ROLL = np.array([1.0, 0.0, 0.0])
AT_REST = rate_weights(np.zeros(1))


class Flown:
    """A filter that corrects, its anchors, and a twin that has run on the gyro alone since they were set."""

    def __init__(self, seconds, seed=2):
        rng = np.random.default_rng(seed)
        std_devs = np.concatenate([[SIGMA] * 3, [1.0 * DEG] * 3, [0.01] * 9, [0.01]])
        self.filter = self.twin = start_filter(np.array([0.0, 0.0, 0.0, 1.0]), np.diag(std_devs**2))
        self.anchors = set_anchors(self.filter.P)
        noise = ProcessNoise(np.array([1e-9]), np.zeros(1), np.zeros(1))
        for _ in range(round(seconds / DT)):
            self.gyro = 0.2 * rng.standard_normal(3)
            self.filter, P, F = predict(self.filter, self.anchors.P, self.gyro, ZEROS, noise, DT)
            self.anchors = self.anchors._replace(corrections=F.of(self.anchors.corrections), P=P)
            self.twin, _, _ = predict(self.twin, P, self.gyro, ZEROS, noise, DT)
            self.prediction = predict_angles(self.filter, self.gyro)
            residual = 0.2 * SIGMA * rng.standard_normal(3)
            self.filter, dx, _ = correct(self.filter, self.prediction, residual, np.full(3, SIGMA**2), EVERY)
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
    for part, kept in zip(flown.go_back(NONE)[0], flown.filter, strict=True):
        np.testing.assert_allclose(part, kept, rtol=1e-15)
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


def run_tests(residual, evidence=None, count=1, trusted=EVERY, colour=0.0):
    """Evidence and findings after samples of the same residual of the filter (3,)."""
    evidence = start_evidence(ZEROS) if evidence is None else evidence
    residuals = np.stack([residual] * 3 + [ZEROS] * 2, axis=-1)
    weights = averaging_weights(DT)
    for _ in range(count):
        evidence, scores, _ = collect_evidence(
            evidence, residuals, VARIANCES, np.full(3, colour), trusted, weights, DT, THRESHOLD
        )
        found = declare_faults(scores, evidence.suspicion, trusted, THRESHOLD)
    return evidence, scores, found


@pytest.mark.parametrize("size", [5.0, 30.0])
def test_an_abrupt_fault_is_declared_in_three_samples_but_not_in_two(size):
    _, scores, found = run_tests(size * SIGMA * ROLL, count=2)
    assert (found.alarm.any(), scores.suspect.tolist()) == (False, [True, False, False])
    _, _, found = run_tests(size * SIGMA * ROLL, count=3)
    assert found.alarm.tolist() == [True, False, False]
    assert found.sudden[0]


def test_a_single_bad_sample_is_an_outlier_and_forgotten():
    evidence, scores, found = run_tests(10.0 * SIGMA * ROLL)
    assert (scores.outlier.tolist(), found.alarm.any()) == ([True, False, False], False)
    evidence, scores, found = run_tests(ZEROS, evidence)
    assert not np.any([scores.outlier, scores.suspect, found.alarm])


def test_an_incipient_fault_is_declared_by_its_averages():
    evidence, _, found = run_tests(1.2 * SIGMA * ROLL, count=150)
    assert found.alarm.tolist() == [True, False, False]
    assert found.creeping[0]
    assert not found.sudden[0]
    assert evidence.suspicion[0] > 0.0


def test_an_excursion_of_a_sensor_that_errs_slowly_is_no_abrupt_fault_but_a_jump_is():
    slow = 4.0 * SIGMA * ROLL
    evidence = start_evidence(ZEROS)
    for share in np.linspace(0.0, 1.0, 100):
        evidence, _, found = run_tests(share * slow, evidence, colour=1.0)
        assert not found.abrupt.any()
    assert run_tests(slow + 5.0 * SIGMA * ROLL, evidence, count=3, colour=1.0)[2].abrupt[0]


def test_noise_is_interpolated_between_body_rates():
    np.testing.assert_array_equal(rate_weights(np.zeros(1)), [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(rate_weights(np.array([100.0])), [0.0, 0.0, 0.0, 1.0])
    middle = math.sqrt(RATES[1] * RATES[2])
    np.testing.assert_allclose(rate_weights(np.array([middle])), [0.0, 0.5, 0.5, 0.0], atol=1e-12)


def test_healthy_noise_is_not_suspect():
    noise, evidence = np.random.default_rng(1), None
    for _ in range(2500):
        evidence, _, found = run_tests(SIGMA * noise.standard_normal(3), evidence)
        assert not found.alarm.any()


def learn(std_dev, seconds=20.0, rate=0.0, correlated=0.0, noise=None, seed=5):
    """What is learned of residuals with a white and a slow part, std dev [rad], here of no filter."""
    generator, slow, means = np.random.default_rng(seed), np.zeros(3), np.zeros((3, 6))
    noise, keep = start_noise(ZEROS) if noise is None else noise, math.exp(-DT / 0.3)
    weights = rate_weights(np.array([rate]))
    for k in range(round(seconds / DT)):
        slow = keep * slow + math.sqrt(1.0 - keep**2) * correlated * generator.standard_normal(3)
        residual = (std_dev * generator.standard_normal(3) + slow)[:, None]
        means = means + DT / (AVERAGED + DT) * (residual - means)
        noise = learn_noise(noise, means**2, np.ones(3), np.zeros((3, 6)), weights, EVERY, DT)
        noise = settle_noise(noise, YES & (k % 750 == 749), NO, NONE, weights)
    return noise


def test_the_noise_of_the_sensor_is_learned_downwards_and_upwards():
    quiet = learn(0.02 * DEG)
    sigma = np.sqrt(at_rate(quiet.known, AT_REST))[:, SAMPLE]
    np.testing.assert_allclose(sigma, 0.02 * DEG, rtol=0.25)
    worse = learn(0.3 * DEG, seconds=60.0, noise=quiet)
    sigma = np.sqrt(at_rate(worse.known, AT_REST))[:, SAMPLE]
    np.testing.assert_allclose(sigma, 0.3 * DEG, rtol=0.25)


def test_what_is_learned_at_rest_says_nothing_of_motion():
    learned = learn(0.02 * DEG)
    np.testing.assert_array_equal(learned.known[..., 1:], start_noise(ZEROS).known[..., 1:])


def test_a_sensor_that_errs_slowly_keeps_the_caution_of_the_prior_and_a_white_one_does_not():
    prior = start_noise(ZEROS).known[0, LONG, 0]
    white = at_rate(learn(0.1 * DEG).known, AT_REST)
    np.testing.assert_array_equal(cautious_variances(white, AT_REST, DT), white)
    slow = at_rate(learn(0.03 * DEG, correlated=0.03 * DEG).known, AT_REST)
    assert np.all(slow[:, LONG] < prior)
    np.testing.assert_array_equal(cautious_variances(slow, AT_REST, DT)[:, LONG], prior)


def test_what_was_learned_since_the_young_anchor_is_given_up_with_an_alarm_and_a_false_one_teaches():
    before = learn(0.1 * DEG)
    news = before._replace(learned=before.learned * 3.0)
    kept = settle_noise(news, NO, YES, NONE, AT_REST)
    np.testing.assert_array_equal(kept.learned, before.known)
    wiser = settle_noise(kept, NO, NO, np.array([True, False, False]), AT_REST)
    np.testing.assert_array_equal(wiser.known[0, :, 0], 2.0 * before.known[0, :, 0])
    np.testing.assert_array_equal(wiser.known[1:], before.known[1:])


def test_less_evidence_is_enough_on_an_axis_when_another_is_faulty():
    weaker = np.array([0.0, 0.26 * SIGMA, 0.0])
    evidence, _, found = run_tests(weaker, count=300)
    assert not found.alarm.any()
    _, _, found = run_tests(weaker + 8.0 * SIGMA * ROLL, evidence, count=3)
    assert found.alarm.tolist() == [True, True, False]


def test_evidence_is_forgotten_on_restart_and_moves_with_the_anchors():
    evidence, _, _ = run_tests(SIGMA * ROLL, count=10)
    evidence = evidence._replace(means=evidence.means + np.arange(5.0))
    after = update_evidence(evidence, ZEROS, YES, np.array([False, False, True]))
    np.testing.assert_array_equal(after.means[1], [0.0, 1.0, 2.0, 4.0, 0.0])
    np.testing.assert_array_equal(after.means[2], 0.0)
    np.testing.assert_array_equal(after.sums[2], 0.0)


def tracked(residuals, jump_at=0, valid=EVERY):
    """Track of a sequence of residuals (n, 3), whose fault is declared at a sample."""
    track, gains = start_track(ZEROS), tracker_gains(DT, 0.06)
    for k, residual in enumerate(residuals):
        alarm = EVERY & (k == jump_at)
        track = track_fault(
            track, residual, VARIANCES, ZEROS, alarm, alarm, np.full(3, 0.02), valid, gains, DT
        )
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
    assert jumped.still.tolist() == [0.0] * 3


def test_the_variance_of_the_tracked_fault_is_that_of_its_noise():
    noise = SIGMA * np.random.default_rng(4).standard_normal((40, 1000, 3))
    track = tracked(noise.transpose(1, 0, 2), jump_at=-1, valid=EVERY)
    said = track_variance(track, VARIANCES)
    assert 0.4 < np.mean(track.fault**2) / np.mean(said) < 2.5


def test_the_track_of_a_healthy_axis_is_zero():
    track = clear_healthy(tracked(np.full((50, 3), DEG)), np.array([True, False, True]))
    assert track.fault[0] > 0.0
    assert all(np.all(np.asarray(part)[1] == 0.0) for part in track)


class Recovering:
    """The track of roll through levels of its residual [rad], declared abruptly or not."""

    def __init__(self, abrupt=True, predicted=SIGMA):
        self.track, self.gains = start_track(ZEROS), tracker_gains(DT, 0.06)
        self.alarm, self.abrupt, self.predicted = ROLL > 0.0, abrupt, predicted
        self.noise = np.random.default_rng(6)

    def seconds_to_trust(self, level, seconds, measured=True):
        """How long it takes (inf: longer than asked), and whether the fault outlasted our patience."""
        for k in range(round(seconds / DT)):
            residual = level * ROLL + SIGMA * self.noise.standard_normal(3)
            self.track = track_fault(
                *(self.track, residual, VARIANCES, ZEROS, self.alarm, EVERY & self.abrupt),
                *(ZEROS, EVERY & measured, self.gains, DT),
            )
            self.alarm = NONE
            judged = judge_recovery(
                self.track,
                ROLL > 0.0,
                np.full(3, self.predicted**2),
                VARIANCES,
                VARIANCES[:, MIDDLE],
                np.zeros(1),
                EVERY & measured,
                np.ones(3),
                RECOVERY,
                PATIENCE,
                DT,
            )
            self.track = judged.track
            if judged.trusted[0]:
                return k * DT, bool(judged.outlasted[0])
        return math.inf, False


@pytest.mark.parametrize(("lasted", "longest"), [(0.02, 0.3), (0.5, 0.4), (3.0, 0.9)])
def test_a_fault_that_jumps_back_is_over_the_sooner_the_shorter_it_was(lasted, longest):
    flown = Recovering()
    assert flown.seconds_to_trust(2.0 * DEG, lasted) == (math.inf, False)
    ended, outlasted = flown.seconds_to_trust(0.0, 5.0)
    assert SOONEST - 2.0 * DT < ended < longest
    assert not outlasted


def test_an_axis_that_is_not_measured_is_not_trusted_again():
    flown = Recovering()
    assert flown.seconds_to_trust(2.0 * DEG, 0.5) == (math.inf, False)
    assert flown.seconds_to_trust(0.0, 0.1) == (math.inf, False)
    flown.predicted = 10.0 * DEG  # what is not measured for long agrees with anything
    assert flown.seconds_to_trust(0.0, 5.0, measured=False) == (math.inf, False)
    assert flown.seconds_to_trust(0.0, 5.0)[0] < 0.7


def test_a_fault_that_does_not_come_back_is_not_believed_away_as_dead_reckoning_drifts():
    flown = Recovering()
    flown.seconds_to_trust(2.0 * DEG, 1.0)
    flown.predicted = 1.5 * DEG  # two standard deviations are 3 deg: zero would agree
    assert flown.seconds_to_trust(2.0 * DEG, 15.0) == (math.inf, False)
    flown.predicted = 40.0 * DEG  # nothing is known any more
    assert flown.seconds_to_trust(2.0 * DEG, 3.0) == (math.inf, False)
    assert flown.seconds_to_trust(2.0 * DEG, 5.0)[1]  # it has outlasted our patience


def test_a_fault_is_not_over_as_it_crosses_zero():
    flown = Recovering()
    flown.seconds_to_trust(2.0 * DEG, 1.0)
    ended = [flown.seconds_to_trust(level * DEG, 2.0 * DT)[0] for level in np.linspace(2.0, -2.0, 250)]
    assert min(ended) == math.inf


def test_a_false_alarm_that_crept_in_ends_when_it_agrees_again():
    flown = Recovering(abrupt=False, predicted=0.1 * SIGMA)
    assert flown.seconds_to_trust(0.5 * DEG, 1.0) == (math.inf, False)
    assert flown.seconds_to_trust(0.02 * DEG, 5.0)[0] < 1.5


def test_a_fault_that_stands_still_ends_when_patience_does():
    flown = Recovering()
    assert flown.seconds_to_trust(2.0 * DEG, PATIENCE - 1.0) == (math.inf, False)
    ended, outlasted = flown.seconds_to_trust(2.0 * DEG, 3.0)
    assert ended == pytest.approx(1.0 + RECOVERY, abs=0.1)
    assert outlasted
