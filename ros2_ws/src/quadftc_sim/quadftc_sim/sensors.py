"""The IMU: attitude, gyro and accelerometer with noise, bias and delay, in named grades.

Gyro errors in the usual terms (IEEE Std 952): angle random walk N [rad/sqrt(s)] gives white noise of N /
sqrt(dt) on each sample; rate random walk K [rad/s/sqrt(s)] moves the bias. The vehicle rotates about a fixed
point (an attitude test stand), so that the accelerometer measures the reaction to gravity alone.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

from quadftc_model.arrays import Array, Quaternion, Vector, namespace
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rotations import earth_z_in_body, quaternion_from_rotation_vector, quaternion_product
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample

DRAWS = (4, 3)  # standard normal numbers a sample needs: attitude, gyro, accelerometer, bias random walk


class ImuState(NamedTuple):
    """Gyro bias, and the samples that are on their way."""

    gyro_bias: Vector  # [rad/s]
    pending: tuple[ImuSample, ...]  # oldest first


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImuSensor(Checked):
    """Sensor model of one IMU with its attitude; all zero: the ideal sensor of the paper."""

    attitude_noise: float = parameter(0.0, unit="rad", low=0.0, doc="attitude noise of a sample, 1 sigma")
    gyro_noise: float = parameter(0.0, unit="rad/sqrt(s)", low=0.0, doc="gyro angle random walk N")
    gyro_bias: float = parameter(0.0, unit="rad/s", low=0.0, doc="turn-on gyro bias, uniform within +-")
    gyro_bias_walk: float = parameter(0.0, unit="rad/s/sqrt(s)", low=0.0, doc="gyro rate random walk K")
    accelerometer_noise: float = parameter(0.0, unit="m/s^2", low=0.0, doc="accelerometer noise, 1 sigma")
    delay: int = parameter(0, low=0, high=100, doc="samples between measuring and publishing")

    def turn_on_bias(self, uniform: Vector) -> Vector:
        """Gyro bias [rad/s] from numbers uniform in [-1, 1]."""
        return self.gyro_bias * uniform

    def init(self, gyro_bias: Vector) -> ImuState:
        """State with a gyro bias [rad/s] and nothing on its way."""
        return ImuState(gyro_bias, ())

    def step(
        self, state: ImuState, q_xyzw: Quaternion, body_rate: Vector, draws: Array, dt: float
    ) -> tuple[ImuState, ImuSample | None]:
        """Measure the motion; return the sample that comes out now, ``delay`` old, or None at the start.

        ``draws`` (..., 4, 3) are standard normal numbers, ``dt`` is the sampling period [s].
        """
        tilt = quaternion_from_rotation_vector(self.attitude_noise * draws[..., 0, :])
        noise = self.gyro_noise / math.sqrt(dt) * draws[..., 1, :]
        force = STANDARD_GRAVITY * earth_z_in_body(q_xyzw) + self.accelerometer_noise * draws[..., 2, :]
        there = namespace(q_xyzw).ones_like(q_xyzw[..., 0], dtype=bool)
        rate = body_rate + state.gyro_bias + noise
        sample = ImuSample(quaternion_product(q_xyzw, tilt), rate, force, there, there, there)
        bias = state.gyro_bias + self.gyro_bias_walk * math.sqrt(dt) * draws[..., 3, :]
        pending = (*state.pending, sample)
        if len(pending) <= self.delay:
            return ImuState(bias, pending), None
        return ImuState(bias, pending[1:]), pending[0]


_DEG = math.pi / 180.0

GRADES: dict[str, dict[str, float | int]] = {
    "ideal": {},
    # a good consumer MEMS IMU with its attitude filter; ranges as in data sheets of this class (ICM-42688-P,
    # BMI088): noise density 0.003-0.014 deg/s/sqrt(Hz), zero-rate offset +-0.5 to +-1 deg/s, accelerometer
    # 65-175 ug/sqrt(Hz)
    "mems": {
        "attitude_noise": 0.1 * _DEG,  # rad
        "gyro_noise": 0.007 * _DEG,  # rad/sqrt(s)
        "gyro_bias": 1.0 * _DEG,  # rad/s
        "gyro_bias_walk": 2e-4 * _DEG,  # rad/s/sqrt(s); 0.0015 deg/s over a minute
        "accelerometer_noise": 0.02,  # m/s², at 250 Hz
        "delay": 1,
    },
}
