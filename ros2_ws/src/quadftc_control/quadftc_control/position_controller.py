"""The interface of position controllers, their registry, and what they share: acceleration to attitude.

A law says which acceleration it wants. The thrust, along body z, has to give it, and to carry the weight.
That vector is limited, says roll, pitch and thrust, and the attitude goes through a command filter. So the
angles have rates and accelerations that fit them, and turn no faster than the rotors can turn the vehicle.

What the trajectory asks for is known ahead. It is asked for earlier, by its jerk and yaw rate, by what lags:
the filter (2 / bandwidth), and for the thrust the rotors. The attitude control follows the filter, which
tells it rates and accelerations. The drag at the trajectory's speed is made up for, too. Source: Faessler,
Franchi and Scaramuzza (2018), Differential flatness of quadrotor dynamics subject to rotor drag, IEEE RA-L
3(2).

A vehicle that spins, as it has lost a rotor, turns roll and pitch of one direction of thrust with it. The
filter would lag behind them; so it is left out, and the yaw of the command is the measured one.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from quadftc_control.reference import filtered
from quadftc_model.arrays import (
    Flag,
    Scalar,
    Vector,
    arctan2,
    chosen,
    clip,
    components,
    cos,
    larger,
    length,
    namespace,
    norm,
    sin,
    smaller,
    sqrt,
    stacked,
    tan,
    where,
)
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.numbers import prepared
from quadftc_model.parameters import parameter
from quadftc_model.registry import Registry
from quadftc_model.rotations import euler_from_quaternion, to_earth
from quadftc_model.samples import (
    AIR_DENSITY,
    STANDARD_GRAVITY,
    AttitudeCommand,
    AttitudeReference,
    ImuSample,
    PositionEstimate,
    PositionReference,
)

UP = np.array([0.0, 0.0, 1.0])  # 1; along z
SPINNING, STILL = 2.0, 1.0  # rad/s; yaw rate that nobody asks for, from which on, and until when, it spins
LEAST_ASIDE = 0.2  # 1; of the largest thrust: what the level part has however much height needs


class PositionControllerInputs(NamedTuple):
    """What a position controller sees."""

    imu: ImuSample  # corrected
    estimate: PositionEstimate
    reference: PositionReference


class Pushed(NamedTuple):
    """Acceleration that a law wants beyond that of the trajectory, and what the limits leave of it."""

    wanted: Vector  # [m/s²]
    given: Vector  # [m/s²]


class State(NamedTuple):
    """State at the last sample."""

    law: object  # of the law
    last: Pushed
    reference: AttitudeReference  # of the command filter
    spins: Flag  # the vehicle turns about its thrust, faster than anybody asks for


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionController(VehicleLaw[PositionControllerInputs, AttitudeCommand]):
    """Base of all position controllers: from where the vehicle is and shall be, to attitude and thrust.

    A law has :meth:`start` and :meth:`push`.
    """

    max_tilt: float = parameter(
        math.radians(35.0), unit="rad", low=0.01, high=1.3, doc="largest tilt of the wanted thrust"
    )
    min_thrust: float = parameter(0.1, low=0.01, high=0.5, doc="least vertical thrust, of the largest")
    max_thrust: float = parameter(0.9, low=0.1, high=1.0, doc="largest thrust, of the largest")
    bandwidth: float = parameter(
        15.0, unit="rad/s", low=1.0, high=50.0, doc="natural frequency of the command filter"
    )
    agility: float = parameter(
        0.5,
        low=0.01,
        high=1.0,
        doc="largest angular acceleration of the commands, of what the rotors can give",
    )

    @prepared
    def turning(self) -> Vector:
        """Largest angular acceleration of the commands, (3,) [rad/s²]."""
        return self.agility * self.vehicle.authority / self.vehicle.inertia

    @abc.abstractmethod
    def start(self, inputs: PositionControllerInputs) -> object:
        """State of the law at the first sample."""

    @abc.abstractmethod
    def push(
        self, state: Any, inputs: PositionControllerInputs, last: Pushed, dt: float
    ) -> tuple[object, Vector]:
        """State and acceleration (..., 3) [m/s²] that shall correct the errors, earth axes.

        ``last`` is what was wanted and given at the sample before.
        """

    def init(self, inputs: PositionControllerInputs) -> State:
        """Start from the present attitude, still."""
        angles = euler_from_quaternion(inputs.imu.q_xyzw)
        zeros = namespace(angles).zeros_like(angles)
        reference = AttitudeReference(angles, zeros, zeros)
        return State(self.start(inputs), Pushed(zeros, zeros), reference, inputs.imu.rate_valid & False)

    def step(
        self, state: State, inputs: PositionControllerInputs, dt: float
    ) -> tuple[State, AttitudeCommand]:
        """Compute attitude and thrust for a sample."""
        imu, shall = inputs.imu, inputs.reference
        law, wanted = self.push(state.law, inputs, state.last, dt)
        whole = self._planned(shall) + wanted + STANDARD_GRAVITY * UP
        force = self._limited(whole)
        given = wanted - (whole - force)  # the same if not cut
        angles = euler_from_quaternion(imu.q_xyzw)
        spins = self._spins(state, imu)
        # roll and pitch at the yaw to come, and through the filter; if it spins, at the present yaw and as is
        turn = 2.0 / self.bandwidth * shall.yaw_rate
        roll, pitch = _tilt(force, where(spins, angles[..., 2], angles[..., 2] + turn))
        setpoint = stacked([roll, pitch, shall.yaw + turn])
        held = filtered(state.reference, setpoint, self.bandwidth, self.turning, dt)
        zeros = namespace(angles).zeros_like(angles)
        spun = AttitudeReference(stacked([roll, pitch, angles[..., 2]]), zeros, zeros)
        reference = chosen(spins, spun, held)
        command = AttitudeCommand(reference, self._thrust(imu, force, spins))
        return State(law, Pushed(wanted, given), reference, spins), command

    def _spins(self, state: State, imu: ImuSample) -> Flag:
        """Whether the vehicle spins (...): its yaw is nobody's, and its roll and pitch turn with it."""
        rate, asked = imu.body_rate[..., 2], state.reference.rates[..., 2]
        begins = (abs(rate) > SPINNING) & (abs(rate - asked) > SPINNING)
        return where(state.spins, abs(rate) > STILL, begins)

    def _planned(self, reference: PositionReference) -> Vector:
        """Acceleration that the trajectory asks for and drag takes [m/s²] (..., 3), earlier by what lags."""
        x, y, z = components(reference.acceleration)
        jx, jy, jz = components(reference.jerk)
        u, v, _ = components(reference.velocity)
        lag, drag = 2.0 / self.bandwidth, self.drag(length(reference.velocity[..., :2]))
        z_earlier = z + self.vehicle.rotors.time_constant * jz
        return stacked([x + lag * jx + drag * u, y + lag * jy + drag * v, z_earlier])

    def drag(self, speed: Scalar) -> Scalar:
        """Deceleration over level speed [1/s] in still air, of the rotors and of the body."""
        vehicle = self.vehicle
        air = vehicle.aerodynamics
        rotors = air.rotor_drag * len(vehicle.rotors.positions) * vehicle.hover_speed
        return (rotors + 0.5 * AIR_DENSITY * air.drag_area[0] * speed) / vehicle.mass

    def _limited(self, force: Vector) -> Vector:
        """Force over mass [m/s²] (..., 3), earth axes, within tilt and thrust; height comes first."""
        aside, up = force[..., :2], force[..., 2:]
        largest = self.vehicle.thrust_max / self.vehicle.mass
        top = self.max_thrust * largest
        up = clip(up, self.min_thrust * largest, top)
        # at the top of the thrust, a little is left for the level part all the same
        left = sqrt(clip(top * top - up * up, (LEAST_ASIDE * top) ** 2, top * top))
        bound = smaller(up * tan(self.max_tilt), left)
        scale = bound / larger(norm(aside), bound)
        return namespace(force).concatenate([scale * aside, up], axis=-1)

    def _thrust(self, imu: ImuSample, force: Vector, spins: Flag) -> Scalar:
        """Thrust [N] (...): the wanted force over mass, along body z as it is now.

        A vehicle that begins to spin is tilted far, and its thrust is what turns it back: it is kept then.
        """
        along = (to_earth(imu.q_xyzw, UP) * force).sum(axis=-1)
        along = where(spins, length(force) + smaller(along, 0.0), along)
        largest = self.vehicle.thrust_max
        return clip(self.vehicle.mass * along, self.min_thrust * largest, self.max_thrust * largest)


def _tilt(force: Vector, yaw: Scalar) -> tuple[Scalar, Scalar]:
    """Roll and pitch [rad] that turn body z along a force, at a yaw [rad]."""
    x, y, z = components(force)
    ahead, left = cos(yaw) * x + sin(yaw) * y, cos(yaw) * y - sin(yaw) * x
    return arctan2(-left, sqrt(ahead * ahead + z * z)), arctan2(ahead, z)


position_controllers: Registry[PositionController] = Registry(
    "position controller", "quadftc_control.position_controllers", "quadftc.position_controllers"
)
register = position_controllers.register
position_controller_from = law_from(position_controllers, "position_controller")  # of its node
