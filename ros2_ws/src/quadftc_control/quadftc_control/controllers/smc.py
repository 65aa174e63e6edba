"""Conventional sliding-mode control, after Slotine and Sastry (1983): the comparison of Wang et al. (2021).

    S = x1e' + k_c2 x1e
    u = B_u^-1 (x1d'' - k_c2 x1e' - f(x2)) - B_u^-1 k_c3 sat(S)

It has no integral and no disturbance estimate: a large k_c3 has to hold against every disturbance. Inside the
boundary layer a constant one leaves an error of d phi / (k_c3 k_c2).
"""

from __future__ import annotations

from quadftc_control.controller import Controller, limited, register
from quadftc_control.sliding_surface import sat, torque_for, tracking
from quadftc_model.arrays import namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import ControllerInputs, ControllerOutput


@register("smc")
class Smc(Controller):
    """Sliding-mode control with a large switching gain."""

    k_c2: Axes = parameter((4.0, 4.0, 3.0), unit="1/s", low=0.0, doc="slope of the surface")
    k_c3: Axes = parameter(
        (10.0, 10.0, 4.0), unit="rad/s^2", low=0.0, doc="switching gain, above the bound D_d"
    )
    phi: Axes = parameter((0.5, 0.5, 0.5), unit="rad/s", low=1e-9, doc="Phi of (41)")

    def init(self, inputs: ControllerInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(
        self, state: tuple[()], inputs: ControllerInputs, dt: float
    ) -> tuple[tuple[()], ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        xp = namespace(track.x1e)
        k_c2, k_c3, phi = map(xp.asarray, (self.k_c2, self.k_c3, self.phi))
        S = track.x1e_dot + k_c2 * track.x1e
        x1_ddot = inputs.reference.accelerations - k_c2 * track.x1e_dot - k_c3 * sat(S, phi)
        wanted = torque_for(self.vehicle, inputs, track, x1_ddot, xp.zeros_like(S))
        given, cut = limited(self.vehicle, wanted)
        return state, ControllerOutput(given, track.x1e, S, cut)
