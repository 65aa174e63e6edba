"""The interface of fault observers and their registry."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

from quadftc_model.conditions import Circumstances, Condition, Trace, unknown_theory
from quadftc_model.parameters import check
from quadftc_model.registry import Registry
from quadftc_model.samples import FaultEstimate, FaultObserverInputs
from quadftc_model.vehicle import Vehicle


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FaultObserver(abc.ABC):
    """Base of all fault observers: from IMU samples and torques to an estimate of the attitude fault.

    ``init`` and ``step`` take arrays with any leading axes; a sample whose attitude or rate is marked invalid
    is bridged.
    """

    vehicle: Vehicle

    def __post_init__(self) -> None:
        """Check the parameters."""
        check(self)

    @abc.abstractmethod
    def init(self, inputs: FaultObserverInputs) -> Any:
        """Return the state at the first sample."""

    @abc.abstractmethod
    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Advance by ``dt`` [s] to a sample; 0 at the first one."""

    def conditions(self, given: Circumstances) -> list[Condition]:
        """Judge what the observer's theory asks for."""
        return unknown_theory(type(self).__name__)

    def conditions_along(self, trace: Trace, given: Circumstances) -> list[Condition]:
        """Judge the observer's Lyapunov functions along a recorded run; none by default."""
        return []


fault_observers: Registry[Any] = Registry(
    "fault observer", "quadftc_fdi.fault_observers", "quadftc.fault_observers"
)
register = fault_observers.register
