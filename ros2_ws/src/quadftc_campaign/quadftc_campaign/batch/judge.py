"""What a batch keeps of each flight: sums and extremes of its samples.

A law adds them up sample by sample, in C as in JAX. Metrics come from them in `batch.records`.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_campaign.batch.judged import JudgeInputs, Motion, OfSensors, Place, Rotors
from quadftc_campaign.batch.schedule import Schedule
from quadftc_campaign.batch.tally import Last, Tally, add_tallies, tally_sample
from quadftc_model.arrays import branch
from quadftc_sim.delay_line import fill_line, shift_line
from quadftc_sim.rotor_fault import healthy_rotors


class JudgeState(NamedTuple):
    """A tally, and the motion at the samples that are inside the IMU, oldest first."""

    pending: Motion
    tally: Tally


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Judge:
    """A law that tallies the samples of a flight."""

    schedule: Schedule
    delay: int  # samples that are inside the IMU

    def example(self) -> JudgeInputs:
        """Return the inputs at a first sample."""
        zeros, no, yes = np.zeros(3), np.zeros(3, np.bool_), np.True_
        states, place, rotors = np.zeros(3, np.uint8), None, None
        if self.schedule.rotors is not None:
            each = np.zeros(self.schedule.rotors.start.shape[1])
            rotors = Rotors(healthy_rotors(each), each.astype(np.uint8), each, each > 0.0)
            place = Place(zeros, zeros)
        motion = Motion(zeros, zeros, None if place is None else zeros)
        return JudgeInputs(
            *(motion, yes, yes, 0.0, OfSensors(zeros, zeros, zeros), zeros, zeros, states),
            *(OfSensors(states, states, states), (no, no), zeros, zeros, no, (~yes,) * 3, place, rotors),
        )

    def init(self, inputs: JudgeInputs) -> JudgeState:
        """Return the state before the first sample: what a sample adds that is not there."""
        none = self.schedule.start != self.schedule.start
        never = (
            None if self.schedule.rotors is None else self.schedule.rotors.start != self.schedule.rotors.start
        )
        already, named = none[0], none[:, 0]
        last = Last(
            torque=0.0 * inputs.torque,
            begun=inputs.left & False,
            declared=already[0],
            named=named,
            event_already=already,
            fault_already=none,
            rotors_named=None if never is None else never[0],
            rotor_already=never,
        )
        absent = inputs._replace(left=inputs.left & False, delivered=inputs.delivered & False)
        return JudgeState(
            fill_line(inputs.motion, self.delay, 0), tally_sample(absent, inputs.motion, self.schedule, last)
        )

    def step(self, state: JudgeState, inputs: JudgeInputs, dt: float) -> tuple[JudgeState, tuple[()]]:
        """Add a sample to the tally, if one leaves the IMU."""
        pending, motion = shift_line(state.pending, inputs.motion, 0)
        before = state.tally
        tally = branch(
            inputs.left,
            lambda: add_tallies(before, tally_sample(inputs, motion, self.schedule, before.last)),
            lambda: before,
        )
        return JudgeState(pending, tally), ()
