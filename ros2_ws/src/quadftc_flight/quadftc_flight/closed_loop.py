"""The closed loop without ROS: plant, fault injector, observers, reference and controller, sample by sample.

The parts are those of the scenario, and are called in the order in which the graph calls its nodes in
lock-step. The nodes build the same parts from their parameters, so both fly the same flight, bit for bit:

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_control import controller
from quadftc_control.reference import ReferenceGenerator
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.disturbance_observer import DisturbanceEstimation
from quadftc_flight.flight import NO_STATE, VECTORS, Flight, onset_ns
from quadftc_flight.scenario import Part, Scenario, Scheme
from quadftc_model.samples import (
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    FaultEstimate,
)
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.injector import FaultInjector, Injected
from quadftc_sim.simulator import Emission, Simulator

Floats = NDArray[np.float64]


class Reaction(NamedTuple):
    """What the graph makes of one sample that is delivered."""

    estimate: FaultEstimate
    disturbance: Floats  # (3,) estimate [rad/s²]
    reference: AttitudeReference
    output: ControllerOutput


class Avionics:
    """Everything behind the IMU, for one vehicle: observers, reference, controller."""

    def __init__(self, scheme: Scheme, references: Iterable[Part]) -> None:
        self._diagnosis = Diagnosis(scheme.observer.law)
        self._disturbance_observer = DisturbanceEstimation(scheme.disturbance_observer.law)
        self._reference = ReferenceGenerator([part.law for part in references])
        self._controller = controller.stepper_of(scheme.controller.law, lambda: self.torque)
        self.torque: Floats = np.zeros(3)  # command of the last sample [N m]

    def step(self, stamp_ns: int, injected: Injected) -> Reaction | None:
        """React to a sample; None, and the torque stays, if it is withheld or its stamp is not new."""
        if injected.sample is None:
            return None
        estimate = self._diagnosis.step(stamp_ns, injected.sample, self.torque)
        if estimate is None:
            return None
        corrected = estimate.corrected
        disturbance = self._disturbance_observer.step(stamp_ns, corrected, self.torque)
        if disturbance is None:
            return None
        reference = self._reference.at(stamp_ns)
        output = self._controller.step(stamp_ns, ControllerInputs(corrected, reference, disturbance))
        if output is None:
            return None
        self.torque = output.torque
        return Reaction(estimate, disturbance, reference, output)


def simulator_of(scenario: Scenario, epoch_ns: int = EPOCH_NS) -> Simulator:
    """Return the plant of a scenario, in its disturbances, with its IMU; the first stamp is ``epoch_ns``."""
    plant = dataclasses.replace(
        scenario.plant, disturbances=tuple(part.law for part in scenario.disturbances)
    )
    return Simulator(plant, scenario.sensor, period_ns(scenario.rate), epoch_ns, scenario.seed)


def fly(scenario: Scenario, scheme: Scheme | str | None = None, epoch_ns: int = EPOCH_NS) -> Flight:
    """Fly a scenario with one of its schemes (the first by default); the first stamp is ``epoch_ns`` [ns].

    Raises
    ------
    ScenarioError
        If the scenario has no scheme of that name.
    """
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)
    simulator = simulator_of(scenario, epoch_ns)
    injector = FaultInjector(scenario.seed)
    for fault in scenario.faults:
        injector.add(fault.injection)
    avionics = Avionics(chosen, scenario.references)
    log = _Log(sample_count(scenario.duration, scenario.rate))
    emission = simulator.start()
    for index in range(log.count):
        if index > 0:
            emission = simulator.advance(avionics.torque)
        log.motion(index, emission)
        if emission.sample is not None:
            injected = injector.apply(emission.sample_stamp_ns, emission.sample)
            reaction = avionics.step(emission.sample_stamp_ns, injected)
            log.reaction(index - simulator.sensor.delay, injected, reaction)
    return log.flight(epoch_ns, rows=max(log.count - simulator.sensor.delay, 0))


class _Log:
    """Columns of a flight while it is flown; row k is the sample taken at the k-th instant."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._stamp_ns = np.zeros(count, np.int64)
        self._delivered = np.zeros(count, np.bool_)
        self._state = np.full((count, 3), NO_STATE, np.uint8)
        self._onset_ns = np.zeros((count, 3), np.int64)
        self._saturated = np.zeros((count, 3), np.bool_)
        self._vectors = {name: np.full((count, 3), np.nan) for name in VECTORS}

    def motion(self, row: int, emission: Emission) -> None:
        """Write down how the vehicle moves at an instant."""
        self._stamp_ns[row] = emission.stamp_ns
        self._put(row, angles=emission.angles, body_rate=emission.body_rate, disturbance=emission.disturbance)

    def reaction(self, row: int, injected: Injected, reaction: Reaction | None) -> None:
        """Write down what became of the sample taken in a row."""
        self._delivered[row] = injected.sample is not None
        if reaction is None:
            return
        estimate, output = reaction.estimate, reaction.output
        self._state[row] = estimate.state
        self._onset_ns[row] = onset_ns(int(self._stamp_ns[row]), estimate.onset_age)
        self._saturated[row] = output.saturated
        self._put(
            row,
            fault=injected.attitude,
            fault_estimate=estimate.fault,
            fault_std_dev=estimate.std_dev,
            disturbance_estimate=reaction.disturbance,
            reference=reaction.reference.angles,
            torque=output.torque,
            error=output.error,
            sliding_variable=output.sliding_variable,
        )

    def flight(self, epoch_ns: int, rows: int) -> Flight:
        """Return the first ``rows`` rows: those whose sample came out before the end."""
        stamp_ns = self._stamp_ns[:rows]
        return Flight(
            stamp_ns=stamp_ns,
            time=(stamp_ns - epoch_ns) / NANOSECONDS_PER_SECOND,
            delivered=self._delivered[:rows],
            fault_state=self._state[:rows],
            fault_onset_ns=self._onset_ns[:rows],
            saturated=self._saturated[:rows],
            **{name: column[:rows] for name, column in self._vectors.items()},
        )

    def _put(self, row: int, **vectors: Floats) -> None:
        for name, vector in vectors.items():
            self._vectors[name][row] = vector
