"""Incremental nonlinear dynamic inversion: Smeur, Chu and de Croon (2016); with angles, Smeur et al. (2018).

    x1'' = x1d'' - k_rate (x1e' + k_angle x1e)        wanted acceleration of the Euler angles
    u = tau_f + J (omega_d' - omega_f')               omega_d': body acceleration that gives x1''

omega_f' is the derivative of the gyro and tau_f the torque of the rotors. Both are behind the same
second-order Butterworth filter, so they belong to the same time. The difference of J omega_f' and tau_f is
whatever else turns the vehicle: gyroscopic torque, drag, disturbances, and what is wrong with J. The law
needs no model of it and no disturbance estimate. A torque that was cut enters tau_f as it was given: nothing
winds up.

The torque of the rotors is that of measured speeds where there are some. Otherwise it is the last command
behind a first-order lag: their model in Smeur et al. (2016), section II.C. A lag that the rotors do not have
makes the law slower to reject disturbances; one that the model lacks makes it oscillate.

Rotors that accelerate turn the vehicle by their inertia, about z and before their drag does. The torque tau_s
of steady speeds then acts as tau_s + kappa tau_s' (G_2 of Smeur et al. 2016). Where speeds are measured,
tau_f has this part. A low-pass of time constant kappa in the yaw command takes the lead out of the loop. The
paper's test stand has no such torque, and no measured speeds.

The effectiveness matrix is in the allocation, which undoes it. Where rotors are weak, tau_f has to be the
torque of the thrusts that they really give. Whoever turns speeds into torque must know how weak they are.

Deviations: increments are torques, not rotor commands; full kinematics (see sliding_surface).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quadftc_control.controller import Controller, limited, register
from quadftc_control.sliding_surface import tracking
from quadftc_model.arrays import Flag, Vector, column, exp, larger, namespace, where
from quadftc_model.numbers import prepared
from quadftc_model.parameters import Axes, parameter
from quadftc_model.rotations import body_acceleration
from quadftc_model.samples import ControllerInputs, ControllerOutput

ABOUT_Z = np.array([0.0, 0.0, 1.0])  # 1
DAMPING = 2.0 * math.sqrt(0.5)  # 1; twice the damping ratio of a Butterworth filter of second order


class Filtered(NamedTuple):
    """A signal behind the filter."""

    last: Vector  # signal at the last sample
    value: Vector  # filtered
    slope: Vector  # its derivative


class State(NamedTuple):
    """Controller state at the last sample."""

    rate: Filtered  # body rate [rad/s]
    torque: Filtered  # of the rotors, mean between two samples [N m]
    rotors: Vector  # torque of the rotors [N m]
    wanted: Vector  # torque that shall act, after the limits [N m]
    given: Vector  # torque that is commanded for it [N m]


@register("indi")
class Indi(Controller):
    """Increments of torque by the angular acceleration that the gyro measures."""

    k_angle: Axes = parameter((3.5, 3.5, 2.5), unit="1/s", low=0.0, doc="angle error to angle rate")
    k_rate: Axes = parameter((9.0, 9.0, 9.0), unit="1/s", low=0.0, doc="angle rate error to acceleration")
    cutoff: float = parameter(80.0, unit="rad/s", low=1.0, doc="of the filter of gyro and torque")
    motor_bandwidth: float = parameter(
        0.0, unit="rad/s", low=0.0, high=1000.0, doc="of the rotors' lag in the model; 0: the vehicle's own"
    )
    measured_torque: bool = parameter(True, doc="use the rotor speeds that are measured, if any are")

    def init(self, inputs: ControllerInputs) -> State:
        """Start without torque, at rest for the filters."""
        rate = inputs.imu.body_rate
        zeros = namespace(rate).zeros_like(rate)
        known, torque = self._measured(inputs)
        torque = where(known, torque, zeros)
        return State(Filtered(rate, rate, zeros), Filtered(torque, torque, zeros), torque, zeros, zeros)

    def step(self, state: State, inputs: ControllerInputs, dt: float) -> tuple[State, ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        xp = namespace(track.x1e)
        inertia, k_angle, k_rate = map(xp.asarray, (self.vehicle.inertia, self.k_angle, self.k_rate))

        # angular acceleration, and the torque of the same time
        rate = self._filter(state.rate, inputs.imu.body_rate, dt)
        acceleration = 0.5 * (state.rate.slope + rate.slope)  # of the filtered rate, between the samples
        known, measured = self._measured(inputs)
        mean, now = self._modelled(state, dt)
        mean, now = where(known, 0.5 * (state.rotors + measured), mean), where(known, measured, now)
        torque = self._filter(state.torque, mean, dt)
        acting = torque.value + where(known, self.spin_up * ABOUT_Z * torque.slope, 0.0)

        wanted_slope = track.x1e_dot + k_angle * track.x1e
        x1_ddot = inputs.reference.accelerations - k_rate * wanted_slope
        omega_dot = body_acceleration(track.x1, track.x1_dot, x1_ddot)
        asked = acting + inertia * (omega_dot - acceleration)
        wanted, cut = limited(self.vehicle, asked, inputs.effectiveness)
        given = wanted
        if inputs.rotors is not None:
            low_passed = state.given + (1.0 - exp(-dt / self.spin_up)) * (wanted - state.given)
            given = where(column(inputs.rotors.measured) & (ABOUT_Z > 0.0), low_passed, wanted)
        output = ControllerOutput(given, track.x1e, xp.zeros_like(given), cut)
        return State(rate, torque, now, wanted, given), output

    @prepared
    def rotor_bandwidth(self) -> float:
        """Bandwidth of the rotors in the model [rad/s]."""
        return self.motor_bandwidth or 1.0 / self.vehicle.rotors.time_constant

    @prepared
    def spin_up(self) -> float:
        """kappa: change of a rotor's momentum over that of its drag torque, around hover [s]."""
        rotors = self.vehicle.rotors
        drag = 2.0 * rotors.torque_to_thrust * rotors.thrust_coefficient * self.vehicle.hover_speed
        return max(rotors.rotor_inertia / drag, 1e-6)

    def _measured(self, inputs: ControllerInputs) -> tuple[Flag, Vector]:
        """Whether the torque of the rotors is known of measured speeds (..., 1), and that torque [N m]."""
        if self.measured_torque and inputs.rotors is not None:
            return column(inputs.rotors.measured), inputs.rotors.torque
        zeros = namespace(inputs.imu.body_rate).zeros_like(inputs.imu.body_rate)
        return column(inputs.imu.rate_valid & False), zeros

    def _modelled(self, state: State, dt: float) -> tuple[Vector, Vector]:
        """Torque of the rotors by the last command: its mean since the last sample, and now [N m]."""
        # exact for a first-order lag and a command that is held
        steps = larger(self.rotor_bandwidth * dt, 1e-6)
        reached = 1.0 - exp(-steps)
        change = state.wanted - state.rotors
        return state.rotors + (1.0 - reached / steps) * change, state.rotors + reached * change

    def _filter(self, state: Filtered, signal: Vector, dt: float) -> Filtered:
        """Butterworth filter of second order, discretised by the trapezoidal rule."""
        half = 0.5 * dt
        stiffness, damping = self.cutoff**2, DAMPING * self.cutoff
        pull = half * stiffness * (state.last + signal - 2.0 * state.value)
        reach = half * (damping + half * stiffness)
        slope = ((1.0 - reach) * state.slope + pull) / (1.0 + reach)
        return Filtered(signal, state.value + half * (state.slope + slope), slope)
