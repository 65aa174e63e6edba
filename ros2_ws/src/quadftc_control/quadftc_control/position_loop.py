"""The outer loop of free flight: from corrected IMU and position samples to attitude and thrust.

Position estimator and position controller are laws of their own; this one runs them one after the other.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quadftc_control.position_controller import (
    PositionController,
    PositionControllerInputs,
    position_controller_from,
)
from quadftc_control.trajectory import PositionSetpoint, PositionSetpointFilter, TrajectoryGenerator
from quadftc_model.arrays import namespace
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import Checked
from quadftc_model.position_estimator import PositionEstimator, PositionEstimatorInputs
from quadftc_model.samples import (
    NO_PLACE,
    AttitudeCommand,
    ImuSample,
    PositionEstimate,
    PositionReference,
    PositionSample,
    is_usable,
    level_sample,
)
from quadftc_model.stepper import Stepper


class PositionLoopInputs(NamedTuple):
    """What the outer loop sees."""

    imu: ImuSample  # corrected
    place: PositionSample
    reference: PositionReference


class PositionLoopOutput(NamedTuple):
    """Where the outer loop takes the vehicle to be, and what it wants."""

    estimate: PositionEstimate
    command: AttitudeCommand


class State(NamedTuple):
    """States of both laws."""

    estimator: Any
    controller: Any


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PositionLoop(Checked):
    """Position estimator and position controller."""

    estimator: PositionEstimator
    controller: PositionController

    def init(self, inputs: PositionLoopInputs) -> State:
        """Start at a sample; until a position comes, the vehicle is taken to be where it shall be."""
        place, xp = inputs.place, namespace(inputs.place.position)
        start = xp.where(place.there[..., None], place.position, inputs.reference.position)
        seen = PositionEstimatorInputs(inputs.imu, place._replace(position=start))
        estimator = self.estimator.init(seen)
        _, estimate = self.estimator.step(estimator, seen, 0.0)
        wanted = PositionControllerInputs(inputs.imu, estimate, inputs.reference)
        return State(estimator, self.controller.init(wanted))

    def step(self, state: State, inputs: PositionLoopInputs, dt: float) -> tuple[State, PositionLoopOutput]:
        """Advance by ``dt`` [s] to a sample."""
        seen = PositionEstimatorInputs(inputs.imu, inputs.place)
        estimator, estimate = self.estimator.step(state.estimator, seen, dt)
        wanted = PositionControllerInputs(inputs.imu, estimate, inputs.reference)
        controller, command = self.controller.step(state.controller, wanted, dt)
        return State(estimator, controller), PositionLoopOutput(estimate, command)


def position_loop_from(parameters: NodeParameters) -> PositionLoop:
    """Build the outer loop from the parameters of its node, the estimator's behind ``estimator.``."""
    estimator = build_prefixed(PositionEstimator, parameters, "estimator")
    return PositionLoop(estimator=estimator, controller=position_controller_from(parameters))


class LiveTrajectory:
    """Live setpoints made smooth, on a stream of stamps; before the first one, ``home`` is where to be."""

    def __init__(self, law: PositionSetpointFilter, home: PositionSetpoint) -> None:
        self._stepper = Stepper[PositionSetpoint, PositionReference](law)
        self._setpoint = home
        self._last: PositionReference | None = None

    def take(self, setpoint: PositionSetpoint) -> None:
        """Note a setpoint."""
        self._setpoint = setpoint

    def at(self, stamp_ns: int) -> PositionReference:
        """Return the reference at a stamp [ns]; the last one if the stamp is repeated or went back."""
        reference = self._stepper.step(stamp_ns, self._setpoint)
        if reference is not None:
            self._last = reference
        assert self._last is not None
        return self._last


class Guidance:
    """The outer loop on a stream: it follows trajectories or live setpoints.

    A command that cannot be used is replaced by the last one, and the loop restarts.
    """

    def __init__(self, law: PositionLoop, trajectory: TrajectoryGenerator | LiveTrajectory) -> None:
        self.trajectory = trajectory
        self._stepper = Stepper(law, self._guard)
        self._last: PositionLoopOutput | None = None
        self.reference: PositionReference | None = None  # of the last sample

    def compile(self, reference: PositionReference) -> None:
        """Run the loop compiled for references like this one; a ValueError if it cannot be compiled."""
        self._stepper.compile(PositionLoopInputs(level_sample(), NO_PLACE, reference))

    def restart(self, trajectory: TrajectoryGenerator | LiveTrajectory) -> None:
        """Take the next sample for the first of a flight along a trajectory."""
        self._stepper.reset()
        self.trajectory, self._last, self.reference = trajectory, None, None

    def configure(self, law: PositionLoop) -> None:
        """Change parameters in flight."""
        self._stepper.law = law

    def at(self, stamp_ns: int, imu: ImuSample, place: PositionSample | None) -> PositionLoopOutput | None:
        """Return what is wanted at a sample [ns]; None if its stamp is repeated or went back."""
        self.reference = self.trajectory.at(stamp_ns)
        inputs = PositionLoopInputs(imu, NO_PLACE if place is None else place, self.reference)
        output = self._stepper.step(stamp_ns, inputs)
        if output is not None:
            self._last = output
        return output

    def _guard(self, inputs: PositionLoopInputs, output: PositionLoopOutput) -> PositionLoopOutput:
        (attitude, thrust), estimate = output.command, output.estimate
        usable = is_usable(*attitude, *estimate, np.array([thrust]))
        return output if usable or self._last is None else self._last
