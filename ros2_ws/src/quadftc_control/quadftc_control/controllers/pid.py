"""Cascaded PID, as autopilots fly: proportional on the angles, PID on the body rates.

    rate setpoint = body rate of (reference rates - k_angle x1e)
    u = J (k_p e + k_i int e - k_d omega') ,  e = rate setpoint - omega

The structure of PX4's and ArduPilot's multicopter attitude control: the derivative acts on the measured rate,
low-passed; the disturbance estimate is not used.
"""

from __future__ import annotations

from typing import NamedTuple

from quadftc_control.controller import Controller, anti_windup, limited, register
from quadftc_control.sliding_surface import tracking
from quadftc_model.arrays import Vector, namespace
from quadftc_model.parameters import Axes, parameter
from quadftc_model.rotations import body_rates
from quadftc_model.samples import ControllerInputs, ControllerOutput


class State(NamedTuple):
    """Controller state at the last sample."""

    integral: Vector  # of minus the rate error [rad]
    filtered: Vector  # body rate, low-passed [rad/s]
    wanted: Vector  # torque before the limits [N m]
    given: Vector  # torque after the limits [N m]


@register("pid")
class Pid(Controller):
    """Angle P, rate PID; gains are angular accelerations, so they fit a vehicle of any size."""

    k_angle: Axes = parameter((6.0, 6.0, 3.0), unit="1/s", low=0.0, doc="angle to rate setpoint")
    k_p: Axes = parameter((20.0, 20.0, 10.0), unit="1/s", low=0.0, doc="rate error")
    k_i: Axes = parameter((20.0, 20.0, 10.0), unit="1/s^2", low=0.0, doc="its integral")
    k_d: Axes = parameter((0.1, 0.1, 0.0), unit="1", low=0.0, doc="rate derivative")
    cutoff: float = parameter(
        190.0, unit="rad/s", low=1e-3, doc="low-pass of the rate before its derivative (30 Hz)"
    )

    def init(self, inputs: ControllerInputs) -> State:
        """Start with the integral at zero."""
        rate = inputs.imu.body_rate
        zeros = namespace(rate).zeros_like(rate)
        return State(zeros, rate, zeros, zeros)

    def step(self, state: State, inputs: ControllerInputs, dt: float) -> tuple[State, ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        xp = namespace(track.x1e)
        k_angle, k_p, k_i, k_d = map(xp.asarray, (self.k_angle, self.k_p, self.k_i, self.k_d))
        rate = inputs.imu.body_rate
        setpoint = body_rates(track.x1, inputs.reference.rates - k_angle * track.x1e)
        error = setpoint - rate
        integral = anti_windup(state.integral, -error, state.wanted, state.given, dt)
        # backward Euler of the low-pass; its slope is the derivative
        filtered = state.filtered + dt * self.cutoff / (1.0 + dt * self.cutoff) * (rate - state.filtered)
        slope = self.cutoff * (rate - filtered)
        wanted = self.vehicle.inertia * (k_p * error - k_i * integral - k_d * slope)
        given, cut = limited(self.vehicle, wanted)
        output = ControllerOutput(given, track.x1e, xp.zeros_like(error), cut)
        return State(integral, filtered, wanted, given), output
