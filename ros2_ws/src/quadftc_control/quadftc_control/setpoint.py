"""Live setpoints: a second-order filter makes a smooth reference of angles that jump."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from quadftc_model.arrays import Array, clip, namespace
from quadftc_model.parameters import check, parameter
from quadftc_model.rotations import wrap
from quadftc_model.samples import AttitudeReference


class SetpointState(NamedTuple):
    """The reference at the last sample."""

    reference: AttitudeReference


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SetpointFilter:
    """Second-order reference model, critically damped, with the acceleration bounded.

    acceleration = clip(w² wrap(setpoint - angle) - 2 w rate), rate and angle its integrals.
    """

    bandwidth: float = parameter(3.0, unit="rad/s", low=1e-3, high=50.0, doc="natural frequency w")
    max_acceleration: float = parameter(5.0, unit="rad/s^2", low=1e-3, doc="bound of each component")

    def __post_init__(self) -> None:
        """Check the parameters."""
        check(self)

    def init(self, setpoint: Array) -> SetpointState:
        """Start at a setpoint (..., 3) [rad], still."""
        zeros = namespace(setpoint).zeros_like(setpoint)
        return SetpointState(AttitudeReference(setpoint, zeros, zeros))

    def step(
        self, state: SetpointState, setpoint: Array, dt: float
    ) -> tuple[SetpointState, AttitudeReference]:
        """Advance by ``dt`` [s] towards a setpoint (..., 3) [rad]."""
        w, last = self.bandwidth, state.reference
        wanted = w * w * wrap(setpoint - last.angles) - 2.0 * w * last.rates
        acceleration = clip(wanted, -self.max_acceleration, self.max_acceleration)
        rates = last.rates + dt * acceleration
        reference = AttitudeReference(last.angles + 0.5 * dt * (last.rates + rates), rates, acceleration)
        return SetpointState(reference), reference
