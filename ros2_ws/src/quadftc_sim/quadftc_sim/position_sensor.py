"""A position sensor: motion capture or satellite navigation, with its rate, delay and noise.

It measures at every n-th sample of the IMU. What it says comes with a later sample of the IMU: see
``delay``. The error of a position is white noise and a slow error, a first-order Gauss-Markov process.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from quadftc_model.arrays import Array, Flag, Vector, column, exp, namespace, sqrt
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import PositionSample
from quadftc_sim.delay_line import fill_line, shift_line
from quadftc_sim.sensors import SlowSensor


class PositionInputs(NamedTuple):
    """What a position sensor measures, true, at a sample of the IMU."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    due: Flag  # it is one of every n samples, at which it measures
    draws: Array  # (..., 3, 3) standard normal numbers: position, velocity, slow error


class PositionSensorState(NamedTuple):
    """Slow error, and the samples that are on their way."""

    wander: Vector  # [m]
    pending: PositionSample  # a line of as many samples as it is behind, oldest first


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionSensor(SlowSensor):
    """Sensor model of position and velocity, in earth axes."""

    rate: float = parameter(
        100.0, unit="Hz", low=0.1, high=4000.0, doc="of its samples, at most that of the IMU"
    )
    delay: float = parameter(
        0.0, unit="s", low=0.0, high=1.0, doc="from measuring to arriving, behind the IMU"
    )
    noise: Axes = parameter((0.0, 0.0, 0.0), unit="m", low=0.0, doc="white noise of a position, 1 sigma")
    wander: Axes = parameter((0.0, 0.0, 0.0), unit="m", low=0.0, doc="slow error of the position, 1 sigma")
    wander_time: float = parameter(30.0, unit="s", low=0.01, doc="correlation time of the slow error")
    gives_velocity: bool = parameter(False, doc="whether it measures the velocity, too")
    velocity_noise: Axes = parameter((0.0, 0.0, 0.0), unit="m/s", low=0.0, doc="noise of a velocity, 1 sigma")

    def lag(self, imu_rate: float) -> int:
        """How many samples of the IMU a position is behind."""
        return round(self.delay * imu_rate)

    def beside(self, imu_delay: int, imu_rate: float) -> PositionSampling:
        """Return the sensor beside an IMU of a rate [Hz] that is some samples late."""
        return PositionSampling(
            sensor=self, every=self.every(imu_rate), behind=imu_delay + self.lag(imu_rate)
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionSampling:
    """A position sensor beside an IMU."""

    sensor: PositionSensor
    every: int  # samples of the IMU to one of it
    behind: int  # samples of the IMU between measuring a position and its arrival

    def init(self, draws: Array) -> PositionSensorState:
        """State with the slow error drawn, and nothing on its way; ``draws`` as of the inputs."""
        xp = namespace(draws)
        wander = xp.asarray(self.sensor.wander) * draws[..., 2, :]
        zeros = xp.zeros_like(wander)
        nothing = PositionSample(zeros, zeros, xp.zeros_like(zeros[..., 0], dtype=bool))
        return PositionSensorState(wander, fill_line(nothing, self.behind, nothing.there.ndim))

    def step(
        self, state: PositionSensorState, inputs: PositionInputs, dt: float
    ) -> tuple[PositionSensorState, PositionSample]:
        """Measure the motion; return what arrives now. ``dt`` is the period of the IMU [s]."""
        xp, sensor, draws = namespace(inputs.draws), self.sensor, inputs.draws
        position = inputs.position + state.wander + xp.asarray(sensor.noise) * draws[..., 0, :]
        velocity = inputs.velocity + xp.asarray(sensor.velocity_noise) * draws[..., 1, :]
        if not sensor.gives_velocity:
            velocity = xp.zeros_like(velocity)
        taken = PositionSample(position, velocity, inputs.due)
        keep = column(exp(-dt / sensor.wander_time))
        wander = keep * state.wander + sqrt(1.0 - keep * keep) * xp.asarray(sensor.wander) * draws[..., 2, :]
        pending, output = shift_line(state.pending, taken, position.ndim - 1)
        return PositionSensorState(wander, pending), output


POSITION_GRADES: dict[str, dict[str, float | bool | Axes]] = {
    "ideal": {"rate": 4000.0},
    # motion capture in a room. Merriaux et al. (2017), Sensors 17, a Vicon system: 0.15 mm off at rest,
    # below 2 mm in fast motion. Rate and delay as usual over a network
    "mocap": {"rate": 100.0, "delay": 0.008, "noise": (0.001, 0.001, 0.001)},
    # u-blox MAX-M10S data sheet: 1.5 m CEP, 0.05 m/s, up to 10 Hz. The split into slow error and noise, the
    # vertical, 1.5 times as bad, and the delay are ours
    "gps": {
        "rate": 10.0,
        "delay": 0.1,
        "noise": (0.1, 0.1, 0.2),
        "wander": (1.2, 1.2, 1.8),
        "wander_time": 60.0,
        "gives_velocity": True,
        "velocity_noise": (0.05, 0.05, 0.1),
    },
}
