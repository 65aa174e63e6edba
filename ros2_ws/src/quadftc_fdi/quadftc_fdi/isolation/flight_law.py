"""What fault observers are told of the sensors of free flight: the data sheet of a position sensor."""

from __future__ import annotations

import dataclasses

from quadftc_fdi.fault_observer import FaultObserver
from quadftc_fdi.isolation import free_flight
from quadftc_fdi.rotor_diagnosis.rotor_model import Effects, effects_of, model_of
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.position_estimator import PositionEstimator


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FlightLaw(FaultObserver):
    """Base of fault observers that judge accelerometer and rotors, too."""

    position_delay: float = parameter(0.0, unit="s", low=0.0, high=1.0, doc="age of a position when it comes")
    position_noise: float = parameter(0.002, unit="m", low=1e-4, high=100.0, doc="of a position, 1 sigma")
    gives_velocity: bool = parameter(False, doc="whether the position sensor measures the velocity, too")
    velocity_noise: float = parameter(0.1, unit="m/s", low=1e-3, high=100.0, doc="of a velocity, 1 sigma")

    @prepared
    def motion_law(self) -> PositionEstimator:
        """The estimator of what attitude and accelerometer do wrong in free flight."""
        return free_flight.motion_law(
            self.position_delay, self.position_noise, self.gives_velocity, self.velocity_noise
        )

    @prepared
    def rotor_effects(self) -> Effects:
        """What the rotors do to gyro and accelerometer."""
        return effects_of(model_of(self.vehicle))
