"""Integral sliding-mode control with disturbance observer: Wang, Huang and Zhang (2021), equations (36)-(45).

    (37)  x1e = x1 - x1d
    (38)  S = x1e' + k_c2 x1e + k_c1 int x1e - k_c2 x1e(t0) - x1e'(t0)
    (45)  u = B_u^-1 (x1d'' - k_c2 x1e' - k_c1 x1e - f(x2) - d^) - B_u^-1 k_c3 sat(S)

The paper prints the first term of (38) without its dot. With a disturbance estimate of zero this is
(39)-(41), the design without observer. sat acts on each component, as k_c3 is diagonal. Theorem 2 with the
boundary layer phi gives |S| <= phi in the end, not S = 0.

Without observer k_c3 has to hold against the whole disturbance. Where the estimate goes missing in flight,
k_c3_alone takes over. Phi grows in proportion, as noise and sampling bound k_c3 / Phi.

Deviations: full kinematics (see sliding_surface); the torque is within the rotors' reach. Where it is cut,
the integral stops if it would be driven further. The surface then moves, and S stays at the edge of its
layer. Otherwise S would have to come back at the rate k_c3, with the attitude k_c3 / k_c1 off until then.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_control.controller import Controller, anti_windup, limited, register
from quadftc_control.sliding_surface import sat, torque_for, tracking
from quadftc_model.arrays import Vector, clip, namespace, where
from quadftc_model.parameters import Axes, parameter
from quadftc_model.samples import ControllerInputs, ControllerOutput


class State(NamedTuple):
    """Controller state at the last sample."""

    integral: Vector  # of x1e [rad s], as of the last sample
    start: Vector  # k_c2 x1e(t0) + x1e'(t0), and how far the surface has moved along [rad/s]
    x1e: Vector  # [rad]
    wanted: Vector  # torque before the limits [N m]
    given: Vector  # torque after the limits [N m]


@register("ismc")
class Ismc(Controller):
    """The paper's controller."""

    k_c1: Axes = parameter((16.0, 16.0, 9.0), unit="1/s^2", low=0.0, doc="k_c1 of (38)")
    k_c2: Axes = parameter((8.0, 8.0, 6.0), unit="1/s", low=0.0, doc="k_c2 of (38)")
    k_c3: Axes = parameter((2.0, 2.0, 1.0), unit="rad/s^2", low=0.0, doc="k_c3 of (40): eta + D_e or more")
    phi: Axes = parameter((0.1, 0.1, 0.1), unit="rad/s", low=1e-9, doc="Phi of (41): boundary layers")

    k_c3_alone: Axes = parameter(
        (10.0, 10.0, 4.0),
        unit="rad/s^2",
        low=0.0,
        doc="k_c3 without disturbance estimate, if larger: eta + D_d",
    )

    def without_estimate(self, missing: float) -> Ismc:
        """Return the law with k_c3 and Phi between both designs."""
        if missing <= 0.0:
            return self
        with_one = np.asarray(self.k_c3)
        gain = with_one + missing * (np.maximum(self.k_c3_alone, with_one) - with_one)
        factor = np.where(with_one > 0.0, gain / np.where(with_one > 0.0, with_one, 1.0), 1.0)
        return dataclasses.replace(self, k_c3=tuple(gain.tolist()), phi=tuple((factor * self.phi).tolist()))

    def init(self, inputs: ControllerInputs) -> State:
        """Start on the sliding surface: S(t0) = 0."""
        track = tracking(inputs)
        xp = namespace(track.x1e)
        zeros = xp.zeros_like(track.x1e)
        start = xp.asarray(self.k_c2) * track.x1e + track.x1e_dot
        return State(zeros, start, track.x1e, zeros, zeros)

    def step(self, state: State, inputs: ControllerInputs, dt: float) -> tuple[State, ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        xp = namespace(track.x1e)
        k_c1, k_c2, k_c3, phi = map(xp.asarray, (self.k_c1, self.k_c2, self.k_c3, self.phi))
        x1e, x1e_dot = track.x1e, track.x1e_dot
        mean = 0.5 * (state.x1e + x1e)  # trapezoidal rule
        integral = anti_windup(state.integral, mean, state.wanted, state.given, dt)
        surface = x1e_dot + k_c2 * x1e + k_c1 * integral - state.start  # (38)
        # while the torque is cut S obeys no law: the surface moves along, S stays within its layer
        excess = where(state.wanted != state.given, surface - clip(surface, -phi, phi), 0.0)
        S = surface - excess
        x1_ddot = inputs.reference.accelerations - k_c2 * x1e_dot - k_c1 * x1e - k_c3 * sat(S, phi)
        wanted = torque_for(self.vehicle, inputs, track, x1_ddot, inputs.disturbance)  # (45)
        given, cut = limited(self.vehicle, wanted, inputs.effectiveness)
        return State(integral, state.start + excess, x1e, wanted, given), ControllerOutput(given, x1e, S, cut)
