"""Geometric tracking control: the translational part of Lee, Leok and McClamroch (2010), IEEE CDC, 5420-5425.

    F = m (-k_p e_p - k_v e_v - k_i int e_p + g e3 + p_d'')
    thrust = F . R e3 ,    b3_d = F / |F|

with e_p = p - p_d and e_v = v - v_d, here with z up and gains over the mass. They prove the errors to vanish
for an attitude control of their own; here a command filter and any attitude controller follow.

Deviations: an integral, as Goodarzi, Lee and Lee (2013), European Control Conference, add one. It stops where
the limits would let it grow in vain. The error of position, tilt and thrust are bounded. The yaw of Euler
angles follows the trajectory; the paper projects a heading on the plane normal to b3_d.
"""

from __future__ import annotations

from quadftc_control.controller import anti_windup
from quadftc_control.position_controller import PositionController, PositionControllerInputs, Pushed, register
from quadftc_control.trajectory import within
from quadftc_model.arrays import Vector, clip, namespace, where
from quadftc_model.parameters import Axes, parameter


@register("geometric")
class Geometric(PositionController):
    """Proportional to the errors of position and velocity, with an integral."""

    k_p: Axes = parameter((6.0, 6.0, 10.0), unit="1/s^2", low=0.0, doc="error of position")
    k_v: Axes = parameter((3.8, 3.8, 5.0), unit="1/s", low=0.0, doc="error of velocity")
    k_i: Axes = parameter((2.2, 2.2, 3.0), unit="1/s^3", low=0.0, doc="integral of the error of position")
    max_error: float = parameter(2.0, unit="m", low=0.01, doc="bound of the error of position")
    max_trim: float = parameter(3.0, unit="m/s^2", low=0.0, doc="bound of what the integral gives")

    def start(self, inputs: PositionControllerInputs) -> Vector:
        """Start with nothing in the integral."""
        return namespace(inputs.estimate.position).zeros_like(inputs.estimate.position)

    def push(
        self, state: Vector, inputs: PositionControllerInputs, last: Pushed, dt: float
    ) -> tuple[Vector, Vector]:
        """Correct the errors; the state is the acceleration that the integral takes away."""
        now, shall = inputs.estimate, inputs.reference
        off = now.position - shall.position
        error = within(off, self.max_error)
        xp = namespace(error)
        k_p, k_v, k_i = map(xp.asarray, (self.k_p, self.k_v, self.k_i))
        gathered = k_i * where(error == off, error, 0.0)  # on the way to a far place, nothing
        trim = anti_windup(state, gathered, last.wanted, last.given, dt)
        trim = clip(trim, -self.max_trim, self.max_trim)
        return trim, -k_p * error - k_v * (now.velocity - shall.velocity) - trim
