"""The closed loop without ROS: plant, fault injector, observers, reference and controller, sample by sample.

The parts are those of the scenario, and are called in the order in which the graph calls its nodes in
lock-step. The nodes build the same parts from their parameters, so both fly the same flight, bit for bit:

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant
"""

from __future__ import annotations

import dataclasses
from collections.abc import Set

import numpy as np

from quadftc_control.controller import stepper_of
from quadftc_control.reference import ReferenceGenerator
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.disturbance_observer import DisturbanceEstimation
from quadftc_flight.flight import Flight, onset_ns, unknown_flight
from quadftc_flight.reported import note_reports
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_model.samples import ControllerInputs, DiagnosisReport, FaultEstimate
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.injector import FaultInjector, Faulty
from quadftc_sim.simulator import Simulator


def fly(scenario: Scenario, scheme: Scheme | str | None = None, epoch_ns: int = EPOCH_NS) -> Flight:
    """Fly a scenario with one of its schemes (the first by default); the first stamp is ``epoch_ns`` [ns]."""
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)
    # one object for each node of the graph
    disturbances = tuple(part.law for part in scenario.disturbances)
    plant = dataclasses.replace(scenario.plant, disturbances=disturbances)
    simulator = Simulator(plant, scenario.sensor, period_ns(scenario.rate), epoch_ns, scenario.seed)
    injector = FaultInjector(scenario.seed, (fault.injection for fault in scenario.faults))
    channels = {fault.injection.channel for fault in scenario.faults}
    diagnosis = Diagnosis(chosen.observer.law)
    disturbance_observer = DisturbanceEstimation(chosen.disturbance_observer.law)
    reference = ReferenceGenerator([part.law for part in scenario.references])
    controller = stepper_of(chosen.controller.law, lambda: torque)

    torque = np.zeros(3)  # command of the last sample [N m]
    reports = list[DiagnosisReport]()  # on the topic `diagnosis`
    count, delay = sample_count(scenario.duration, scenario.rate), simulator.sensor.delay
    flight = unknown_flight(epoch_ns + simulator.period_ns * np.arange(count))
    for row in range(count):
        # the vehicle moves under the torque; what its IMU says now was taken `delay` rows before
        emission = simulator.advance(torque) if row else simulator.start()
        flight.angles[row], flight.body_rate[row] = emission.angles, emission.body_rate
        flight.disturbance[row] = emission.disturbance
        if emission.sample is None:
            continue
        stamp_ns, taken = emission.sample_stamp_ns, row - delay
        injected = injector.apply(stamp_ns, emission.sample)
        if not injected.present:  # withheld: the torque stays
            continue
        # the nodes react; none refuses the sample, as stamps increase
        estimate = diagnosis.diagnose(stamp_ns, injected.sample, torque)
        assert estimate is not None
        disturbance = disturbance_observer.estimate(stamp_ns, estimate.corrected, torque)
        assert disturbance is not None
        wanted = reference.at(stamp_ns)
        output = controller.step(stamp_ns, ControllerInputs(estimate.corrected, wanted, disturbance))
        assert output is not None
        torque = output.torque
        # what is known now of the sample
        flight.delivered[taken] = True
        _note_truth(flight, taken, injected, channels)
        _note_estimate(flight, taken, estimate)
        reports += filter(None, [diagnosis.report(stamp_ns, estimate)])
        flight.disturbance_estimate[taken], flight.reference[taken] = disturbance, wanted.angles
        flight.torque[taken], flight.saturated[taken] = torque, output.saturated
        flight.error[taken], flight.sliding_variable[taken] = output.error, output.sliding_variable
    note_reports(flight, reports)
    return flight.first(max(count - delay, 0))  # the samples that came out before the end


def _note_truth(flight: Flight, row: int, injected: Faulty, channels: Set[str]) -> None:
    """Note the true faults of a sample; those of gyro and accelerometer if the scenario has some."""
    flight.fault[row] = injected.attitude
    if "gyro" in channels:
        flight.gyro_fault[row] = injected.gyro
    if "accelerometer" in channels:
        flight.accelerometer_fault[row] = injected.accelerometer


def _note_estimate(flight: Flight, row: int, estimate: FaultEstimate) -> None:
    """Note what the fault observer says of the attitude."""
    flight.fault_estimate[row], flight.fault_std_dev[row] = estimate.fault, estimate.std_dev
    flight.fault_state[row] = estimate.state
    flight.fault_onset_ns[row] = onset_ns(int(flight.stamp_ns[row]), estimate.onset_age)
