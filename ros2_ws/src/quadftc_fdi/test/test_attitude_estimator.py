"""Attitude of raw IMU samples: against the truth of simulated motion, and what it says of its uncertainty."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadftc_fdi.attitude_estimator import AttitudeEstimator, EstimatorParameters
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample

TRUE = np.bool_(True)
RATE, FIRST_NS = 200.0, 5_000_000_000
FIELD = np.array([0.0, 20e-6, -45e-6])  # T; towards north and down, in ENU
GYRO_BIAS = np.radians([0.4, -0.3, 0.2])  # rad/s


class Motion:
    """Rest for 5 s, then sums of sines on every axis; raw samples of an IMU in it."""

    def __init__(self, duration=30.0, bias=GYRO_BIAS, rate=RATE, yaw=0.0):
        rng = np.random.default_rng(4)
        self.time = np.arange(round(duration * rate)) / rate
        self.stamp_ns = FIRST_NS + np.round(self.time * 1e9).astype(np.int64)
        moving = np.clip(self.time - 5.0, 0.0, 1.0)[:, None]
        angles = moving * [0.3, 0.25, 0.6] * np.sin(self.time[:, None] * [1.3, 0.9, 0.7])
        self.truth = Rotation.from_euler("ZYX", angles[:, ::-1] + [yaw, 0.0, 0.0])
        steps = (self.truth[:-1].inv() * self.truth[1:]).as_rotvec() * rate
        noise = rng.normal(0.0, np.radians(0.1), (len(self.time), 3))
        self.gyro = np.vstack([steps[:1], steps]) + bias + noise
        up = self.truth.inv().apply([0.0, 0.0, STANDARD_GRAVITY])
        self.force = up + rng.normal(0.0, 0.05, up.shape)
        self.field = self.truth.inv().apply(FIELD)

    def sample(self, k, **changes):
        level = np.array([0.0, 0.0, 0.0, 1.0])
        raw = ImuSample(level, self.gyro[k], self.force[k], ~TRUE, TRUE, TRUE)
        return raw._replace(**changes)


def errors(motion, estimates):
    """Tilt and heading errors [deg] of estimates by sample."""
    places = np.array([k for k, estimate in enumerate(estimates) if estimate is not None])
    found = Rotation.from_quat(np.array([estimates[k].sample.q_xyzw for k in places]))
    z, w = (found * motion.truth[places].inv()).as_quat()[:, 2:].T
    tilt = 2.0 * np.arccos(np.clip(np.hypot(z, w), 0.0, 1.0))
    heading = (2.0 * np.arctan2(z, w) + np.pi) % (2.0 * np.pi) - np.pi
    return np.degrees(tilt), np.degrees(heading)


def fly(motion, estimator=None, **changes):
    estimator = estimator or AttitudeEstimator(EstimatorParameters())
    return [estimator.step(int(ns), motion.sample(k, **changes)) for k, ns in enumerate(motion.stamp_ns)]


def test_tilt_is_held_and_the_gyro_bias_learned_at_rest():
    motion = Motion()
    tilt, heading = errors(motion, fly(motion))
    assert np.sqrt(np.mean(tilt**2)) < 0.15
    assert tilt[100:].max() < 0.5  # at the first sample it knows one noisy force
    # the bias of 0.2 deg/s in yaw is gone after the rest: 25 s of it would be 5 deg
    assert np.abs(heading - heading[round(4.5 * RATE)])[round(4.5 * RATE) :].max() < 0.5


def test_the_uncertainty_covers_the_error():
    motion = Motion()
    estimates = fly(motion)
    tilt, heading = errors(motion, estimates)
    variance = np.array([estimate.variance for estimate in estimates if estimate is not None])
    assert np.mean(tilt < 2.0 * np.degrees(np.sqrt(variance[:, 0] + variance[:, 1]))) > 0.95
    assert np.mean(np.abs(heading) < 2.0 * np.degrees(np.sqrt(variance[:, 2]))) > 0.95
    assert variance[-1, 2] > variance[0, 2]  # without magnetometer the heading drifts, and it says so


def test_without_a_rate_it_waits_until_it_has_measured_one():
    motion = Motion(duration=1.0)
    estimates = fly(motion)
    assert [estimate is None for estimate in estimates] == [True] * 49 + [False] * (len(estimates) - 49)
    given = fly(motion, AttitudeEstimator(EstimatorParameters(rate=RATE)))
    assert all(estimate is not None for estimate in given)


def test_a_magnetometer_gives_the_heading():
    motion = Motion(yaw=1.0)
    estimator, estimates = AttitudeEstimator(EstimatorParameters()), []
    for k, stamp_ns in enumerate(motion.stamp_ns):
        if k % 4 == 0:
            assert estimator.take_field(motion.field[k])
        estimates.append(estimator.step(int(stamp_ns), motion.sample(k)))
    assert estimator.heading_source == "magnetometer"
    _, heading = errors(motion, estimates)
    assert np.abs(heading[round(10 * RATE) :]).max() < 1.5
    assert not estimator.take_field(np.zeros(3))
    assert not estimator.take_field(np.array([np.nan, 0.0, 0.0]))


def test_a_field_before_the_first_sample_of_a_given_rate_is_not_measured():
    motion = Motion(duration=0.1)
    estimator = AttitudeEstimator(EstimatorParameters(rate=RATE))
    assert all(estimator.take_field(FIELD) for _ in range(3))
    assert fly(motion, estimator)[-1] is not None
    assert estimator.heading_source == "gyro alone: it drifts"


def test_poses_give_attitude_and_heading_also_when_they_come_late():
    motion = Motion(yaw=2.0)
    estimator, estimates = AttitudeEstimator(EstimatorParameters(rate=RATE)), []
    for k, stamp_ns in enumerate(motion.stamp_ns):
        estimates.append(estimator.step(int(stamp_ns), motion.sample(k)))
        late = k - 10  # 50 ms
        if late >= 0 and k % 10 == 0 and motion.time[k] < 20.0:
            assert estimator.take_pose(int(motion.stamp_ns[late]), motion.truth[late].as_quat())
    tilt, heading = errors(motion, estimates)
    with_poses = slice(round(1.0 * RATE), round(20.0 * RATE))
    assert tilt[with_poses].max() < 0.3
    assert np.abs(heading[with_poses]).max() < 0.3
    # when they end, tilt and heading go on without a jump
    assert tilt[-1] < 0.5
    assert abs(heading[-1]) < 1.0
    assert estimates[-1].variance[2] > estimates[round(19.0 * RATE)].variance[2]


@pytest.mark.parametrize("wrong", [np.zeros(4), np.full(4, np.nan), np.array([0.0, 0.0, 0.0, 1.1])])
def test_a_pose_that_is_none_is_refused(wrong):
    motion = Motion(duration=1.0)
    estimator = AttitudeEstimator(EstimatorParameters(rate=RATE))
    fly(motion, estimator)
    last_ns = int(motion.stamp_ns[-1])
    assert not estimator.take_pose(last_ns, wrong)
    assert not estimator.take_pose(last_ns + 1, np.array([0.0, 0.0, 0.0, 1.0]))  # of the future
    assert not estimator.take_pose(FIRST_NS - 1, np.array([0.0, 0.0, 0.0, 1.0]))  # of before


def test_missing_samples_cost_little_and_a_long_gap_starts_anew():
    motion, rng = Motion(duration=20.0), np.random.default_rng(1)
    estimator, estimates = AttitudeEstimator(EstimatorParameters(rate=RATE)), []
    for k, stamp_ns in enumerate(motion.stamp_ns):
        lost = rng.random() < 0.3
        estimates.append(None if lost else estimator.step(int(stamp_ns), motion.sample(k)))
    assert errors(motion, estimates)[0].max() < 1.0
    later = int(motion.stamp_ns[-1]) + 5_000_000_000
    again = estimator.step(later, motion.sample(0))
    assert np.degrees(np.sqrt(again.variance[2])) < 0.01  # the heading is 0 by definition


@pytest.mark.parametrize(
    "changes",
    [
        {"body_rate": np.full(3, np.nan)},
        {"body_rate": np.full(3, 1e200)},
        {"specific_force": np.full(3, np.inf)},
        {"specific_force": np.full(3, 1e300)},
        {"specific_force": np.zeros(3)},
        {"rate_valid": ~TRUE},
        {"force_valid": ~TRUE},
    ],
)
def test_what_cannot_be_used_is_left_out(changes):
    motion = Motion(duration=10.0)
    estimator = AttitudeEstimator(EstimatorParameters(rate=RATE))
    estimates = []
    for k, stamp_ns in enumerate(motion.stamp_ns):
        bad = changes if k % 7 == 3 else {}
        estimates.append(estimator.step(int(stamp_ns), motion.sample(k, **bad)))
    numbers = [np.concatenate([*estimate.sample[:3], estimate.variance]) for estimate in estimates]
    assert np.all(np.isfinite(numbers))
    assert errors(motion, estimates)[0].max() < 1.0
