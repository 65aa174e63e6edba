"""Guidance: from scenario time, or a live setpoint, to what the attitude control is commanded.

On the test stand references say the attitude. In free flight trajectories, or a live setpoint made smooth,
say where the vehicle shall be. The outer loop says attitude and thrust for it. A reference or trajectory
that cannot be used, such as one with absurd accelerations, is replaced by the last one that could.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_control.position_loop import (
    PositionLoop,
    PositionLoopInputs,
    PositionLoopOutput,
    position_loop_from,
)
from quadftc_control.position_loop import State as PositionLoopState
from quadftc_control.reference import Reference, combined, level, references_from
from quadftc_control.trajectory import (
    PositionSetpoint,
    PositionSetpointFilter,
    Trajectory,
    at_origin,
    trajectories_from,
)
from quadftc_control.trajectory import combined as combined_trajectory
from quadftc_model.arrays import Flag, Quaternion, Scalar, Vector, chosen, column, namespace, stacked
from quadftc_model.assembly import NodeParameters, build_prefixed
from quadftc_model.parameters import Checked
from quadftc_model.rotations import quaternion_from_euler, to_body
from quadftc_model.samples import (
    NO_PLACE,
    AttitudeCommand,
    AttitudeReference,
    ImuSample,
    PositionEstimate,
    PositionReference,
    PositionSample,
    level_sample,
    usable,
)
from quadftc_model.stepper import seconds


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StandGuidance(Checked):
    """The references of a scenario on the test stand; its input is the scenario time [s] (...)."""

    references: tuple[Reference, ...] = ()

    def example(self) -> float:
        """Return the first scenario time."""
        return 0.0

    def init(self, inputs: Scalar) -> AttitudeReference:
        """Return the reference before the first: level and still."""
        return level(column(inputs))

    def step(
        self, state: AttitudeReference, inputs: Scalar, dt: float
    ) -> tuple[AttitudeReference, AttitudeCommand]:
        """Return the reference at a time; the state is the last one that could be used."""
        reference = combined(self.references, column(inputs))
        reference = chosen(usable(*reference), reference, state)
        return reference, AttitudeCommand(reference, namespace(inputs).zeros_like(inputs))


class FlightGuidanceInputs(NamedTuple):
    """What the guidance of a scenario sees in free flight."""

    imu: ImuSample  # corrected
    place: PositionSample
    elapsed: Scalar  # scenario time [s]


class LiveGuidanceInputs(NamedTuple):
    """What the guidance by live setpoints sees."""

    imu: ImuSample  # corrected
    place: PositionSample
    setpoint: PositionSetpoint


class GuidanceOutput(NamedTuple):
    """Where the vehicle shall be, where it is taken to be, and what is commanded for it."""

    reference: PositionReference
    estimate: PositionEstimate
    command: AttitudeCommand
    good: Flag  # False: the outer loop's could not be used, these are the last that could
    heading: Quaternion  # of the reference
    body_velocity: Vector  # the estimated velocity in body axes [m/s]


class State(NamedTuple):
    """State at the last sample."""

    loop: PositionLoopState  # of the outer loop
    reference: PositionReference  # the last one that could be used


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FlightGuidance(Checked):
    """The trajectories of a scenario, and the outer loop that follows them."""

    trajectories: tuple[Trajectory, ...] = ()
    loop: PositionLoop

    def example(self) -> FlightGuidanceInputs:
        """Return the inputs of one vehicle at rest."""
        return FlightGuidanceInputs(level_sample(), NO_PLACE, 0.0)

    def init(self, inputs: FlightGuidanceInputs) -> State:
        """Start at a sample."""
        reference = self._reference(inputs.elapsed, at_origin(inputs.elapsed))
        return State(self.loop.init(PositionLoopInputs(inputs.imu, inputs.place, reference)), reference)

    def step(self, state: State, inputs: FlightGuidanceInputs, dt: float) -> tuple[State, GuidanceOutput]:
        """Advance by ``dt`` [s] to a sample."""
        reference = self._reference(inputs.elapsed, state.reference)
        seen = PositionLoopInputs(inputs.imu, inputs.place, reference)
        loop, output = self.loop.step(state.loop, seen, dt)
        return State(loop, reference), _told(inputs.imu, reference, output)

    def _reference(self, elapsed: Scalar, last: PositionReference) -> PositionReference:
        """Return the sum of the trajectories at a time [s], or the last one where it cannot be used."""
        found = combined_trajectory(self.trajectories, elapsed)
        heading = stacked([found.yaw, found.yaw_rate])
        good = usable(found.position, found.velocity, found.acceleration, found.jerk, heading)
        return chosen(good, found, last)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LiveGuidance(Checked):
    """Live setpoints made smooth, and the outer loop that follows them."""

    smooth: PositionSetpointFilter
    loop: PositionLoop

    def example(self) -> LiveGuidanceInputs:
        """Return the inputs of one vehicle at rest."""
        return LiveGuidanceInputs(level_sample(), NO_PLACE, PositionSetpoint(np.zeros(3), np.float64(0.0)))

    def init(self, inputs: LiveGuidanceInputs) -> State:
        """Start at a sample, with the setpoint for the reference."""
        reference = self.smooth.init(inputs.setpoint)
        return State(self.loop.init(PositionLoopInputs(inputs.imu, inputs.place, reference)), reference)

    def step(self, state: State, inputs: LiveGuidanceInputs, dt: float) -> tuple[State, GuidanceOutput]:
        """Advance by ``dt`` [s] to a sample."""
        filtered, reference = self.smooth.step(state.reference, inputs.setpoint, dt)
        seen = PositionLoopInputs(inputs.imu, inputs.place, reference)
        loop, output = self.loop.step(state.loop, seen, dt)
        return State(loop, filtered), _told(inputs.imu, reference, output)


def _told(imu: ImuSample, reference: PositionReference, output: PositionLoopOutput) -> GuidanceOutput:
    """Return what the outer loop gives, and the reference, as others are told of them."""
    zero = namespace(reference.yaw).zeros_like(reference.yaw)
    heading = quaternion_from_euler(stacked([zero, zero, reference.yaw]))
    return GuidanceOutput(reference, *output, heading, to_body(imu.q_xyzw, output.estimate.velocity))


class ScenarioClock:
    """Scenario time on a stream of stamps: the first one is 0."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Take the next stamp for the first."""
        self._epoch_ns: int | None = None

    def elapsed(self, stamp_ns: int) -> float:
        """Return the scenario time [s] of a stamp [ns]."""
        if self._epoch_ns is None:
            self._epoch_ns = stamp_ns
        return seconds(stamp_ns - self._epoch_ns)


def stand_guidance_from(parameters: NodeParameters) -> StandGuidance:
    """Build the guidance of a scenario on the test stand from the parameters of its node."""
    return StandGuidance(references=references_from(parameters))


def flight_guidance_from(parameters: NodeParameters) -> FlightGuidance:
    """Build the guidance of a scenario in free flight from the parameters of its node."""
    return FlightGuidance(trajectories=trajectories_from(parameters), loop=position_loop_from(parameters))


def live_guidance_from(parameters: NodeParameters) -> LiveGuidance:
    """Build the guidance by live setpoints from parameters of its node, the filter behind ``setpoint.``."""
    smooth = build_prefixed(PositionSetpointFilter, parameters, "setpoint")
    return LiveGuidance(smooth=smooth, loop=position_loop_from(parameters))
