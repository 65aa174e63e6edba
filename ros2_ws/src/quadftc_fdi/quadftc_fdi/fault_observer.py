"""The interface of fault observers, and their registry."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple

from quadftc_model.arrays import Mask, Vector
from quadftc_model.assembly import NodeParameters, component_from, vehicle_from
from quadftc_model.parameters import check
from quadftc_model.registry import Registry
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FaultEstimate, FaultObserverInputs
from quadftc_model.vehicle import Vehicle


class LastWords(NamedTuple):
    """What an observer knew that has died, as far as others have heard it."""

    fault: Vector  # attitude fault [rad]
    std_dev: Vector  # its standard deviation [rad]; -1: not known
    faulty: Mask  # a fault was confirmed and had not ended
    since: Vector  # time since its onset, now [s]; 0 where there was none
    gyro_correction: Vector  # what it added to the gyro [rad/s]: minus the bias


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FaultObserver(abc.ABC):
    """Base of all fault observers: from IMU samples and torques to an estimate of the attitude fault.

    ``init`` and ``step`` take arrays with any leading axes. They bridge a sample whose attitude or rate is
    marked invalid.
    """

    has_detector: ClassVar[bool] = True  # False: its status never says faulty, its estimate has to be judged

    vehicle: Vehicle

    def __post_init__(self) -> None:
        """Check the parameters."""
        check(self)

    @abc.abstractmethod
    def init(self, inputs: FaultObserverInputs) -> Any:
        """Return the state at the first sample."""

    def resumed(self, inputs: FaultObserverInputs, last: LastWords) -> Any:
        """Return the state that resumes at a sample where another observer of this kind has died.

        Its fault is assumed to last; by default the observer starts at the attitude without it.
        """
        return self.init(without_fault(inputs, last.fault))

    @abc.abstractmethod
    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Advance by ``dt`` [s] to a sample; 0 at the first one."""


def without_fault(inputs: FaultObserverInputs, fault: Vector) -> FaultObserverInputs:
    """Inputs with the attitude that the sensor would read without a fault [rad]."""
    angles = euler_from_quaternion(inputs.imu.q_xyzw) - fault
    return inputs._replace(imu=inputs.imu._replace(q_xyzw=quaternion_from_euler(angles)))


fault_observers: Registry[Any] = Registry(
    "fault observer", "quadftc_fdi.fault_observers", "quadftc.fault_observers"
)
register = fault_observers.register


def fault_observer_from(parameters: NodeParameters) -> FaultObserver:
    """Build the observer from the parameters of its node; ValueError names the one that is wrong.

    They are vehicle, observer (its name), and ``<observer>.<parameter>``. Others are ignored.
    """
    return component_from(fault_observers, parameters, "observer", vehicle=vehicle_from(parameters))
