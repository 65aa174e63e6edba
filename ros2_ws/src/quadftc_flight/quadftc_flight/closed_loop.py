"""The closed loop without ROS: plant, fault injector, observers, reference and controller, sample by sample.

The parts are those of the scenario, and are called in the order in which the graph calls its nodes in
lock-step. The nodes build the same parts from their parameters, so both fly the same flight, bit for bit:

    plant -> fault injector -> fault observer -> disturbance observer, reference -> controller -> plant
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Set
from typing import Any

import numpy as np

from quadftc_control.controller import inputs_at_rest, stepper_of
from quadftc_control.reduced_attitude import enduring
from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.disturbance_observer import DisturbanceEstimation
from quadftc_flight.flight import Flight, onset_ns, unknown_flight
from quadftc_flight.guidance import StandGuidance, guidance_of
from quadftc_flight.reported import note_reports
from quadftc_flight.scenario import Scenario, Scheme
from quadftc_model.arrays import Vector
from quadftc_model.samples import (
    AttitudeCommand,
    ControllerInputs,
    ControllerOutput,
    DiagnosisReport,
    FaultEstimate,
    ImuSample,
    PositionSample,
    effectiveness_of,
)
from quadftc_model.stepper import Stepper
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.injector import FaultInjector, Faulty
from quadftc_sim.motion import compiled_motion
from quadftc_sim.plant import Plant
from quadftc_sim.rotor_fault import true_effectiveness
from quadftc_sim.simulator import Emission, Simulator


def fly(
    scenario: Scenario,
    scheme: Scheme | str | None = None,
    epoch_ns: int = EPOCH_NS,
    compiled: bool = False,
    watch: Callable[[int, ImuSample], None] = lambda _stamp_ns, _sample: None,
) -> Flight:
    """Fly a scenario with one of its schemes (the first by default); the first stamp is ``epoch_ns`` [ns].

    ``compiled``: plant, fault observer and controllers run compiled by JAX; a ValueError if one cannot be.
    ``watch`` is called with stamp [ns] and content of each sample, as the observers get it.
    """
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)
    # one object for each node of the graph
    simulator = _simulator_of(scenario, epoch_ns, compiled)
    injector = FaultInjector(scenario.seed, (fault.injection for fault in scenario.faults))
    channels = {fault.injection.channel for fault in scenario.faults}
    diagnosis = _diagnosis_of(scenario, chosen, compiled)
    disturbance_observer = DisturbanceEstimation(chosen.disturbance_observer.law)
    guidance = guidance_of(scenario, chosen, compiled)
    controller = _controller_of(scenario, chosen, compiled, lambda: given.torque)

    given = guidance.before
    reports = list[DiagnosisReport]()  # on the topic `diagnosis`
    count, delay = sample_count(scenario.duration, scenario.rate), simulator.sensor.delay
    flight = _empty_flight(simulator, epoch_ns, count)
    for row in range(count):
        # the vehicle moves under the torque; what its IMU says now was taken `delay` rows before
        emission = simulator.advance(given.command) if row else simulator.start()
        _note_motion(flight, row, emission, guidance)
        if emission.sample is None:
            continue
        stamp_ns, taken = emission.sample_stamp_ns, row - delay
        injected = injector.apply(stamp_ns, emission.sample)
        simulator.set_rotors(injected.rotors)
        if not injected.present:  # withheld: the command stays
            continue
        watch(stamp_ns, injected.sample)
        # the nodes react; none refuses the sample, as stamps increase
        estimate = diagnosis.diagnose(
            stamp_ns, injected.sample, *guidance.acted(given), _place_in(emission), guidance.rotors(given)
        )
        assert estimate is not None
        effectiveness = effectiveness_of(estimate.rotors)
        disturbance = disturbance_observer.estimate(stamp_ns, estimate.corrected, given.torque)
        assert disturbance is not None
        wanted = guidance.at(stamp_ns, estimate.corrected, _place_in(emission))
        inputs = estimate.corrected, wanted.attitude, disturbance, guidance.rotor_torque(effectiveness)
        output = controller.step(stamp_ns, ControllerInputs(*inputs, effectiveness))
        assert output is not None
        given, output = guidance.actuated(wanted.thrust, output, effectiveness)
        # what is known now of the sample
        _note_truth(flight, taken, injected, channels)
        _note_estimate(flight, taken, estimate)
        reports += filter(None, [diagnosis.report(stamp_ns, estimate)])
        flight.disturbance_estimate[taken] = disturbance
        guidance.note(flight, taken)
        _note_output(flight, taken, wanted, output)
    note_reports(flight, reports)
    return flight.first(max(count - delay, 0))  # the samples that came out before the end


def plant_of(scenario: Scenario) -> Plant:
    """Return the vehicle of a scenario in its disturbances, and in free flight in its winds."""
    changes: dict[str, Any] = {"disturbances": tuple(part.law for part in scenario.disturbances)}
    if scenario.plant.flies:
        changes["winds"] = tuple(part.law for part in scenario.winds)
    return dataclasses.replace(scenario.plant, **changes)


def _simulator_of(scenario: Scenario, epoch_ns: int, compiled: bool) -> Simulator:
    """Return the vehicle of a scenario with its sensors."""
    plant, period = plant_of(scenario), period_ns(scenario.rate)
    motion = compiled_motion(plant) if compiled else None
    sensors = scenario.seed, scenario.position_sensor
    return Simulator(plant, scenario.sensor, period, epoch_ns, *sensors, motion)


def _diagnosis_of(scenario: Scenario, scheme: Scheme, compiled: bool) -> Diagnosis:
    """Return the fault observer of a scheme on a stream."""
    diagnosis = Diagnosis(scheme.observer.law)
    if compiled:
        diagnosis.compile_for(scenario.plant.flies)
    return diagnosis


def _controller_of(
    scenario: Scenario, scheme: Scheme, compiled: bool, last_torque: Callable[[], Vector]
) -> Stepper[ControllerInputs, ControllerOutput]:
    """Return the controller of a scheme on a stream."""
    controller, plant = stepper_of(enduring(scheme.controller.law), last_torque), scenario.plant
    if compiled:
        controller.compile(inputs_at_rest(plant.vehicle, plant.flies))
    return controller


def _place_in(emission: Emission) -> PositionSample | None:
    """Return what the position sensor says with the sample; None: nothing."""
    place = emission.place
    return place if place is not None and place.there else None


def _empty_flight(simulator: Simulator, epoch_ns: int, count: int) -> Flight:
    """Return a flight of ``count`` samples, of which nothing is known yet."""
    plant = simulator.plant
    rotors = plant.command_size if plant.flies else 0
    return unknown_flight(epoch_ns + simulator.period_ns * np.arange(count), rotors)


def _note_output(flight: Flight, row: int, wanted: AttitudeCommand, output: ControllerOutput) -> None:
    """Note what is wanted, and what the controller says."""
    flight.reference[row] = wanted.attitude.angles
    flight.torque[row], flight.saturated[row] = output.torque, output.saturated
    flight.error[row], flight.sliding_variable[row] = output.error, output.sliding_variable


def _note_motion(flight: Flight, row: int, emission: Emission, guidance: StandGuidance) -> None:
    """Note how the vehicle moves."""
    guidance.see(emission)
    flight.angles[row], flight.body_rate[row] = emission.angles, emission.body_rate
    flight.disturbance[row] = emission.disturbance
    if emission.flight is not None:
        flight.position[row] = emission.flight.position
        flight.rotor_speeds[row] = emission.flight.speeds


def _note_truth(flight: Flight, row: int, injected: Faulty, channels: Set[str]) -> None:
    """Note that a sample came, and its true faults; those of gyro and accelerometer if there are some."""
    flight.delivered[row] = True
    flight.fault[row] = injected.attitude
    if "gyro" in channels:
        flight.gyro_fault[row] = injected.gyro
    if "accelerometer" in channels:
        flight.accelerometer_fault[row] = injected.accelerometer
    flight.rotor_effectiveness[row] = 1.0 if injected.rotors is None else true_effectiveness(injected.rotors)


def _note_estimate(flight: Flight, row: int, estimate: FaultEstimate) -> None:
    """Note what the fault observer says of the attitude, and of the rotors."""
    flight.fault_estimate[row], flight.fault_std_dev[row] = estimate.fault, estimate.std_dev
    flight.fault_state[row] = estimate.state
    flight.fault_onset_ns[row] = onset_ns(int(flight.stamp_ns[row]), estimate.onset_age)
    if (rotors := estimate.rotors) is not None:
        flight.rotor_state[row], flight.rotor_estimate[row] = rotors.state, rotors.effectiveness
        flight.rotor_std_dev[row], flight.rotor_probability[row] = rotors.std_dev, rotors.probability
        flight.rotor_ambiguous[row] = rotors.ambiguous
