"""The IMU: attitude, gyro and accelerometer with noise, slow errors and delay, in named grades.

Gyro errors in the usual terms (IEEE Std 952): angle random walk N [rad/sqrt(s)] gives white noise of N /
sqrt(dt) on each sample; rate random walk K [rad/s/sqrt(s)] moves the bias. Scale and misalignment are a
matrix: the gyro measures (I + E) omega, every entry of E drawn once for a flight with ``gyro_scale``.

The attitude is measured as R exp(e), with the error e [rad] in body axes

    e = white noise + sum_k x_k - lag omega
    x_k' = a_k x_k + sqrt((1 - a_k^2) / 3) (wander + wander_moving sum_i |omega_i|) n,  a_k = exp(-dt / T_k)

Each x_k is a first-order Gauss-Markov process with the correlation time T_k of `WANDER_TIMES`; n is standard
normal. At rest their sum has the standard deviation ``wander``. Motion feeds it, so that the error goes on
for some T_k after the motion.

What the accelerometer measures, the specific force at its place, is the plant's to say.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Flag, Quaternion, Vector, column, exp, namespace, sqrt
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rotations import earth_z_in_body, quaternion_from_rotation_vector, quaternion_product
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample
from quadftc_sim.delay_line import fill_line, shift_line
from quadftc_sim.sensor_draws import WHITE, TurnOn

WANDER_TIMES = (0.1, 0.45, 2.0)  # s; correlation times of the slow error of an attitude filter


class ImuInputs(NamedTuple):
    """What an IMU measures, true, at a sample."""

    q_xyzw: Quaternion
    body_rate: Vector  # [rad/s]
    specific_force: Vector  # [m/s²], body axes
    draws: Array  # (..., 7, 3) standard normal numbers: see `quadftc_sim.sensor_draws`


class ImuOutput(NamedTuple):
    """What comes out of an IMU at a sample."""

    sample: ImuSample  # ``delay`` samples old
    there: Flag  # False at the start, while the first sample is on its way


class ImuState(NamedTuple):
    """Errors of the IMU that last, and the samples that are on their way."""

    gyro_bias: Vector  # [rad/s]
    gyro_error: Array  # (..., 3, 3) scale and misalignment [1]
    wander: Array  # (..., 3, 3) x_k, one a row [rad]
    pending: ImuOutput  # a line of ``delay`` samples, oldest first


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImuSensor(Checked):
    """Sensor model of one IMU with its attitude; all zero: the ideal sensor of the paper."""

    attitude_noise: float = parameter(0.0, unit="rad", low=0.0, doc="attitude noise of a sample, 1 sigma")
    attitude_wander: float = parameter(0.0, unit="rad", low=0.0, doc="slow attitude error at rest, 1 sigma")
    attitude_wander_moving: float = parameter(
        0.0, unit="s", low=0.0, doc="what motion adds to it, over the sum of the body rates"
    )
    attitude_lag: float = parameter(0.0, unit="s", low=0.0, high=1.0, doc="attitude behind the gyro")
    gyro_noise: float = parameter(0.0, unit="rad/sqrt(s)", low=0.0, doc="gyro angle random walk N")
    gyro_bias: float = parameter(0.0, unit="rad/s", low=0.0, doc="turn-on gyro bias, uniform within +-")
    gyro_bias_walk: float = parameter(0.0, unit="rad/s/sqrt(s)", low=0.0, doc="gyro rate random walk K")
    gyro_scale: float = parameter(
        0.0, low=0.0, high=0.2, doc="gyro scale and misalignment error, 1 sigma of a flight"
    )
    accelerometer_noise: float = parameter(0.0, unit="m/s^2", low=0.0, doc="accelerometer noise, 1 sigma")
    delay: int = parameter(0, low=0, high=100, doc="samples between measuring and publishing")

    def init(self, drawn: TurnOn) -> ImuState:
        """State with the errors of a flight drawn, and nothing on its way."""
        xp = namespace(drawn.uniform)
        zeros = xp.zeros_like(drawn.uniform)
        level = xp.concatenate([zeros, xp.ones_like(zeros[..., :1])], axis=-1)
        absent = xp.zeros_like(zeros[..., 0], dtype=bool)
        nothing = ImuOutput(ImuSample(level, zeros, zeros, absent, absent, absent), absent)
        return ImuState(
            self.gyro_bias * drawn.uniform,
            self.gyro_scale * drawn.gyro,
            self.attitude_wander / math.sqrt(len(WANDER_TIMES)) * drawn.wander,
            fill_line(nothing, self.delay, absent.ndim),
        )

    def step(self, state: ImuState, inputs: ImuInputs, dt: float) -> tuple[ImuState, ImuOutput]:
        """Measure the motion; ``dt`` is the sampling period [s], at the first sample too."""
        q_xyzw, omega, force, draws = inputs
        root = sqrt(column(dt))
        # the attitude is off by e
        e = self.attitude_noise * draws[..., 0, :] + state.wander.sum(axis=-2) - self.attitude_lag * omega
        attitude = quaternion_product(q_xyzw, quaternion_from_rotation_vector(e))
        # the gyro by its bias, noise, scale and misalignment
        noise = self.gyro_noise / root * draws[..., 1, :]
        rate = omega + state.gyro_bias + noise + (state.gyro_error * omega[..., None, :]).sum(axis=-1)
        measured_force = force + self.accelerometer_noise * draws[..., 2, :]
        there = namespace(rate).ones_like(rate[..., 0], dtype=bool)
        taken = ImuOutput(ImuSample(attitude, rate, measured_force, there, there, there), there)
        # the lasting errors of the next sample
        bias = state.gyro_bias + self.gyro_bias_walk * root * draws[..., 3, :]
        wander = self._wander_on(state.wander, omega, draws[..., WHITE:, :], dt)
        pending, output = shift_line(state.pending, taken, there.ndim)
        return ImuState(bias, state.gyro_error, wander, pending), output

    def _wander_on(self, wander: Array, body_rate: Vector, draws: Array, dt: float) -> Array:
        """Return the slow errors x_k (..., 3, 3) [rad] one sample later."""
        motion = abs(body_rate).sum(axis=-1)[..., None, None]
        size = self.attitude_wander + self.attitude_wander_moving * motion
        keep = column(exp(-column(dt) / np.array(WANDER_TIMES)))
        return keep * wander + sqrt((1.0 - keep**2) / len(WANDER_TIMES)) * size * draws


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SlowSensor(Checked):
    """Base of the sensors that measure at every n-th sample of the IMU."""

    rate: float = parameter(
        0.0, unit="Hz", low=0.0, high=4000.0, doc="of its samples, at most that of the IMU; 0: there is none"
    )

    def every(self, imu_rate: float) -> int:
        """How many samples of the IMU, at ``imu_rate`` [Hz], come to one of it: the nearest number."""
        return max(1, round(imu_rate / self.rate))


def resting_force(q_xyzw: Quaternion) -> Vector:
    """Specific force [m/s²] (..., 3) of a body that does not accelerate: the reaction to gravity."""
    return STANDARD_GRAVITY * earth_z_in_body(q_xyzw)


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
    # an attitude and heading reference on such a gyro. Its filter smooths noise, but its error wanders. Xsens
    # MTi user manual MT0605P.E, section 4.3, MTi-30: roll and pitch 0.2 deg static, 0.5 deg dynamic, 1 sigma,
    # here at 100 deg/s; MTi-1: noise density 0.007 deg/s/sqrt(Hz). Scale and alignment after a factory
    # calibration, and the lag, are ours
    "ahrs": {
        "attitude_noise": 0.01 * _DEG,  # rad
        "attitude_wander": 0.2 * _DEG,  # rad
        "attitude_wander_moving": 0.003,  # s; 0.3 deg at 100 deg/s
        "attitude_lag": 0.004,  # s
        "gyro_noise": 0.007 * _DEG,  # rad/sqrt(s)
        "gyro_bias": 0.5 * _DEG,  # rad/s
        "gyro_bias_walk": 2e-4 * _DEG,  # rad/s/sqrt(s)
        "gyro_scale": 0.003,
        "accelerometer_noise": 0.02,  # m/s², at 250 Hz
        "delay": 1,
    },
    # a tactical grade. Safran (Sensonor) STIM300 data sheet: angle random walk 0.15 deg/sqrt(h), bias 10
    # deg/h over temperature, scale 500 ppm, misalignment 1 mrad, velocity random walk 0.06 m/s/sqrt(h). The
    # attitude, and the rate random walk, are ours
    "tactical": {
        "attitude_noise": 0.02 * _DEG,  # rad
        "attitude_wander": 0.02 * _DEG,  # rad
        "attitude_wander_moving": 0.0002,  # s; 0.02 deg at 100 deg/s
        "attitude_lag": 0.001,  # s
        "gyro_noise": 0.0025 * _DEG,  # rad/sqrt(s); 0.15 deg/sqrt(h)
        "gyro_bias": 0.0028 * _DEG,  # rad/s; 10 deg/h
        "gyro_bias_walk": 1e-5 * _DEG,  # rad/s/sqrt(s); 0.3 deg/h over a minute
        "gyro_scale": 0.001,
        "accelerometer_noise": 0.016,  # m/s², at 250 Hz
        "delay": 1,
    },
}
