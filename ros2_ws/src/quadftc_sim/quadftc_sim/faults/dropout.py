"""Samples that are missing: the whole message (``imu``), or one channel of it, marked absent (REP-145)."""

from typing import ClassVar

from quadftc_model.parameters import parameter
from quadftc_sim.fault import Fault, FaultInputs, FaultOutput, register


@register("dropout")
class Dropout(Fault):
    """Each sample is missing with a probability; 1: all of them."""

    is_random: ClassVar[bool] = True
    channels: ClassVar[tuple[str, ...]] = ("attitude", "gyro", "accelerometer", "imu")
    whole_channel: ClassVar[bool] = True

    probability: float = parameter(
        1.0, unit="1", low=0.0, high=1.0, doc="probability that a sample is missing"
    )

    def step(self, state: tuple[()], inputs: FaultInputs, dt: float) -> tuple[tuple[()], FaultOutput]:
        """Leave the value, and say whether it is there."""
        return state, FaultOutput(inputs.value, inputs.uniform[..., 0] >= self.probability)
