"""Where an axis is faulty or suspect: declare faults, follow them, and judge which axes are trusted again."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_fdi.supervision import anchors, fault_track, measurement, residual_tests, sensor_noise
from quadftc_fdi.supervision.inertial_filter import bias_variance
from quadftc_fdi.supervision.reading import Reading
from quadftc_fdi.supervision.transition import Covariance, FilterState
from quadftc_model.arrays import Column, Mask, Scalar, Vector, any_of, larger, where

DEG = math.pi / 180.0
STARTED = 0.1 * DEG  # rad/s; the gyro bias is known to this when the observer has started
SHORT = 2.0  # s; a fault that ends sooner was none
POLE = 4.0  # 1; variance of roll and yaw over that at level, from which a pole is close: 60 deg of pitch
# covariance of what a wrong rotation has spoiled: itself, the bias (at 0.1 rad/s), the alignment
SPOILED = np.diag([1.0] * 3 + [0.1**2] * 3 + [1.0] * 9 + [0.0])


class Limits(NamedTuple):
    """Those parameters of `Supervised` that a judgement needs; their meaning and units stand there."""

    threshold: Scalar
    tracking: Scalar
    recovery: Scalar
    patience: Scalar


class Tested(NamedTuple):
    """What the tests of a sample give."""

    evidence: residual_tests.Evidence
    scores: residual_tests.Scores
    trusted: Mask  # axes whose evidence counts
    odd: Mask  # suspect, or an outlier
    noise: sensor_noise.SensorNoise


class Verdict(NamedTuple):
    """What is judged of each axis, and where the filter is then."""

    estimate: FilterState
    prediction: measurement.Prediction
    residual: Vector  # [rad]
    predicted: Vector  # variances of the predicted angles [rad²]
    bias: Column  # variance of the gyro bias [rad²/s²]
    faulty: Mask
    recovered: Mask  # trusted again
    short: Mask  # trusted again so soon that there was no fault
    alarm: anchors.One  # a fault is declared
    hold: anchors.One  # an axis is suspect: no anchor is given up
    restart: anchors.One  # the filter has gone back or was wrong: anchors and tests restart
    track: fault_track.Track


def judge(
    limits: Limits,
    faulty: Mask,
    track: fault_track.Track,
    estimate: FilterState,
    earlier: anchors.Anchors,
    reading: Reading,
    tested: Tested,
    known: sensor_noise.SensorNoise,
    by_rate: sensor_noise.Weights,
    dt: Scalar,
) -> Verdict:
    """Judge a sample: ``faulty`` and ``track`` are those of the sample before, ``known`` its noise then."""
    evidence, scores, trusted = tested[:3]
    # Go back to an anchor where a fault was found late, as it has misled the filter.
    found = residual_tests.declare_faults(scores, evidence.suspicion, trusted, limits.threshold)
    faulty, late = faulty | found.alarm, found.alarm & ~found.sudden
    estimate, prediction, residual = anchors.go_back_to_anchor(
        estimate, reading.prediction, earlier, reading.residuals, late, found.creeping, STARTED
    )
    bias, predicted = bias_variance(estimate.P), prediction.variances

    # Track the faults.
    gains = fault_track.tracker_gains(dt, limits.tracking)
    sensor, declared = reading.sensor, (found.alarm, found.abrupt, evidence.suspicion)
    seen = sensor, known.colour, *declared, reading.valid
    track = fault_track.track_fault(track, residual, *seen, gains, dt)
    cautious = sensor_noise.cautious_spread(by_rate, prediction.gain)
    blur = larger(prediction.gain / POLE, 1.0)
    judged = fault_track.judge_recovery(
        *(track, faulty, predicted, sensor, cautious, bias, reading.valid, blur),
        *(limits.recovery, limits.patience, dt),
    )
    recovered, outlasted = judged.trusted, judged.outlasted
    faulty = faulty & ~recovered

    # Where a fault has outlasted our patience, the filter was wrong: its rotation becomes uncertain, and
    # the sensor is believed.
    P = estimate.P + spoiled_by(where(outlasted, residual, 0.0))
    estimate, prediction = estimate._replace(P=P), measurement.predict_again(prediction, P)
    return Verdict(
        estimate,
        prediction,
        residual,
        predicted,
        bias,
        faulty,
        recovered,
        short=recovered & (judged.age < SHORT),
        alarm=any_of(found.alarm),
        hold=any_of(scores.suspect),
        restart=any_of(late | outlasted),
        track=fault_track.clear_healthy(judged.track, faulty),
    )


def all_healthy(none: Mask, track: fault_track.Track, estimate: FilterState, reading: Reading) -> Verdict:
    """Return what is judged where no axis is faulty or suspect."""
    prediction, residual, no = reading.prediction, reading.residuals[..., 0], none[..., :1]
    first = estimate, prediction, residual, prediction.variances, bias_variance(estimate.P)
    return Verdict(*first, none, none, none, no, no, no, track)


def spoiled_by(residual: Vector) -> Covariance:
    """Covariance (..., 16, 16) of a rotation that was wrong by a residual (..., 3) [rad].

    As long as the rotation was wrong, so were the axes in which the filter learned the gyro's errors.
    """
    return (residual**2).sum(axis=-1)[..., None, None] * SPOILED
