"""A magnetometer: the field of the earth in body axes, with hard iron and noise.

Axes are those of the IMU. The field is given by its strength, inclination and declination (World Magnetic
Model). In east, north, up axes it is

    B = strength (cos(inclination) sin(declination), cos(inclination) cos(declination), -sin(inclination))

and the sensor says R' B + hard iron + white noise. Hard iron is the field of the vehicle itself.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

from quadftc_model.arrays import Flag, Quaternion, Vector, namespace
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.rotations import to_body
from quadftc_sim.sensors import SlowSensor

MICROTESLA = 1e-6  # T


class FieldInputs(NamedTuple):
    """What a magnetometer sees at a sample of the IMU."""

    q_xyzw: Quaternion
    due: Flag  # it measures now
    draws: Vector  # standard normal numbers


class FieldSample(NamedTuple):
    """What a magnetometer says."""

    field: Vector  # [T], body axes
    there: Flag  # it has measured now


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Magnetometer(SlowSensor):
    """Sensor model of a magnetometer; by default there is none."""

    noise: float = parameter(0.0, unit="T", low=0.0, high=1e-3, doc="white noise of a sample, 1 sigma")
    hard_iron: float = parameter(
        0.0, unit="T", low=0.0, high=1e-3, doc="offset of each axis that a calibration leaves, 1 sigma"
    )
    # Zurich, WMM2020 in 2024, rounded; a heading is magnetic, so a declination turns it
    strength: float = parameter(48e-6, unit="T", low=1e-6, high=1e-3, doc="of the earth's field")
    inclination: float = parameter(
        math.radians(63.0), unit="rad", low=-math.pi / 2, high=math.pi / 2, doc="of the field, downwards"
    )
    declination: float = parameter(
        0.0, unit="rad", low=-math.pi, high=math.pi, doc="of the field, from north to east"
    )

    @prepared
    def earth_field(self) -> tuple[float, float, float]:
        """The field of the earth [T] towards east, north and up."""
        level = self.strength * math.cos(self.inclination)
        east, north = level * math.sin(self.declination), level * math.cos(self.declination)
        return east, north, -self.strength * math.sin(self.inclination)

    def init(self, draws: Vector) -> Vector:
        """Return the hard iron [T] of a flight; ``draws`` (..., 3) are standard normal numbers."""
        return self.hard_iron * draws

    def step(self, hard_iron: Vector, inputs: FieldInputs, dt: float) -> tuple[Vector, FieldSample]:
        """Return the hard iron, and the field that it measures if it is due."""
        field = to_body(inputs.q_xyzw, namespace(inputs.q_xyzw).asarray(self.earth_field))
        return hard_iron, FieldSample(field + hard_iron + self.noise * inputs.draws, inputs.due)


MAGNETOMETER_GRADES: dict[str, dict[str, float]] = {
    "ideal": {"rate": 4000.0},
    # Bosch BMM150 data sheet, high accuracy preset: 20 Hz, 0.3 uT. What a calibration leaves is ours
    "mems": {"rate": 20.0, "noise": 0.3 * MICROTESLA, "hard_iron": 0.5 * MICROTESLA},
}
