"""The interface of attitude controllers and their registry."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from quadftc_control.weak_allocation import reachable_in_hover
from quadftc_model.arrays import Array, Components, any_of, changed_where, is_single, namespace
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.registry import Registry
from quadftc_model.rotors import attainable
from quadftc_model.samples import (
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    is_usable,
    level_sample,
)
from quadftc_model.stepper import Stepper
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


def stepper_of(
    law: Controller, last_torque: Callable[[], Array]
) -> Stepper[ControllerInputs, ControllerOutput]:
    """Run a controller on a stream: an output that cannot be used holds the last torque, and restarts it."""

    def guard(_: ControllerInputs, output: ControllerOutput) -> ControllerOutput:
        usable = is_usable(output.torque, output.error, output.sliding_variable)
        return output if usable else nothing_but(last_torque())

    return Stepper(law, guard)


def inputs_at_rest(vehicle: Vehicle, flies: bool) -> ControllerInputs:
    """Return what a controller sees of a vehicle at rest, on the test stand or in free flight."""
    zeros = np.zeros(3)
    inputs = ControllerInputs(level_sample(), AttitudeReference(zeros, zeros, zeros), zeros)
    ones = np.ones(len(vehicle.rotors.positions))
    return inputs._replace(torque=zeros, effectiveness=ones) if flies else inputs


def nothing_but(torque: Array) -> ControllerOutput:
    """Return a torque (3,) [N m] as the output of no law."""
    return ControllerOutput(torque, np.zeros(3), np.zeros(3), np.zeros(3, dtype=bool))


def limited(vehicle: Vehicle, torque: Array, effectiveness: Components | None = None) -> tuple[Array, Array]:
    """Torque [N m] (..., 3) within the authority, and where it was cut (..., 3) bool.

    With the ``effectiveness`` of the rotors (..., n), it is also one that weak rotors can give in hover.
    """
    given = attainable(vehicle, torque)
    if effectiveness is not None:
        within, weak = given, any_of(effectiveness < 1.0)

        def left() -> Array:
            weakly = reachable_in_hover(vehicle, within, effectiveness)
            return weakly if is_single(weak) else namespace(weakly).where(weak, weakly, within)

        given = changed_where(weak, left, within)
    return given, given != torque


def anti_windup(integral: Array, error: Array, wanted: Array, given: Array, dt: float) -> Array:
    """Integral of the error over a step, held where its change would drive a cut torque further.

    That is conditional integration. A growing integral (..., 3) lowers the torque; ``wanted`` and ``given``
    are the torque before and after the limits [N m].
    """
    deeper = (wanted - given) * error < 0.0
    return integral + dt * namespace(error).where(deeper, 0.0, error)


controllers: Registry[Any] = Registry("controller", "quadftc_control.controllers", "quadftc.controllers")
register = controllers.register
controller_from = law_from(controllers, "controller")  # from the parameters of its node
