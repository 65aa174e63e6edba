"""What stands between trajectory or reference and the plant, as the nodes of the graph have it.

On the test stand a reference is the attitude, and the controller's torque acts. In free flight a position
controller says attitude and thrust, and rotor speeds act.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from quadftc_control.allocation import actuated
from quadftc_control.position_loop import Guidance, PositionLoop, PositionLoopOutput
from quadftc_control.reference import ReferenceGenerator
from quadftc_control.trajectory import TrajectoryGenerator
from quadftc_flight.flight import Flight
from quadftc_flight.scenario import Scenario, Scheme, estimator_for
from quadftc_model.arrays import Components, Scalar, Vector
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import AttitudeCommand, ControllerOutput, ImuSample, PositionSample, RotorReading
from quadftc_sim.simulator import Emission


class Given(NamedTuple):
    """What the rotors get, and what they give by it."""

    command: Components  # for the plant
    torque: Vector  # [N m]


class StandGuidance:
    """The reference of a test stand."""

    before = Given(np.zeros(3), np.zeros(3))  # the first command

    def __init__(self, scenario: Scenario, _scheme: Scheme, _compiled: bool) -> None:
        self._reference = ReferenceGenerator([part.law for part in scenario.references])

    def at(self, stamp_ns: int, imu: ImuSample, place: PositionSample | None) -> AttitudeCommand:
        """Return what is wanted at a sample [ns], of the corrected IMU and of the position sensor."""
        return AttitudeCommand(self._reference.at(stamp_ns), 0.0)

    def actuated(
        self, thrust: Scalar, output: ControllerOutput, effectiveness: Components | None
    ) -> tuple[Given, ControllerOutput]:
        """Return what the rotors get for a thrust [N] and a torque, and what the controller says then.

        ``effectiveness`` is that of the rotors, as it is estimated.
        """
        return Given(output.torque, output.torque), output

    def acted(self, given: Given) -> tuple[Vector, Scalar | None]:
        """Return the torque [N m] and the thrust [N] that the fault observer takes the rotors to give."""
        return given.torque, None

    def see(self, emission: Emission) -> None:
        """See what is measured besides, as the simulator shows it."""

    def rotors(self, given: Given) -> RotorReading | None:
        """Return what is known of the rotors at the sample; None: nothing."""
        return None

    def rotor_torque(self, effectiveness: Components | None) -> Vector | None:
        """Return the torque [N m] of the rotor speeds measured with the sample; None: they are not."""
        return None

    def note(self, flight: Flight, row: int) -> None:
        """Note in a row of a flight where the vehicle shall be, and where it is taken to be."""


class FlightGuidance(StandGuidance):
    """The position controller of a free flight, with the trajectories that it follows."""

    def __init__(self, scenario: Scenario, scheme: Scheme, compiled: bool) -> None:
        self._vehicle = scenario.plant.vehicle
        parts = [part.law for part in scenario.trajectories]
        self._guidance = Guidance(position_loop_of(scenario, scheme), TrajectoryGenerator(parts))
        if compiled:
            self._guidance.compile(TrajectoryGenerator(parts).at(0))
        self._wanted: PositionLoopOutput | None = None
        self._speeds = deque[Components](maxlen=scenario.sensor.delay + 1)
        self.before = Given(scenario.plant.first_command, np.zeros(3))

    def at(self, stamp_ns: int, imu: ImuSample, place: PositionSample | None) -> AttitudeCommand:
        """Return attitude and thrust by the position."""
        self._wanted = wanted = self._guidance.at(stamp_ns, imu, place)
        assert wanted is not None
        return wanted.command

    def actuated(
        self, thrust: Scalar, output: ControllerOutput, effectiveness: Components | None
    ) -> tuple[Given, ControllerOutput]:
        """Return rotor speeds [rad/s]."""
        allocated, output = actuated(self._vehicle, thrust, output, effectiveness)
        return Given(allocated.speeds, allocated.torque), output

    def acted(self, given: Given) -> tuple[Vector, Scalar | None]:
        """Return torque and thrust of the rotor speeds."""
        return wrench_from_speeds(self._vehicle, given.command)

    def see(self, emission: Emission) -> None:
        """See the true speeds of the rotors, which are measured without error."""
        assert emission.flight is not None
        self._speeds.append(emission.flight.speeds)

    def rotors(self, given: Given) -> RotorReading:
        """Return the command, and the speeds at the time of the sample, which comes later."""
        return RotorReading(given.command, self._speeds[0])

    def rotor_torque(self, effectiveness: Components | None) -> Vector | None:
        """Return the torque of the speeds at the time of the sample, which comes later."""
        return wrench_from_speeds(self._vehicle, self._speeds[0], effectiveness)[0]

    def note(self, flight: Flight, row: int) -> None:
        """Note reference and estimate of the position."""
        reference, wanted = self._guidance.reference, self._wanted
        if reference is not None and wanted is not None:
            flight.position_reference[row] = reference.position
            flight.position_estimate[row] = wanted.estimate.position


def position_loop_of(scenario: Scenario, scheme: Scheme) -> PositionLoop:
    """Return the outer loop of a free flight."""
    assert scheme.position_controller is not None
    return PositionLoop(estimator=estimator_for(scenario), controller=scheme.position_controller.law)


def guidance_of(scenario: Scenario, scheme: Scheme, compiled: bool) -> StandGuidance:
    """Return what a scheme of a scenario has; what can be compiled is, if it is wanted."""
    return (FlightGuidance if scenario.plant.flies else StandGuidance)(scenario, scheme, compiled)
