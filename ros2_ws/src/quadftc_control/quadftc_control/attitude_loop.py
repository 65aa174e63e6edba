"""The inner loop: from corrected IMU and command to a torque and, in free flight, to rotor speeds.

    measured speeds -> torque that acts -> controller -> thrust and torque -> allocation -> rotor speeds

On the test stand the torque of the controller acts, and the thrust of the command means nothing.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from quadftc_control.allocation import actuated
from quadftc_control.controller import Controller
from quadftc_control.reduced_attitude import Enduring, ReducedAttitude, State
from quadftc_model.arrays import Components, Flag, Scalar, Vector, column, namespace, where
from quadftc_model.parameters import Checked
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import (
    AttitudeCommand,
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    ImuSample,
    RotorFeedback,
    level_sample,
    usable,
)
from quadftc_model.vehicle import Vehicle


class AttitudeLoopInputs(NamedTuple):
    """What the inner loop sees; the last three are there in free flight, and None on the test stand."""

    imu: ImuSample  # corrected
    command: AttitudeCommand  # its thrust counts in free flight alone
    disturbance: Vector  # estimate of d in (36) [rad/s²]
    last: Vector  # torque that is commanded at present [N m]
    speeds: Components | None = None  # of the rotors (..., n) [rad/s]; ignored where not measured
    measured: Flag | None = None
    effectiveness: Components | None = None  # of the rotors (..., n) [1]; None: all are healthy


class AttitudeLoopOutput(NamedTuple):
    """What the inner loop commands."""

    output: ControllerOutput  # its torque is what the rotors give
    speeds: Components | None  # of the rotors (..., n) [rad/s]; None: on the test stand


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AttitudeLoop(Checked):
    """A controller, reduced attitude control where the rotors leave no yaw torque, and the allocation."""

    controller: Controller
    reduced: ReducedAttitude = dataclasses.field(default_factory=ReducedAttitude)
    flies: bool = False  # in free flight; else on the test stand

    @property
    def named_after(self) -> Controller:
        """What it is called after where it is compiled."""
        return self.controller

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle of the controller."""
        return self.controller.vehicle

    def without_estimate(self, missing: float) -> AttitudeLoop:
        """Return the loop to fly with where ``missing`` (0..1) of the disturbance estimate is missing."""
        law = self.controller.without_estimate(missing)
        return self if law is self.controller else dataclasses.replace(self, controller=law)

    def example(self) -> AttitudeLoopInputs:
        """Return the inputs of one vehicle at rest."""
        zeros = np.zeros(3)
        command = AttitudeCommand(AttitudeReference(zeros, zeros, zeros), np.float64(self.vehicle.weight))
        inputs = AttitudeLoopInputs(level_sample(), command, zeros, zeros)
        ones = np.ones(len(self.vehicle.rotors.positions))
        rotors = {"speeds": self.vehicle.hover_speed * ones, "measured": np.True_, "effectiveness": ones}
        return inputs._replace(**rotors) if self.flies else inputs

    def init(self, inputs: AttitudeLoopInputs) -> State:
        """Return the state of the controller."""
        return self._law.init(self._seen(inputs))

    def step(self, state: State, inputs: AttitudeLoopInputs, dt: float) -> tuple[State, AttitudeLoopOutput]:
        """Compute torque and speeds for a sample."""
        state, output = self._law.step(state, self._seen(inputs), dt)
        return state, self.actuated(inputs.command.thrust, output, inputs.effectiveness)

    def ready(self, inputs: AttitudeLoopInputs) -> Flag:
        """Whether the loop can start at a sample: always."""
        return inputs.imu.attitude_valid | True

    def usable(self, output: AttitudeLoopOutput) -> Flag:
        """Whether all numbers of an output can be used."""
        return usable(*output.output[:3], *(() if output.speeds is None else (output.speeds,)))

    def fallback(self, inputs: AttitudeLoopInputs, output: AttitudeLoopOutput) -> AttitudeLoopOutput:
        """Return what is said in place of an output: the last torque is held."""
        return self.actuated(inputs.command.thrust, nothing_but(inputs.last), inputs.effectiveness)

    def actuated(
        self, thrust: Scalar, output: ControllerOutput, effectiveness: Components | None
    ) -> AttitudeLoopOutput:
        """Return what the rotors give of a thrust [N] and the torque of a controller, and their speeds."""
        if not self.flies:
            return AttitudeLoopOutput(output, None)
        allocated, output = actuated(self.vehicle, thrust, output, effectiveness)
        return AttitudeLoopOutput(output, allocated.speeds)

    @property
    def _law(self) -> Enduring:
        return Enduring(law=self.controller, reduced=self.reduced)

    def _seen(self, inputs: AttitudeLoopInputs) -> ControllerInputs:
        """What the controller sees: the torque of the speeds in place of these."""
        seen = ControllerInputs(inputs.imu, inputs.command.attitude, inputs.disturbance)
        if not self.flies or inputs.speeds is None or inputs.measured is None:
            return seen
        effectiveness = inputs.effectiveness
        if effectiveness is None:
            effectiveness = namespace(inputs.speeds).ones_like(inputs.speeds)
        torque, _ = wrench_from_speeds(self.vehicle, inputs.speeds, effectiveness)
        known = where(column(inputs.measured), torque, 0.0)
        return seen._replace(rotors=RotorFeedback(known, inputs.measured, effectiveness))


def nothing_but(torque: Vector) -> ControllerOutput:
    """Return a torque (..., 3) [N m] as the output of no law."""
    zeros = namespace(torque).zeros_like(torque)
    return ControllerOutput(torque, zeros, zeros, zeros > 0.0)
