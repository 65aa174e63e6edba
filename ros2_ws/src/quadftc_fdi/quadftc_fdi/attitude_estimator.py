"""Attitude from raw IMU samples by VQF (Laidig and Seel 2023), and how uncertain it is.

Most IMU drivers publish body rate and specific force alone. VQF integrates the gyro, corrects the tilt by the
accelerometer, estimates the gyro bias at rest and in motion, and takes the heading from a magnetometer if
there is one. Where a motion capture gives poses, they replace tilt and heading, and VQF carries them on to
the next sample. Without either, the heading is 0 at the start and drifts.

VQF gives no covariance of the attitude. The one here was fitted on four recordings of the BROAD benchmark
(Laidig et al. 2021) and checked on two others, moved by hand; see docs/attitude_estimator.md:

    tilt      TILT² + (TILT_MOVING w)²          w: RMS body rate over the last 3 s
    heading   + (sigma_b dt) at every sample    sigma_b: of VQF's gyro bias; HEADING with a magnetometer
    pose      pose_noise² + (sigma_b age)² + (POSE_MOVING w)²      age: time since the pose
"""

from __future__ import annotations

import collections
import dataclasses
import math
from typing import NamedTuple

import numpy as np
from vqf import VQF

from quadftc_model.arrays import Quaternion, Vector
from quadftc_model.parameters import parameter
from quadftc_model.rotations import normalise, quaternion_product
from quadftc_model.samples import UNIT_NORM_TOLERANCE, ImuSample, is_usable, sanitised
from quadftc_model.stepper import seconds

DEG = math.pi / 180.0
TILT = 0.3 * DEG  # rad; error of the tilt at rest and in slow motion, both axes together
TILT_MOVING = 0.2 * DEG  # rad per rad/s
POSE_MOVING = 0.03 * DEG  # rad per rad/s; between two poses
HEADING = 3.0 * DEG  # rad; of the heading with a magnetometer
MOTION_TIME = 3.0  # s; as the accelerometer corrects the tilt over this time (tauAcc)
SETTLING = 50  # samples after which the periods are known
GAP = 1.0  # s; a longer one starts anew
POSE_HOLD = 0.5  # s; an older pose gives the heading alone


@dataclasses.dataclass(frozen=True)
class EstimatorParameters:
    """Parameters of the attitude estimator."""

    rate: float = parameter(
        0.0, unit="Hz", low=0.0, high=1e4, doc="of the IMU; 0: measured over the first 50 samples"
    )
    mag_rate: float = parameter(
        0.0, unit="Hz", low=0.0, high=1e4, doc="of the magnetometer; 0: measured if `rate` is, otherwise none"
    )
    pose_noise: float = parameter(0.1 * DEG, unit="rad", low=1e-6, doc="noise of a pose, 1 sigma")


class AttitudeEstimate(NamedTuple):
    """Attitude at a sample."""

    sample: ImuSample  # what came, without what cannot be used, and with the attitude (ENU)
    variance: Vector  # of the attitude about the earth's x, y and z [rad²]


class AttitudeEstimator:
    """Attitude of one vehicle from its raw IMU samples, in order of their stamps."""

    def __init__(self, parameters: EstimatorParameters) -> None:
        self._parameters = parameters
        self.restart()

    def restart(self) -> None:
        """Forget everything: the next sample is the first."""
        self._vqf: VQF | None = None
        self._first_ns = self._stamp_ns = -1
        self._samples = self._fields = 0
        self._field: Vector | None = None  # the last that came since the sample before
        self._has_field = False
        self._rate = np.zeros(3)
        self._square_rate = 0.0  # [rad²/s²]
        self._heading_sigma = 0.0
        self._bias_sigma = 0.0
        self._history: collections.deque[tuple[int, Quaternion]] = collections.deque()
        self._to_pose = np.array([0.0, 0.0, 0.0, 1.0])  # turns VQF's earth to that of the poses
        self._pose_ns = -1

    @property
    def heading_source(self) -> str:
        """What the heading comes from, for people."""
        if self._pose_ns >= 0:
            return "motion capture"
        return "magnetometer" if self._has_field else "gyro alone: it drifts"

    def take_field(self, field: Vector) -> bool:
        """Take a magnetic field (3,) in body axes, of any unit; whether it could be used."""
        usable = is_usable(field) and bool(np.any(field))
        if usable:
            self._fields += 1
            self._field = field
        return usable

    def take_pose(self, stamp_ns: int, q_xyzw: Quaternion) -> bool:
        """Take an attitude (4,) of a motion capture; whether it could be used."""
        unit = abs(float(q_xyzw @ q_xyzw) - 1.0) <= 2.0 * UNIT_NORM_TOLERANCE  # false for NaN
        earlier = [q for at_ns, q in self._history if at_ns <= stamp_ns]
        if not unit or not earlier or stamp_ns <= self._pose_ns or stamp_ns > self._stamp_ns:
            return False
        self._to_pose = quaternion_product(normalise(q_xyzw), _inverse(earlier[-1]))
        self._pose_ns = stamp_ns
        return True

    def step(self, stamp_ns: int, sample: ImuSample) -> AttitudeEstimate | None:
        """Take a raw sample (NumPy, one vehicle); None as long as the period is not known."""
        clean = sanitised(sample)
        dt = seconds(stamp_ns - self._stamp_ns) if self._stamp_ns >= 0 else 0.0
        if dt > GAP:
            self.restart()
            dt = 0.0
        if self._first_ns < 0:
            self._first_ns = stamp_ns
        self._stamp_ns, self._samples = stamp_ns, self._samples + 1
        if clean.rate_valid:  # an absent rate is taken to be the last
            self._rate = clean.body_rate
        if self._vqf is None:
            self._vqf = self._start(stamp_ns)
            if self._vqf is None:
                return None
        self._update(self._vqf, clean, dt)
        q_xyzw = _xyzw(self._vqf.getQuat9D() if self._has_field else self._vqf.getQuat6D())
        self._history.append((stamp_ns, q_xyzw))
        while seconds(stamp_ns - self._history[0][0]) > POSE_HOLD:
            self._history.popleft()
        return self._estimate(clean, q_xyzw)

    def _start(self, stamp_ns: int) -> VQF | None:
        """Return the filter once the periods of gyro and magnetometer are known."""
        rate, mag_rate = self._parameters.rate, self._parameters.mag_rate
        span = seconds(stamp_ns - self._first_ns)
        if not rate and (self._samples < SETTLING or span <= 0.0):
            return None
        self._period = 1.0 / rate if rate else span / (self._samples - 1)
        if not (rate or mag_rate) and self._fields > 1:
            mag_rate = self._fields / span
        self._has_field = mag_rate > 0.0
        return VQF(self._period, self._period, 1.0 / mag_rate if self._has_field else self._period)

    def _update(self, vqf: VQF, clean: ImuSample, dt: float) -> None:
        # the gyro's step is fixed in VQF: longer ones become several, and the angle of each is right
        steps = max(1, round(dt / self._period))
        rate = self._rate * (dt / (steps * self._period))
        for _ in range(steps):
            vqf.updateGyr(rate)
        if clean.force_valid and is_usable(clean.specific_force) and np.any(clean.specific_force):
            vqf.updateAcc(clean.specific_force.astype(float))
        if self._has_field and self._field is not None:
            vqf.updateMag(self._field.astype(float))
        self._field = None
        weight = dt / (MOTION_TIME + dt)
        self._square_rate += weight * (float(self._rate @ self._rate) - self._square_rate)
        self._bias_sigma = vqf.getBiasEstimate()[1]
        if self._has_field and not vqf.getMagDistDetected():
            self._heading_sigma = HEADING
        else:
            self._heading_sigma += self._bias_sigma * dt

    def _estimate(self, clean: ImuSample, q_xyzw: Quaternion) -> AttitudeEstimate:
        tilt = 0.5 * (TILT**2 + TILT_MOVING**2 * self._square_rate)
        variance = np.array([tilt, tilt, self._heading_sigma**2])
        if self._pose_ns >= 0:
            age = seconds(self._stamp_ns - self._pose_ns)
            drift = self._parameters.pose_noise**2 + (self._bias_sigma * age) ** 2
            drift += POSE_MOVING**2 * self._square_rate
            if age <= POSE_HOLD:
                q_xyzw, variance = quaternion_product(self._to_pose, q_xyzw), np.full(3, drift)
            else:  # VQF's tilt, and its heading turned to that of the poses
                turn = normalise(self._to_pose * np.array([0.0, 0.0, 1.0, 1.0]))
                q_xyzw, variance = quaternion_product(turn, q_xyzw), np.array([tilt, tilt, tilt + drift])
        known = clean._replace(q_xyzw=normalise(q_xyzw), attitude_valid=np.bool_(True))
        return AttitudeEstimate(known, variance)


def _inverse(q_xyzw: Quaternion) -> Quaternion:
    return q_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])


def _xyzw(q_wxyz: Quaternion) -> Quaternion:
    return np.asarray(q_wxyz)[[1, 2, 3, 0]]
