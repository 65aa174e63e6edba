"""The outer loop of free flight: from corrected IMU and position samples to attitude and thrust.

Position estimator and position controller are laws of their own; this one runs them one after the other. An
output that cannot be used is replaced by the last that could, and both laws start again at the next sample.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from quadftc_control.position_controller import (
    PositionController,
    PositionControllerInputs,
    position_controller_from,
)
from quadftc_control.position_controller import State as PositionControllerState
from quadftc_model.arrays import Flag, branch, chosen, column, namespace, where
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import Checked
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.position_estimator import State as PositionEstimatorState
from quadftc_model.samples import (
    AttitudeCommand,
    AttitudeReference,
    ImuSample,
    PositionEstimate,
    PositionReference,
    PositionSample,
    usable,
)


class PositionLoopInputs(NamedTuple):
    """What the outer loop sees."""

    imu: ImuSample  # corrected
    place: PositionSample
    reference: PositionReference


class PositionLoopOutput(NamedTuple):
    """Where the outer loop takes the vehicle to be, and what it wants."""

    estimate: PositionEstimate
    command: AttitudeCommand
    good: Flag  # False: this sample's could not be used; it is the last that could, and both laws start again


class State(NamedTuple):
    """States of both laws, and the last output that could be used; before the first, level hover."""

    estimator: PositionEstimatorState
    controller: PositionControllerState
    last: PositionLoopOutput


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionLoop(Checked):
    """Position estimator and position controller."""

    estimator: PositionEstimator
    controller: PositionController

    def init(self, inputs: PositionLoopInputs) -> State:
        """Start at a sample; until a position comes, the vehicle is taken to be where it shall be."""
        place, shall = inputs.place, inputs.reference
        start = where(column(place.there), place.position, shall.position)
        xp = namespace(start)
        zeros = xp.zeros_like(start)
        estimate = PositionEstimate(start, zeros, zeros)
        hover = AttitudeCommand(
            AttitudeReference(zeros, zeros, zeros),
            self.controller.vehicle.weight * xp.ones_like(start[..., 0]),
        )
        return State(
            self.estimator.init(PositionEstimatorInputs(inputs.imu, place._replace(position=start))),
            self.controller.init(PositionControllerInputs(inputs.imu, estimate, shall)),
            PositionLoopOutput(PositionEstimate(shall.position, zeros, zeros), hover, place.there | True),
        )

    def step(self, state: State, inputs: PositionLoopInputs, dt: float) -> tuple[State, PositionLoopOutput]:
        """Advance by ``dt`` [s] to a sample."""
        state = branch(state.last.good, lambda: state, lambda: self.init(inputs)._replace(last=state.last))
        seen = PositionEstimatorInputs(inputs.imu, inputs.place)
        estimator, estimate = self.estimator.step(state.estimator, seen, dt)
        wanted = PositionControllerInputs(inputs.imu, estimate, inputs.reference)
        controller, command = self.controller.step(state.controller, wanted, dt)
        good = usable(*estimate, *command.attitude, column(command.thrust))
        last = chosen(good, PositionLoopOutput(estimate, command, good), state.last)._replace(good=good)
        return State(estimator, controller, last), last


def position_loop_from(parameters: NodeParameters) -> PositionLoop:
    """Build the outer loop from the parameters of its node, the estimator's behind ``estimator.``."""
    estimator = build_prefixed(PositionEstimator, parameters, "estimator")
    return PositionLoop(estimator=estimator, controller=position_controller_from(parameters))
