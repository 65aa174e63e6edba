"""No disturbance observer: the estimate is zero, and the controller stands alone."""

from __future__ import annotations

from typing import Any

from quadftc_fdi.disturbance_observer import DisturbanceObserver, register
from quadftc_model.arrays import Array, namespace
from quadftc_model.samples import DisturbanceObserverInputs


@register("none")
class NoDisturbanceObserver(DisturbanceObserver):
    """Says zero."""

    def init(self, inputs: DisturbanceObserverInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: Any, inputs: DisturbanceObserverInputs, dt: float) -> tuple[Any, Array]:
        """Return zero [rad/s²] (..., 3)."""
        return state, namespace(inputs.body_rate).zeros_like(inputs.body_rate)
