"""A flight, sample by sample, without ROS.

A `Simulator` is plant, sensors and random numbers. A `PlantFlight` is what the plant node does with one. The
command that acts for a period is the last that has come when the period ends. In lock-step that is the one of
the sample at its beginning. In real time it mostly comes long before the end, and the period is flown at
once.
"""

from __future__ import annotations

import copy
import dataclasses
import sys
from collections import deque
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Components, Vector
from quadftc_model.samples import ImuSample, PositionSample, RotorCondition
from quadftc_model.stepper import Engine, NumpyRunner, Runner, seconds
from quadftc_sim.rotor_fault import healthy_rotors
from quadftc_sim.sensor_draws import SensorDraws
from quadftc_sim.vehicle_simulation import FreeMotion, VehicleInputs, VehicleOutput, VehicleSimulation

NEVER_NS = sys.maxsize


class Emission(NamedTuple):
    """What the simulator shows at one instant."""

    stamp_ns: int  # now [ns]
    sample: ImuSample | None  # what the IMU publishes now; None while the first sample is on its way
    sample_stamp_ns: int  # when that sample was taken [ns]
    angles: Vector  # true Euler angles [rad]
    body_rate: Vector  # true body rate [rad/s]
    disturbance: Vector  # true disturbance [rad/s²]: its torque over the true inertia
    flight: FreeMotion | None  # of a vehicle in free flight
    place: PositionSample | None  # what arrives from the position sensor now; None: there is no such sensor
    place_stamp_ns: int  # when that was measured [ns]
    field: Vector | None  # of the magnetometer [T], measured now; None: it does not measure now
    pressure: float | None  # of the barometer [Pa], likewise


class Simulator:
    """One vehicle with its sensors: draws their random numbers, keeps the stamps, and runs the law.

    ``epoch_ns`` is the stamp of the first sample, at scenario time 0; ``seed`` that of noise and bias.
    ``engine`` says what runs the law; a plant that no compiler can trace runs in NumPy.
    """

    def __init__(
        self, law: VehicleSimulation, epoch_ns: int, seed: int, engine: Engine = NumpyRunner
    ) -> None:
        self.law: VehicleSimulation = law
        self.plant, self.period_ns = law.plant, round(law.period * 1e9)
        self._seed = seed
        self._runner: Runner[VehicleInputs, VehicleOutput] = engine(law)
        self._begin(epoch_ns)

    @property
    def time(self) -> float:
        """Scenario time [s]."""
        return seconds(self._stamp_ns - self._epoch_ns)

    def anew(self, epoch_ns: int) -> Simulator:
        """Return the same simulator at the begin of a flight; this one cannot go on then."""
        again = copy.copy(self)
        again._begin(epoch_ns)
        return again

    def start(self) -> Emission:
        """Return the first emission; call once."""
        self._state, output = self._runner.first(self._inputs(self.plant.first_command, self.time))
        return self._emission(output)

    def set_rotors(self, condition: RotorCondition | None) -> None:
        """Put the rotors of a free flight into a condition; None: as they are."""
        if self.plant.flies and condition is not None:
            self._rotors = condition

    def set_period(self, period_ns: int) -> None:
        """Fly on from the last sample at another period [ns]; ValueError if the sensors do not allow it."""
        if period_ns == self.period_ns:
            return
        law = dataclasses.replace(self.law, period=seconds(period_ns))
        if law.position is not None or not self._runner.configure(law):
            raise ValueError(f"period = {period_ns} ns: the sensors are for {self.period_ns} ns")
        self.law, self.period_ns = law, period_ns

    def advance(self, command: Components) -> Emission:
        """Fly one period under a command, held; return the emission at its end.

        The command is a torque [N m] (3,) on the test stand, rotor speeds [rad/s] (n,) in free flight.
        """
        before = self.time
        self._stamp_ns += self.period_ns
        self._stamps.append(self._stamp_ns)
        inputs = self._inputs(command, before)
        self._state, output = self._runner.step(self._state, inputs, self.law.period)
        return self._emission(output)

    def _begin(self, epoch_ns: int) -> None:
        """Go to the first sample."""
        self._epoch_ns = self._stamp_ns = epoch_ns
        self._stamps = deque([epoch_ns], self.law.imu.delay + 1)  # of samples on their way, oldest first [ns]
        self._random, self._count, self._state = SensorDraws(self._seed), 0, None
        self._first_draws = self._random.first(self.law.due(0))
        self._rotors = healthy_rotors(self.plant.first_command) if self.plant.flies else None

    def _inputs(self, command: Components, before: float) -> VehicleInputs:
        """Draw the numbers of the next sample; return the inputs of the law."""
        due = self.law.due(self._count)
        self._count += 1
        draws = self._random.sample(due)
        return VehicleInputs(command, self._rotors, before, self.time, due, draws, self._first_draws)

    def _emission(self, output: VehicleOutput) -> Emission:
        law, stamp_ns, period_ns = self.law, self._stamp_ns, self.period_ns
        imu, field, pressure = output.imu, output.field, output.pressure
        return Emission(
            stamp_ns=stamp_ns,
            sample=imu.sample if imu.there else None,
            sample_stamp_ns=self._stamps[0],
            angles=output.angles,
            body_rate=output.body_rate,
            disturbance=output.disturbance,
            flight=output.flight,
            place=output.position,
            place_stamp_ns=stamp_ns - law.position.behind * period_ns if law.position else 0,
            field=field.field if field is not None and field.there else None,
            pressure=float(pressure.pressure) if pressure is not None and pressure.there else None,
        )


class PlantFlight:
    """A flight of ``count`` emissions (0: without end), from ``begin_ns`` on by the monotonic clock.

    When no command has come for ``torque_timeout`` [s], zero acts.
    """

    def __init__(self, simulator: Simulator, count: int, torque_timeout: float, begin_ns: int) -> None:
        self.simulator, self.period_ns = simulator, simulator.period_ns
        self._count, self._torque_timeout, self._begin_ns = count, torque_timeout, begin_ns
        plant = simulator.plant
        self._nothing = np.zeros(plant.command_size)
        self._command, self._command_age = plant.first_command, 0.0  # the last, and how long ago it came [s]
        self._ahead: Emission | None = None  # of the period that is flown already
        self.emitted = 0
        self.finished = False
        self.awaited_ns: int | None = None  # stamp of the last sample, whose torque is missing [ns]

    @property
    def due_ns(self) -> int:
        """When the next emission after the first is due, by the monotonic clock [ns]; at the end never."""
        flies = self.emitted and not self.finished
        return self._begin_ns + self.emitted * self.period_ns if flies else NEVER_NS

    def postpone(self, by_ns: int) -> None:
        """Have all that is left of the flight come later [ns]."""
        self._begin_ns += by_ns

    @property
    def torque_lost(self) -> bool:
        """Whether no command has come for too long."""
        return self._command_age > self._torque_timeout

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample is missing, so that the next period is not flown yet."""
        return self.awaited_ns is not None and self._ahead is None

    def command(self, command: Components) -> None:
        """Note a command, as of `Simulator.advance`, for the period that is not flown yet."""
        self._command, self._command_age = command, 0.0

    def wait(self) -> None:
        """Note that a period has passed since the last torque."""
        self._command_age += seconds(self.period_ns)
        if self.torque_lost:
            self._command = self._nothing

    def fly_ahead(self) -> None:
        """Fly the next period already, under the last torque."""
        if self._ahead is None and not self.finished:
            self._ahead = self.simulator.advance(self._command)

    def emission(self) -> Emission | None:
        """Return the next emission; None if there is none, as the flight has had its length."""
        if self._count and self.emitted >= self._count:
            self.finished = True
            return None
        emission = self._ahead
        if emission is None:
            emission = self.simulator.advance(self._command) if self.emitted else self.simulator.start()
        self._ahead = None
        self.emitted += 1
        self.awaited_ns = None if emission.sample is None else emission.sample_stamp_ns
        return emission
