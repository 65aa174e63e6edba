"""A flight, sample by sample: plant, sensor and random numbers behind ``start`` and ``advance``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import seconds
from quadftc_sim.plant import Plant
from quadftc_sim.sensors import DRAWS, ImuSensor

Floats = NDArray[np.float64]


class Emission(NamedTuple):
    """What the simulator shows at one instant."""

    stamp_ns: int  # now [ns]
    sample: ImuSample | None  # what the IMU publishes now; None while the first sample is on its way
    sample_stamp_ns: int  # when that sample was taken [ns]
    angles: Floats  # (3,) true Euler angles [rad]
    body_rate: Floats  # (3,) true body rate [rad/s]
    disturbance: Floats  # (3,) true disturbance [rad/s²]: its torque over the true inertia


class Simulator:
    """One vehicle with its IMU.

    Parameters
    ----------
    plant, sensor : Plant, ImuSensor
    period_ns : int
        Control period [ns].
    epoch_ns : int
        Stamp of the first sample [ns]: scenario time 0.
    seed : int
        Of the sensor's noise and bias.
    angles : array (3,), optional
        Initial Euler angles [rad].
    """

    def __init__(
        self,
        plant: Plant,
        sensor: ImuSensor,
        period_ns: int,
        epoch_ns: int,
        seed: int,
        angles: Floats | None = None,
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns = {period_ns}: must be positive")
        self.plant, self.sensor = plant, sensor
        self.period_ns, self.epoch_ns = period_ns, epoch_ns
        self._dt = seconds(period_ns)
        self._generator = np.random.default_rng(seed)
        bias = sensor.turn_on_bias(self._generator.uniform(-1.0, 1.0, 3))
        self._sensor_state = sensor.init(bias)
        start = np.zeros(3) if angles is None else angles
        self._state = plant.init(quaternion_from_euler(start), np.zeros(3))
        self.stamp_ns = epoch_ns

    @property
    def time(self) -> float:
        """Scenario time [s]."""
        return seconds(self.stamp_ns - self.epoch_ns)

    def start(self) -> Emission:
        """Return the first emission; call once."""
        return self._emit()

    def advance(self, torque: Floats) -> Emission:
        """Fly one period under a torque command [N m] (3,), held; return the emission at its end."""
        self._state = self.plant.step(self._state, torque, self.time, self._dt)
        self.stamp_ns += self.period_ns
        return self._emit()

    def _emit(self) -> Emission:
        state = self._state
        draws = self._generator.standard_normal(DRAWS)
        self._sensor_state, sample = self.sensor.step(
            self._sensor_state, state.q_xyzw, state.body_rate, draws, self._dt
        )
        return Emission(
            stamp_ns=self.stamp_ns,
            sample=sample,
            sample_stamp_ns=self.stamp_ns - self.sensor.delay * self.period_ns,
            angles=euler_from_quaternion(state.q_xyzw),
            body_rate=state.body_rate,
            disturbance=self.plant.disturbance_acceleration(self.time, state.body_rate),
        )
