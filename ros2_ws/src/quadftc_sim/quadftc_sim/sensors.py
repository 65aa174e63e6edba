"""The IMU: attitude, gyro and accelerometer with noise, slow errors and delay, in named grades.

Gyro errors in the usual terms (IEEE Std 952): angle random walk N [rad/sqrt(s)] gives white noise of N /
sqrt(dt) on each sample; rate random walk K [rad/s/sqrt(s)] moves the bias. Scale and misalignment are a
matrix: the gyro measures (I + E) omega, every entry of E drawn once for a flight with ``gyro_scale``.

The attitude is measured as R exp(e), with the error e [rad] in body axes

    e = white noise + sum_k x_k - lag omega
    x_k' = a_k x_k + sqrt((1 - a_k^2) / 3) (wander + wander_moving sum_i |omega_i|) n,  a_k = exp(-dt / T_k)

Each x_k is a first-order Gauss-Markov process with the correlation time T_k of `WANDER_TIMES` and n standard
normal: at rest their sum has the standard deviation ``wander``. Motion feeds it, so that the error goes on
for some T_k after the motion.

What the accelerometer measures, the specific force at its place, is the plant's to say.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Quaternion, Vector, is_single, namespace
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rotations import earth_z_in_body, quaternion_from_rotation_vector, quaternion_product
from quadftc_model.samples import STANDARD_GRAVITY, ImuSample
from quadftc_sim.sensor_draws import WHITE, TurnOn

WANDER_TIMES = (0.1, 0.45, 2.0)  # s; correlation times of the slow error of an attitude filter


class ImuState(NamedTuple):
    """Errors of the IMU that last, and the samples that are on their way."""

    gyro_bias: Vector  # [rad/s]
    gyro_error: Array | None  # (..., 3, 3) scale and misalignment [1]; None: the gyro has none
    wander: Array | None  # (..., 3, 3) x_k, one a row [rad]; None: the attitude does not wander
    pending: tuple[ImuSample, ...]  # oldest first


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

    @property
    def wanders(self) -> bool:
        """Whether the attitude has a slow error; it needs random numbers of its own."""
        return _acts(self.attitude_wander) or _acts(self.attitude_wander_moving)

    def init(self, gyro_bias: Vector) -> ImuState:
        """State with a gyro bias [rad/s], no other error and nothing on its way."""
        zeros = namespace(gyro_bias).zeros_like(gyro_bias)
        none = namespace(gyro_bias).stack((zeros, zeros, zeros), axis=-2)
        return ImuState(
            gyro_bias, none if _acts(self.gyro_scale) else None, none if self.wanders else None, ()
        )

    def turn_on(self, drawn: TurnOn) -> ImuState:
        """State with the errors of a flight drawn, and nothing on its way."""
        state = self.init(self.gyro_bias * drawn.uniform)
        if state.gyro_error is not None:
            state = state._replace(gyro_error=self.gyro_scale * drawn.gyro)
        if state.wander is not None:
            share = self.attitude_wander / math.sqrt(len(WANDER_TIMES))
            state = state._replace(wander=share * drawn.wander)
        return state

    def step(
        self,
        state: ImuState,
        q_xyzw: Quaternion,
        body_rate: Vector,
        specific_force: Vector,
        draws: Array,
        dt: float,
    ) -> tuple[ImuState, ImuSample | None]:
        """Measure the motion; return the sample that comes out now, ``delay`` old, or None at the start.

        ``specific_force`` is the true one [m/s²], body axes. ``draws`` are standard normal numbers, (..., 7,
        3), or (..., 4, 3) where the attitude does not wander; see `quadftc_sim.sensor_draws`. ``dt`` is the
        sampling period [s].
        """
        tilt, wander = self.attitude_noise * draws[..., 0, :], state.wander
        if wander is not None:
            tilt = tilt + wander.sum(axis=-2)
            wander = self._wander_on(wander, body_rate, draws[..., WHITE:, :], dt)
        if _acts(self.attitude_lag):
            tilt = tilt - self.attitude_lag * body_rate
        attitude = quaternion_product(q_xyzw, quaternion_from_rotation_vector(tilt))
        noise = self.gyro_noise / math.sqrt(dt) * draws[..., 1, :]
        rate = body_rate + state.gyro_bias + noise
        if state.gyro_error is not None:
            rate = rate + (state.gyro_error * body_rate[..., None, :]).sum(axis=-1)
        force = specific_force + self.accelerometer_noise * draws[..., 2, :]
        # for one vehicle a flag as the graph has it, which is quicker than an array without axes
        single = is_single(q_xyzw)
        there = np.bool_(True) if single else namespace(q_xyzw).ones_like(q_xyzw[..., 0], dtype=bool)
        sample = ImuSample(attitude, rate, force, there, there, there)
        bias = state.gyro_bias + self.gyro_bias_walk * math.sqrt(dt) * draws[..., 3, :]
        pending = (*state.pending, sample)
        if len(pending) <= self.delay:
            return ImuState(bias, state.gyro_error, wander, pending), None
        return ImuState(bias, state.gyro_error, wander, pending[1:]), pending[0]

    def _wander_on(self, wander: Array, body_rate: Vector, draws: Array, dt: float) -> Array:
        """Return the slow errors x_k (..., 3, 3) [rad] one sample later."""
        motion = abs(body_rate).sum(axis=-1)[..., None, None]
        size = self.attitude_wander + self.attitude_wander_moving * motion
        keep = np.exp(-dt / np.array(WANDER_TIMES))[:, None]
        return keep * wander + np.sqrt((1.0 - keep**2) / len(WANDER_TIMES)) * size * draws


def resting_force(q_xyzw: Quaternion) -> Vector:
    """Specific force [m/s²] (..., 3) of a body that does not accelerate: the reaction to gravity."""
    return STANDARD_GRAVITY * earth_z_in_body(q_xyzw)


def _acts(number: Any) -> bool:
    """Whether a parameter may differ from zero; in a batch it may be an array of the flights' values."""
    return not (isinstance(number, float) and number == 0.0)


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
