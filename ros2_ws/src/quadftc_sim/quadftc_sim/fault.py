"""The interface of sensor faults: what a fault makes of one channel of the IMU sample, and their registry.

A channel is three numbers: the attitude as Euler angles [rad], the gyro [rad/s], or the accelerometer [m/s²].
A fault whose size has the channel's unit says ``unit="{channel}"``.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple

from quadftc_model.arrays import Flag, Scalar, Vector, namespace
from quadftc_model.parameters import Checked
from quadftc_model.registry import Registry


class FaultInputs(NamedTuple):
    """One sample of the channel, healthy."""

    value: Vector  # (..., 3)
    elapsed: Scalar  # time since the onset [s] (...); negative before it
    normal: Vector  # (..., 3) standard normal numbers
    uniform: Vector  # (..., 3) numbers uniform in [0, 1)


class FaultOutput(NamedTuple):
    """The channel as the fault leaves it."""

    value: Vector  # (..., 3)
    valid: Flag  # (...); False: the channel is missing from this sample


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fault(Checked, abc.ABC):
    """Base of all faults.

    ``step`` is called from the onset on; with ``has_memory``, on every sample before it too.
    """

    has_memory: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    channels: ClassVar[tuple[str, ...]] = ("attitude", "gyro", "accelerometer")
    whole_channel: ClassVar[bool] = False  # the fault cannot be put on some of the axes only

    def for_period(self, period: float) -> Fault:
        """Return the fault for samples that are ``period`` [s] apart; most are the same for any.

        One whose state has a number of samples fixes it here.
        """
        return self

    def init(self, value: Vector) -> object:
        """Return the state at the first sample (..., 3); most faults have none."""
        return ()

    @abc.abstractmethod
    def step(self, state: Any, inputs: FaultInputs, dt: float) -> tuple[object, FaultOutput]:
        """Return the state and the channel with the fault on all three axes."""


def present(value: Vector) -> FaultOutput:
    """Return an output of which nothing is missing."""
    return FaultOutput(value, namespace(value).ones_like(value[..., 0], dtype=bool))


faults: Registry[Fault] = Registry("fault", "quadftc_sim.faults", "quadftc.faults")
register = faults.register
