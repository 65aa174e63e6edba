"""The interface of sensor faults: what a fault makes of one channel of the IMU sample, and their registry.

A channel is three numbers: the attitude as Euler angles [rad], the gyro [rad/s], or the accelerometer [m/s²].
A fault whose size has the channel's unit says ``unit="{channel}"``.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import Any, ClassVar, NamedTuple

import numpy as np

from quadftc_model.arrays import Array, Scalar, is_single, namespace
from quadftc_model.parameters import Checked
from quadftc_model.registry import Registry


class FaultInputs(NamedTuple):
    """One sample of the channel, healthy."""

    value: Array  # (..., 3)
    elapsed: Scalar  # time since the onset [s]; negative before it
    normal: Array  # (..., 3) standard normal numbers
    uniform: Array  # (..., 3) numbers uniform in [0, 1)


class FaultOutput(NamedTuple):
    """The channel as the fault leaves it."""

    value: Array  # (..., 3)
    valid: Any  # (...,) bool; False: the channel is missing from this sample


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fault(Checked, abc.ABC):
    """Base of all faults.

    ``step`` is called from the onset on; with ``has_memory``, on every sample before it too.
    """

    has_memory: ClassVar[bool] = False
    is_random: ClassVar[bool] = False
    channels: ClassVar[tuple[str, ...]] = ("attitude", "gyro", "accelerometer")
    whole_channel: ClassVar[bool] = False  # the fault cannot be put on some of the axes only

    def init(self, value: Array) -> Any:
        """Return the state at the first sample (..., 3); most faults have none."""
        return ()

    @abc.abstractmethod
    def step(self, state: Any, inputs: FaultInputs, dt: float) -> tuple[Any, FaultOutput]:
        """Return the state and the channel with the fault on all three axes."""


def present(value: Array) -> FaultOutput:
    """Return an output of which nothing is missing."""
    whole = np.bool_(True) if is_single(value) else namespace(value).ones_like(value[..., 0], dtype=bool)
    return FaultOutput(value, whole)


faults: Registry[Any] = Registry("fault", "quadftc_sim.faults", "quadftc.faults")
register = faults.register
