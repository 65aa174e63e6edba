"""Proportional-derivative, the least that holds an attitude: a small controller."""

from quadftc_control.controller import Controller, limited, register
from quadftc_control.sliding_surface import tracking
from quadftc_model.arrays import namespace
from quadftc_model.parameters import parameter
from quadftc_model.samples import ControllerInputs, ControllerOutput


@register("pd")
class Pd(Controller):
    """Torque from angle and rate error."""

    stiffness: float = parameter(30.0, unit="1/s^2", low=0.0, doc="angular acceleration per angle error")
    damping: float = parameter(10.0, unit="1/s", low=0.0, doc="angular acceleration per rate error")

    def init(self, inputs: ControllerInputs) -> tuple[()]:
        """Return no state."""
        return ()

    def step(
        self, state: tuple[()], inputs: ControllerInputs, dt: float
    ) -> tuple[tuple[()], ControllerOutput]:
        """Compute the torque for a sample."""
        track = tracking(inputs)
        wanted = -self.vehicle.inertia * (self.stiffness * track.x1e + self.damping * track.x1e_dot)
        given, cut = limited(self.vehicle, wanted)
        return state, ControllerOutput(given, track.x1e, namespace(wanted).zeros_like(wanted), cut)
