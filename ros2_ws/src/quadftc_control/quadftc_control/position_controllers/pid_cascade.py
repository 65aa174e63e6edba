"""Cascaded control as autopilots fly: proportional on position, PID on velocity.

    v_s = v_d + k_position (p_d - p) ,  |k_position (p_d - p)| <= max_correction
    a = p_d'' + k_p e + k_i int e - k_d (v' - p_d'') ,  e = v_s - v

The structure of PX4's multicopter position control (PositionControl.cpp), whose gains are accelerations, too.
The derivative acts on the estimated acceleration, low-passed, beyond that of the trajectory.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_control.controller import anti_windup
from quadftc_control.position_controller import PositionController, PositionControllerInputs, Pushed, register
from quadftc_control.trajectory import within
from quadftc_model.arrays import Vector, clip, namespace, where
from quadftc_model.parameters import Axes, parameter


class State(NamedTuple):
    """State at the last sample."""

    trim: Vector  # what the integral takes away [m/s²]
    filtered: Vector  # acceleration beyond that of the trajectory, low-passed [m/s²]


@register("pid_cascade")
class PidCascade(PositionController):
    """Position P, velocity PID."""

    k_position: Axes = parameter((1.2, 1.2, 1.6), unit="1/s", low=0.0, doc="position to velocity setpoint")
    k_p: Axes = parameter((3.8, 3.8, 5.0), unit="1/s", low=0.0, doc="error of velocity")
    k_i: Axes = parameter((1.8, 1.8, 2.0), unit="1/s^2", low=0.0, doc="its integral")
    k_d: Axes = parameter((0.1, 0.1, 0.0), unit="1", low=0.0, high=0.9, doc="acceleration")
    cutoff: float = parameter(30.0, unit="rad/s", low=1e-3, doc="low-pass of the acceleration (5 Hz)")
    max_correction: float = parameter(
        2.0, unit="m/s", low=0.01, doc="bound of the speed towards the position"
    )
    max_trim: float = parameter(3.0, unit="m/s^2", low=0.0, doc="bound of what the integral gives")

    def start(self, inputs: PositionControllerInputs) -> State:
        """Start with nothing in the integral."""
        zeros = namespace(inputs.estimate.position).zeros_like(inputs.estimate.position)
        return State(zeros, zeros)

    def push(
        self, state: State, inputs: PositionControllerInputs, last: Pushed, dt: float
    ) -> tuple[State, Vector]:
        """Correct the errors."""
        now, shall = inputs.estimate, inputs.reference
        xp = namespace(now.position)
        k_position, k_p, k_i, k_d = map(xp.asarray, (self.k_position, self.k_p, self.k_i, self.k_d))
        whole = k_position * (shall.position - now.position)
        towards = within(whole, self.max_correction)
        error = now.velocity - shall.velocity - towards
        gathered = k_i * where(towards == whole, error, 0.0)  # on the way to a far place, nothing
        trim = anti_windup(state.trim, gathered, last.wanted, last.given, dt)
        trim = clip(trim, -self.max_trim, self.max_trim)
        share = dt * self.cutoff / (1.0 + dt * self.cutoff)  # backward Euler of the low-pass
        filtered = state.filtered + share * (now.acceleration - shall.acceleration - state.filtered)
        return State(trim, filtered), -k_p * error - trim - k_d * filtered
