"""Reduced attitude control: the direction of the thrust is held, and yaw turns as it may.

Where rotors are so weak that no yaw torque is left in hover, the vehicle will spin. The direction of its
thrust can still be controlled. Sources: Mueller and D'Andrea (2014), Stability and control of a quadrocopter
despite the complete loss of one, two, or three propellers, IEEE ICRA. Sun, Sijbers, Wang and de Visser
(2018), High-speed flight of quadrotor despite loss of single rotor, IEEE RA-L 3(4).

A vehicle that spins is a top. Let e be the rotation vector from body z to the wanted direction, and
omega_t = (p, q, 0) the rate across body z. A steady omega_t takes the gyroscopic torque J_z r (q, -p, 0). The
law gives that of the rate which it wants, not of the one that is there:

    omega_w = k_direction e ,  |omega_w| <= agility m g l / (J_z |r|)
    tau = J k_rate (omega_w - omega_t) + J_z r (omega_w,y , -omega_w,x , 0) ,   tau_z = -k_yaw J_z r

So it damps the nutation and never fights it, and in the end the direction follows by exp(-k_direction t). To
cancel the gyroscopic torque of omega_t would take more than the rotors have, at 20 rad/s. Cut off, it holds
the vehicle in a steady turn about a tilted axis. The bound is what a share of the weight can do at the
arm l of the rotors.

The rotors have a time constant T_m, and a command is held for dt. In body axes, the torque for omega_w turns
by -r, and omega_t itself by (J_z - J_x) r / J_x. Each part leads by T_m + dt/2 of its own turning.

Deviation: both papers control an axis that may be tilted in the body, and cancel the gyroscopic torque. Here
the axis is body z. What the rotor opposite to one that is off gives in the mean tilts it all the same.

:class:`Enduring` flies any controller, and this law instead while the effectiveness of the rotors says so.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_control.controller import Controller
from quadftc_control.sliding_surface import tracking
from quadftc_model.arrays import (
    Components,
    Flag,
    Scalar,
    Vector,
    arctan2,
    branch,
    clip,
    components,
    larger,
    namespace,
    smaller,
    sqrt,
    stacked,
    where,
)
from quadftc_model.parameters import Checked, parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, to_body, to_earth
from quadftc_model.samples import AttitudeReference, ControllerInputs, ControllerOutput, ImuSample
from quadftc_model.vehicle import Vehicle
from quadftc_model.wrench_set import extremes, limits

UP = np.array([0.0, 0.0, 1.0])  # 1; along body z


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ReducedAttitude(Checked):
    """The law, and where it takes over."""

    k_direction: float = parameter(6.0, unit="1/s", low=0.0, doc="direction error to rate")
    k_rate: float = parameter(10.0, unit="1/s", low=0.0, doc="rate error to acceleration")
    agility: float = parameter(0.5, low=0.0, doc="largest gyroscopic torque asked for, of weight times reach")
    slowest: float = parameter(2.0, unit="rad/s", low=0.1, doc="yaw rate that bounds the rate asked for")
    k_yaw: float = parameter(2.0, unit="1/s", low=0.0, doc="yaw rate to acceleration")
    enter: float = parameter(
        0.1, low=0.0, high=1.0, doc="yaw torque left in hover, of that of healthy rotors"
    )
    leave: float = parameter(0.2, low=0.0, high=1.0, doc="the same, from which yaw is controlled again")
    still: float = parameter(0.8, unit="rad/s", low=0.01, doc="largest yaw rate at which it is")

    def torque(self, vehicle: Vehicle, imu: ImuSample, reference: AttitudeReference, dt: float) -> Vector:
        """Torque [N m] (..., 3) that turns body z to where the reference has it at the present yaw."""
        p, q, r = components(imu.body_rate)
        x, y, z = components(wanted_direction(imu, reference))
        (jx, jy, jz), lag = components(vehicle.inertia), vehicle.rotors.time_constant + 0.5 * dt
        # the rate wanted, along e: about (-y, x, 0), by the angle between body z and the direction
        across = sqrt(x * x + y * y)
        bound = self.agility * vehicle.weight * vehicle.reach / (jz * larger(abs(r), self.slowest))
        speed = smaller(self.k_direction * arctan2(across, z), bound) / larger(across, 1e-9)
        wx, wy = -speed * y, speed * x
        # what it takes as the vehicle spins, and what damps, each as it will be when the rotors have it
        k = self.k_rate
        tx, ty = jx * k * wx + jz * r * wy, jy * k * wy - jz * r * wx
        p, q = p + lag * (jy - jz) / jx * q * r, q + lag * (jz - jx) / jy * p * r
        lead = r * lag
        return stacked([tx + lead * ty - jx * k * p, ty - lead * tx - jy * k * q, -self.k_yaw * jz * r])

    def takes_over(self, vehicle: Vehicle, active: Flag, imu: ImuSample, effectiveness: Components) -> Flag:
        """Whether this law flies (...), where it did (``active``) or not at the sample before."""
        left = yaw_left(vehicle, effectiveness)
        turning = abs(components(imu.body_rate)[2]) > self.still
        return where(active, (left < self.leave) | turning, left < self.enter)


def yaw_left(vehicle: Vehicle, effectiveness: Components) -> Scalar:
    """Yaw torque that weak rotors have left in hover, the weaker way, of that of healthy ones (...) [1].

    Negative where they cannot hover without turning, or not at all.
    """
    xp, whole = namespace(effectiveness), vehicle.wrench_set
    bounds = limits(vehicle, clip(effectiveness, 0.0, 1.0))
    level = xp.zeros_like(bounds[..., :2])
    hover = xp.concatenate([vehicle.weight + level[..., :1], level], axis=-1)
    least, most = extremes(whole.yaw, bounds, hover)
    _, highest = extremes(whole.thrust, bounds, level)
    return where(highest < vehicle.weight, -1.0, smaller(most, -least) / vehicle.hover_yaw)


def wanted_direction(imu: ImuSample, reference: AttitudeReference) -> Vector:
    """Direction (..., 3) in body axes of body z at the wanted roll and pitch, and the present yaw."""
    yaw = euler_from_quaternion(imu.q_xyzw)[..., 2:]
    angles = namespace(yaw).concatenate([reference.angles[..., :2], yaw], axis=-1)
    return to_body(imu.q_xyzw, to_earth(quaternion_from_euler(angles), UP))


class State(NamedTuple):
    """State at the last sample."""

    law: object  # of the controller
    active: Flag  # the reduced attitude is controlled instead


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Enduring(Checked):
    """A controller, and reduced attitude control instead of it while the rotors leave no yaw torque.

    On the test stand, and with an effectiveness of 1, it is the controller, bit for bit. When the controller
    comes back it starts anew, so that nothing has wound up meanwhile.
    """

    law: Controller
    reduced: ReducedAttitude = dataclasses.field(default_factory=ReducedAttitude)

    def init(self, inputs: ControllerInputs) -> State:
        """Start with the controller."""
        return State(self.law.init(inputs), inputs.imu.attitude_valid & False)

    def step(self, state: State, inputs: ControllerInputs, dt: float) -> tuple[State, ControllerOutput]:
        """Compute the torque for a sample."""
        if inputs.rotors is None:
            law, output = self.law.step(state.law, inputs, dt)
            return State(law, state.active), output
        weak = inputs.rotors.effectiveness
        active = self.reduced.takes_over(self.law.vehicle, state.active, inputs.imu, weak)
        law, output = branch(
            active, lambda: self._reduced(inputs, dt), lambda: self.law.step(state.law, inputs, dt)
        )
        return State(law, active), output

    def _reduced(self, inputs: ControllerInputs, dt: float) -> tuple[object, ControllerOutput]:
        """State of the controller that starts anew, and the torque that controls the direction."""
        torque = self.reduced.torque(self.law.vehicle, inputs.imu, inputs.reference, dt)
        zeros = namespace(torque).zeros_like(torque)
        return self.law.init(inputs), ControllerOutput(torque, tracking(inputs).x1e, zeros, zeros > 0.0)
