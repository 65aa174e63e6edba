"""A flight of a batch: the closed loop, and a judge that tallies what comes out of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quadftc_campaign.batch.judge import Judge
from quadftc_campaign.batch.judged import JudgeInputs, Motion, OfSensors, Place, Rotors
from quadftc_control.guidance import GuidanceOutput
from quadftc_flight.loop import ClosedLoop, LoopInputs, LoopOutput, LoopState
from quadftc_model.arrays import Mask
from quadftc_model.composition import Calls
from quadftc_model.samples import FaultEstimate, RotorCondition

STATES, NOT = np.zeros(3, np.uint8), np.zeros(3, np.bool_)  # of a sensor of which nothing is said


class JudgedState(NamedTuple):
    """State of the closed loop and of its judge."""

    loop: LoopState
    judge: Any


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class JudgedLoop:
    """A closed loop with a judge; a `quadftc_model.composition.Composition` that puts nothing out."""

    loop: ClosedLoop
    judge: Judge

    @property
    def laws(self) -> Mapping[str, object]:
        """The laws by name."""
        return {**self.loop.laws, "judge": self.judge}

    def init(self, calls: Calls) -> JudgedState:
        """Return a state to begin with."""
        return JudgedState(self.loop.init(calls), calls.init("judge"))

    def step(self, calls: Calls, state: JudgedState, inputs: LoopInputs) -> tuple[JudgedState, tuple[()]]:
        """Advance to the next sample, and judge the one that leaves the IMU then."""
        loop, output = self.loop.step(calls, state.loop, inputs)
        judge, _ = calls.step("judge", state.judge, judged(output, inputs), inputs.dt)
        return JudgedState(loop, judge), ()


def judged(output: LoopOutput, inputs: LoopInputs) -> JudgeInputs:
    """Return what a judge sees."""
    motion, faulty, said = output.motion, output.faulty, output.said
    estimate, guidance, control = said.estimate.said, said.guidance, said.attitude.said.output
    place = rotors = None
    if isinstance(guidance, GuidanceOutput):
        place = Place(guidance.reference.position, guidance.estimate.position)
    if faulty.rotors is not None:
        rotors = _rotors_of(estimate, faulty.rotors)
    sensors, ambiguous = _sensors_of(estimate)
    return JudgeInputs(
        motion=Motion(motion.angles, motion.disturbance, motion.flight and motion.flight.position),
        left=output.left,
        delivered=faulty.present,
        time=inputs.taken,
        faults=OfSensors(faulty.attitude, faulty.gyro, faulty.accelerometer),
        reference=said.command.attitude.angles,
        estimate=estimate.fault,
        state=estimate.state,
        sensors=sensors,
        ambiguous=ambiguous,
        disturbance=said.disturbance.said,
        torque=control.torque,
        saturated=control.saturated,
        failed=(said.estimate.failed, said.disturbance.failed, said.attitude.failed),
        place=place,
        rotors=rotors,
    )


def _sensors_of(estimate: FaultEstimate) -> tuple[OfSensors, tuple[Mask, Mask]]:
    """Return what is said of the sensors, and where it is ambiguous; one that is not watched is healthy."""
    said = estimate.sensors
    if said is None:
        return OfSensors(estimate.state, STATES, STATES), (NOT, NOT)
    return OfSensors(*(each.state for each in said)), (said.attitude.ambiguous, said.gyro.ambiguous)


def _rotors_of(estimate: FaultEstimate, condition: RotorCondition) -> Rotors:
    """Return what is said of the rotors; those that are not watched are healthy."""
    said, shape = estimate.rotors, condition.stuck.shape
    if said is None:
        return Rotors(condition, np.zeros(shape, np.uint8), np.ones(shape), np.zeros(shape, np.bool_))
    return Rotors(condition, said.state, said.effectiveness, said.ambiguous)
