"""The closed loop without ROS: plant, fault injector, observers, reference and controller, sample by sample.

The parts are built from the parameters of the nodes, and called in the order in which the graph calls its
nodes in lock-step, so that both fly the same flight, bit for bit:

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_control import controller
from quadftc_control.assembly import controller_from, reference_from
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.disturbance_observer import DisturbanceEstimation, disturbance_observer_from
from quadftc_fdi.fault_observer import fault_observer_from
from quadftc_flight.flight import NO_STATE, VECTORS, Flight, onset_ns
from quadftc_model.assembly import NodeParameters, get
from quadftc_model.samples import (
    AttitudeReference,
    ControllerInputs,
    ControllerOutput,
    FaultEstimate,
)
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_sim.assembly import EPOCH_NS, injector_from, sample_count, simulator_from
from quadftc_sim.injector import Injected
from quadftc_sim.simulator import Emission

Floats = NDArray[np.float64]


class Reaction(NamedTuple):
    """What the graph makes of one sample that is delivered."""

    estimate: FaultEstimate
    disturbance: Floats  # (3,) estimate [rad/s²]
    reference: AttitudeReference
    output: ControllerOutput


class Avionics:
    """Everything behind the IMU, for one vehicle: observers, reference, controller.

    Parameters
    ----------
    parameters : mapping
        Node name to the parameters of that node.
    """

    def __init__(self, parameters: Mapping[str, NodeParameters]) -> None:
        self._diagnosis = Diagnosis(fault_observer_from(parameters["fault_observer"]))
        self._disturbance_observer = DisturbanceEstimation(
            disturbance_observer_from(parameters["disturbance_observer"])
        )
        self._reference = reference_from(parameters["reference"])
        self._controller = controller.stepper_of(
            controller_from(parameters["controller"]), lambda: self.torque
        )
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


def fly(parameters: Mapping[str, NodeParameters], epoch_ns: int = EPOCH_NS) -> Flight:
    """Fly a scenario.

    Parameters
    ----------
    parameters : mapping
        Node name to parameters, as :mod:`quadftc_flight.scenario.model` compiles them.
    epoch_ns : int
        Stamp of the first sample [ns].

    Raises
    ------
    ValueError
        If a part cannot be built from its parameters.
    """
    plant = parameters["plant"]
    simulator = simulator_from(plant, epoch_ns)
    injector = injector_from(parameters["fault_injector"])
    avionics = Avionics(parameters)
    log = _Log(sample_count(get(plant, "duration", float), get(plant, "rate", float)))
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
