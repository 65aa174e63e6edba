"""The interface of plants, vehicles that move under their rotors and disturbances, and their registry."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar

import numpy as np

from quadftc_model.arrays import Components, Quaternion, Vector, namespace
from quadftc_model.numbers import prepared
from quadftc_model.parameters import Checked, parameter
from quadftc_model.registry import Registry
from quadftc_model.vehicle import Vehicle
from quadftc_sim.disturbance import Disturbance


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Plant(Checked, abc.ABC):
    """A vehicle in its disturbances.

    It may differ from the ``vehicle`` that observers and controller are designed for: in its moments of
    inertia, and in how fast its rotors are. The torques of the disturbances add. Every state has a ``q_xyzw``
    (attitude, body to earth) and a ``body_rate`` [rad/s].
    """

    flies: ClassVar[bool]  # whether it takes rotor speeds [rad/s] (..., n), or else a torque [N m] (..., 3)
    traceable: ClassVar[bool] = True  # whether a compiler can trace it

    vehicle: Vehicle
    disturbances: tuple[Disturbance, ...] = ()
    motor_lag: bool = parameter(False, doc="thrust follows its command through the vehicle's first-order lag")
    motor_bandwidth: float = parameter(
        0.0, unit="rad/s", low=0.0, high=500.0, doc="of the motor lag; 0: the vehicle's own"
    )
    substeps: int = parameter(1, low=1, high=1000, doc="integration steps to a control period")
    inertia_factor: tuple[float, float, float] = parameter(
        (1.0, 1.0, 1.0), low=0.2, high=5.0, doc="true moments of inertia over those of the vehicle"
    )

    @property
    def command_size(self) -> int:
        """How many numbers a command has."""
        return len(self.vehicle.rotors.positions) if self.flies else 3

    @prepared
    def first_command(self) -> Components:
        """Command before the first one comes: no torque; in free flight hover."""
        return np.full(self.command_size, self.vehicle.hover_speed if self.flies else 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.motor_bandwidth > 0.0 and not self.motor_lag:
            raise ValueError(f"motor_bandwidth = {self.motor_bandwidth:g} rad/s: motor_lag is false")

    @prepared
    def inertia(self) -> Vector:
        """True principal moments of inertia [kg m²]."""
        return self.vehicle.inertia * np.array(self.inertia_factor)

    @prepared
    def motor_time_constant(self) -> float:
        """Time constant of the motor lag [s]."""
        own = self.vehicle.rotors.time_constant
        return 1.0 / self.motor_bandwidth if self.motor_bandwidth > 0.0 else own

    @abc.abstractmethod
    def init(self, q_xyzw: Quaternion, body_rate: Vector) -> object:
        """State at an attitude and a body rate [rad/s]."""

    @abc.abstractmethod
    def step(self, state: Any, command: Components, time: float, dt: float) -> Any:
        """Advance by ``dt`` [s] from scenario time ``time`` [s] under a command, held.

        With ``dt`` 0 the vehicle stays as it is.
        """

    @abc.abstractmethod
    def specific_force(self, state: Any, time: float) -> Vector:
        """What an ideal accelerometer measures at ``time`` [s]: (..., 3) [m/s²], body axes."""

    def disturbance(self, time: float, like: Vector) -> Vector:
        """Sum of the disturbance torques at ``time`` [N m], shaped as ``like``."""
        zeros = namespace(like).zeros_like(like)
        return sum((disturbance.at(time) for disturbance in self.disturbances), start=zeros)

    def disturbance_acceleration(self, time: float, like: Vector) -> Vector:
        """Disturbance at ``time`` [rad/s²], shaped as ``like``: its torque over the true inertia."""
        return self.disturbance(time, like) / self.inertia


plants: Registry[Plant] = Registry("plant", "quadftc_sim.plants", "quadftc.plants")
register = plants.register
