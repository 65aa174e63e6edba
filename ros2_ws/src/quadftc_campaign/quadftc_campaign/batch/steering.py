"""Between trajectory or reference and the plant: `quadftc_flight.guidance` for any array library.

On the test stand a reference is the attitude, and a torque acts. In free flight a position controller says
attitude and thrust, and rotor speeds act.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from quadftc_campaign.batch.parts import Loop
from quadftc_control import reference, trajectory
from quadftc_control.allocation import actuated
from quadftc_control.controller import Controller
from quadftc_control.position_loop import PositionLoop, PositionLoopInputs
from quadftc_control.reduced_attitude import enduring
from quadftc_model.arrays import Array, chosen, namespace
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import AttitudeReference, ControllerOutput, ImuSample, PositionSample, RotorReading


class Given(NamedTuple):
    """What the rotors get."""

    torque: Array  # (3,) [N m]; in free flight what the speeds give
    speeds: Array | None = None  # (n,) in free flight [rad/s]

    @property
    def command(self) -> Array:
        """What the plant follows."""
        return self.torque if self.speeds is None else self.speeds


class Wanted(NamedTuple):
    """Where the vehicle shall be, and what is wanted for it; on the test stand an attitude alone."""

    attitude: AttitudeReference
    thrust: Array | None = None  # [N]
    position: Array | None = None  # (3,) [m]
    position_estimate: Array | None = None  # (3,) [m]


class StandSteering:
    """The references of a test stand."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop

    @property
    def controller(self) -> Controller:
        """What flies the controller of the loop: it alone."""
        return self._loop.controller

    def first(self, plant: Any, zeros: Array) -> Given:
        """What the rotors get before the first command, in a state of the plant."""
        return Given(zeros)

    def acted(self, given: Given) -> tuple[Array, Array | None]:
        """Torque [N m] and thrust [N] that the fault observer takes the rotors to give."""
        return given.torque, None

    def rotors(self, given: Given, speeds: Array | None) -> RotorReading | None:
        """What is known of the rotors, of which ``speeds`` [rad/s] are measured; None: nothing."""
        return None

    def rotor_torque(self, speeds: Array | None, effectiveness: Array | None) -> Array | None:
        """Torque [N m] of the rotor speeds [rad/s] measured with the sample; None: they are not."""
        return None

    def wanted(
        self, state: Any, imu: ImuSample, place: PositionSample | None, elapsed: Array, dt: Any, begins: Any
    ) -> tuple[Any, Wanted]:
        """Return what is wanted at a sample, ``elapsed`` [s] after the first, and the new state."""
        wanted = reference.combined(self._loop.references, elapsed)
        return None, Wanted(AttitudeReference(*as_arrays(wanted, elapsed)))

    def actuated(
        self, wanted: Wanted, output: ControllerOutput, effectiveness: Array | None
    ) -> tuple[Given, ControllerOutput]:
        """Return what the rotors get, and what the controller says then."""
        return Given(output.torque), output


class FlightSteering(StandSteering):
    """Trajectories and position controller of a free flight."""

    def __init__(self, loop: Loop, outer: PositionLoop) -> None:
        super().__init__(loop)
        self._outer = outer

    @property
    def controller(self) -> Controller:
        """What flies the controller, also with a rotor off."""
        return enduring(self._loop.controller)

    def first(self, plant: Any, zeros: Array) -> Given:
        """Hover."""
        return Given(zeros, plant.speeds)

    def acted(self, given: Given) -> tuple[Array, Array | None]:
        """Return torque and thrust of the rotor speeds."""
        return wrench_from_speeds(self._loop.plant.vehicle, given.command)

    def rotors(self, given: Given, speeds: Array | None) -> RotorReading:
        """Return the command, and the speeds."""
        return RotorReading(given.command, speeds)

    def rotor_torque(self, speeds: Array | None, effectiveness: Array | None) -> Array | None:
        """Return the torque of rotor speeds."""
        assert speeds is not None
        return wrench_from_speeds(self._loop.plant.vehicle, speeds, effectiveness)[0]

    def wanted(
        self, state: Any, imu: ImuSample, place: PositionSample | None, elapsed: Array, dt: Any, begins: Any
    ) -> tuple[Any, Wanted]:
        """Return attitude and thrust by the position."""
        assert place is not None
        shall = trajectory.combined(self._loop.trajectories, elapsed)
        shall = type(shall)(*as_arrays(shall, elapsed))
        inputs = PositionLoopInputs(imu, place, shall)
        state, output = advance(self._outer, state, inputs, dt, begins)
        command, estimate = output.command, output.estimate
        return state, Wanted(command.attitude, command.thrust, shall.position, estimate.position)

    def actuated(
        self, wanted: Wanted, output: ControllerOutput, effectiveness: Array | None
    ) -> tuple[Given, ControllerOutput]:
        """Allocate thrust and torque."""
        assert wanted.thrust is not None
        allocated, output = actuated(self._loop.plant.vehicle, wanted.thrust, output, effectiveness)
        return Given(allocated.torque, allocated.speeds), output


def steering_of(loop: Loop) -> StandSteering:
    """Return what a flight has."""
    return StandSteering(loop) if loop.position_loop is None else FlightSteering(loop, loop.position_loop)


def as_arrays(parts: Any, like: Array) -> list[Array]:
    """Return numbers or arrays as arrays of the library and type of ``like``."""
    return [namespace(like).asarray(each, dtype=like.dtype) for each in parts]


def advance(law: Any, state: Any, inputs: Any, dt: Any, begins: Any) -> tuple[Any, Any]:
    """Step a law; where ``begins`` holds, it begins with this sample."""
    if begins is True:
        return law.step(law.init(inputs), inputs, 0.0)
    after = law.step(state, inputs, dt)
    return after if begins is False else chosen(begins, law.step(law.init(inputs), inputs, 0.0), after)
