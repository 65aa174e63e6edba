"""A barometer: the pressure of the standard atmosphere at the vehicle's height, with slow error and noise.

Below 11 km (ICAO Doc 7488, 1993), with h the height above sea level,

    p = P0 (1 - L h / T0)^5.25588

The slow error, of weather, temperature and airflow, is a first-order Gauss-Markov process.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from quadftc_model.arrays import Array, Flag, Scalar, exp, sqrt, where
from quadftc_model.parameters import parameter
from quadftc_sim.sensors import SlowSensor

SEA_LEVEL = 101325.0  # Pa, P0
TEMPERATURE = 288.15  # K, T0; at sea level
LAPSE = 0.0065  # K/m, L
EXPONENT = 5.25588  # 1; g M / (R L)


def standard_pressure(height: Scalar) -> Scalar:
    """Pressure [Pa] of the standard atmosphere at a height above sea level [m], below 11 km."""
    return SEA_LEVEL * (1.0 - LAPSE * height / TEMPERATURE) ** EXPONENT


def standard_height(pressure: Scalar) -> Scalar:
    """Height above sea level [m] at which the standard atmosphere has a pressure [Pa]."""
    return TEMPERATURE / LAPSE * (1.0 - (pressure / SEA_LEVEL) ** (1.0 / EXPONENT))


class PressureInputs(NamedTuple):
    """What a barometer sees at a sample of the IMU."""

    height: Scalar  # above the start [m]
    due: Flag  # it measures now
    draws: Array  # (..., 2) standard normal numbers: slow error, noise


class PressureSample(NamedTuple):
    """What a barometer says."""

    pressure: Scalar  # [Pa]
    there: Flag  # it has measured now


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Barometer(SlowSensor):
    """Sensor model of a barometer; by default there is none."""

    noise: float = parameter(0.0, unit="Pa", low=0.0, high=1e3, doc="white noise of a sample, 1 sigma")
    wander: float = parameter(0.0, unit="Pa", low=0.0, high=1e4, doc="slow error, 1 sigma")
    wander_time: float = parameter(100.0, unit="s", low=0.01, doc="correlation time of the slow error")
    altitude: float = parameter(
        0.0, unit="m", low=-500.0, high=9000.0, doc="of the place where the vehicle starts, above sea level"
    )

    def init(self, draws: Array) -> Scalar:
        """Return the slow error [Pa] at the start; ``draws`` as of the inputs."""
        return self.wander * draws[..., 0]

    def step(self, wander: Scalar, inputs: PressureInputs, dt: float) -> tuple[Scalar, PressureSample]:
        """Return the slow error of the next sample, ``dt`` [s] later, and the pressure if it is due."""
        draws, height = inputs.draws, self.altitude + inputs.height
        pressure = standard_pressure(height) + wander + self.noise * draws[..., 1]
        keep = exp(-dt / self.wander_time)
        later = keep * wander + sqrt(1.0 - keep * keep) * self.wander * draws[..., 0]
        return where(inputs.due, later, wander), PressureSample(pressure, inputs.due)


BAROMETER_GRADES: dict[str, dict[str, float]] = {
    "ideal": {"rate": 4000.0},
    # MS5611-01BA03 data sheet (Measurement Specialties): 0.012 mbar RMS at an oversampling of 4096, with two
    # conversions of 9 ms for a sample. The slow error, 0.8 m in 100 s, is ours
    "mems": {"rate": 50.0, "noise": 1.2, "wander": 10.0},
}
