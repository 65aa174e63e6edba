"""The interface of attitude controllers and their registry."""

from __future__ import annotations

import dataclasses

from quadftc_control.weak_allocation import reachable_in_hover
from quadftc_model.arrays import Components, Mask, Vector, branch, where
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.registry import Registry
from quadftc_model.rotors import attainable
from quadftc_model.samples import ControllerInputs, ControllerOutput
from quadftc_model.vehicle import Vehicle


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Controller(VehicleLaw[ControllerInputs, ControllerOutput]):
    """Base of all controllers: from attitude, body rate, reference and disturbance estimate to a torque.

    The torque of every controller has gone through :func:`limited`: the rotors can give it.
    """

    def without_estimate(self, missing: float) -> Controller:
        """Return the law to fly with where ``missing`` (0..1) of the disturbance estimate is missing.

        Continuous in ``missing``, and with 0 this law. By default it is this law always.
        """
        return self


def limited(vehicle: Vehicle, torque: Vector, effectiveness: Components | None = None) -> tuple[Vector, Mask]:
    """Torque [N m] (..., 3) within the authority, and where it was cut (..., 3) bool.

    With the ``effectiveness`` of the rotors (..., n), it is also one that weak rotors can give in hover.
    """
    within = given = attainable(vehicle, torque)
    if effectiveness is not None:
        given = branch(
            (effectiveness < 1.0).any(axis=-1),
            lambda: reachable_in_hover(vehicle, within, effectiveness),
            lambda: within,
        )
    return given, given != torque


def anti_windup(integral: Vector, error: Vector, wanted: Vector, given: Vector, dt: float) -> Vector:
    """Integral of the error over a step, held where its change would drive a cut torque further.

    That is conditional integration. A growing integral (..., 3) lowers the torque; ``wanted`` and ``given``
    are the torque before and after the limits [N m].
    """
    deeper = (wanted - given) * error < 0.0
    return integral + dt * where(deeper, 0.0, error)


controllers: Registry[Controller] = Registry(
    "controller", "quadftc_control.controllers", "quadftc.controllers"
)
register = controllers.register
controller_from = law_from(controllers, "controller")  # from the parameters of its node
