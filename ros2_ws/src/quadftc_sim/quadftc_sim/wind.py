"""The interface of winds, velocities of the air over scenario time, and their registry."""

import dataclasses

from quadftc_model.registry import Registry
from quadftc_sim.disturbance import Acting


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Wind(Acting):
    """Base of all winds: velocities of the air [m/s], earth axes; those of a scenario add up."""


winds: Registry[Wind] = Registry("wind", "quadftc_sim.winds", "quadftc.winds")
register = winds.register
