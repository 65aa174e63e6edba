"""Flights of a scenario without ROS, of which the graph in lock-step flies the same, bit for bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_compile.engine import engine_named
from quadftc_compile.wiring import BLOCK, Flown, flown_by
from quadftc_control.attitude_loop import AttitudeLoop
from quadftc_control.guidance import FlightGuidance, GuidanceOutput, StandGuidance
from quadftc_control.position_loop import PositionLoop
from quadftc_fdi.disturbance_observer import DisturbanceObservation
from quadftc_fdi.observation import Observation
from quadftc_flight.flight import Flight, onset_ns, unknown_flight
from quadftc_flight.loop import ClosedLoop, LoopOutput, SampleClock
from quadftc_flight.loop_draws import LoopDraws
from quadftc_flight.reported import ReportLog, note_reports
from quadftc_flight.scenario import Scenario, Scheme, estimator_for
from quadftc_model.arrays import rows_of
from quadftc_model.guarded import Guarded
from quadftc_model.numbers import structure_of
from quadftc_model.samples import DiagnosisReport, FaultEstimate, ImuSample
from quadftc_model.stepper import seconds
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count, vehicle_from
from quadftc_sim.injector import Faulty
from quadftc_sim.plant import Plant
from quadftc_sim.rotor_fault import true_effectiveness

Watch = Callable[[int, ImuSample], None]
Rows = NDArray[np.int64]
Record = TypeVar("Record", bound="FlightRecord")


def fly(
    scenario: Scenario,
    scheme: Scheme | str | None = None,
    epoch_ns: int = EPOCH_NS,
    engine: str = "c",
    watch: Watch | None = None,
) -> Flight:
    """Fly a scenario with one of its schemes (the first by default); the first stamp is ``epoch_ns`` [ns].

    ``engine`` runs the laws: "c", or "numpy", the reference. ``watch`` is called with stamp [ns] and content
    of each sample, as the observers get it.
    """
    return record_flight(scenario, FlightRecord, scheme, epoch_ns, engine, watch).flight()


def record_flight(
    scenario: Scenario,
    kind: type[Record],
    scheme: Scheme | str | None = None,
    epoch_ns: int = EPOCH_NS,
    engine: str = "c",
    watch: Watch | None = None,
) -> Record:
    """Fly as `fly` does; return the record, a `FlightRecord` or what is made of that class."""
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)
    loop, count = loop_of(scenario, chosen), sample_count(scenario.duration, scenario.rate)
    record = kind(loop, epoch_ns, count, watch)
    for rows, output in LoopFlyer(engine).fly(loop, scenario.seed, count):
        record.note(rows, output)
    return record


class LoopFlyer:
    """Flies closed loops by an engine, "c" or "numpy"; loops of one structure are wired once."""

    def __init__(self, engine: str = "c") -> None:
        self._engine, self._flown = engine_named(engine), dict[Hashable, Flown]()

    def fly(self, loop: ClosedLoop, seed: int, count: int) -> Iterator[tuple[slice, LoopOutput]]:
        """Fly so many samples with the seed of a scenario; yield the rows of each block and its output.

        The next block is written over the arrays (n, ...) of an output.
        """
        structure = structure_of(loop)
        if structure in self._flown:
            self._flown[structure].configure(loop)
        else:
            self._flown[structure] = flown_by(self._engine, loop, LoopDraws.example(loop))
        draws = LoopDraws(loop, seed, count)
        for begin in range(0, count, BLOCK):
            end = min(begin + BLOCK, count)
            yield slice(begin, end), self._flown[structure].run(draws.next(end - begin), end - begin)


def loop_of(scenario: Scenario, scheme: Scheme) -> ClosedLoop:
    """Return the closed loop of a scenario with one of its schemes."""
    flies, period = scenario.plant.flies, period_ns(scenario.rate)
    guidance: StandGuidance | FlightGuidance
    if flies:
        trajectories = tuple(part.law for part in scenario.trajectories)
        guidance = FlightGuidance(trajectories=trajectories, loop=position_loop_of(scenario, scheme))
    else:
        guidance = StandGuidance(references=tuple(part.law for part in scenario.references))
    return ClosedLoop(
        vehicle=vehicle_from(plant_of(scenario), scenario.sensor, period, scenario.position_sensor),
        injections=tuple(fault.injection.for_period(seconds(period)) for fault in scenario.faults),
        clock=SampleClock(period_ns=float(period)),
        observer=Guarded(Observation(scheme.observer.law, flies)),
        disturbance_observer=Guarded(DisturbanceObservation(scheme.disturbance_observer.law)),
        guidance=guidance,
        attitude=Guarded(AttitudeLoop(controller=scheme.controller.law, flies=flies)),
    )


def plant_of(scenario: Scenario) -> Plant:
    """Return the vehicle of a scenario in its disturbances, and in free flight in its winds."""
    changes: dict[str, object] = {"disturbances": tuple(part.law for part in scenario.disturbances)}
    if scenario.plant.flies:
        changes["winds"] = tuple(part.law for part in scenario.winds)
    return dataclasses.replace(scenario.plant, **changes)


def position_loop_of(scenario: Scenario, scheme: Scheme) -> PositionLoop:
    """Return the outer loop of a free flight."""
    assert scheme.position_controller is not None
    return PositionLoop(estimator=estimator_for(scenario), controller=scheme.position_controller.law)


class FlightRecord:
    """The flight of a closed loop, as its outputs come."""

    def __init__(self, loop: ClosedLoop, epoch_ns: int, count: int, watch: Watch | None = None) -> None:
        self._loop, self._watch = loop, watch
        self._channels = {each.channel for each in loop.injections}
        stamps = epoch_ns + round(loop.clock.period_ns) * np.arange(count)
        self._flight = unknown_flight(stamps, loop.vehicle.plant.command_size if loop.flies else 0)
        observation: Any = loop.observer.law
        self._reports = ReportLog(observation.observer)

    @property
    def reports(self) -> list[DiagnosisReport]:
        """What the diagnosis published so far."""
        return self._reports.reports

    def note(self, rows: slice, output: LoopOutput) -> None:
        """Note what was put out in some rows, arrays (n, ...)."""
        flight, delay = self._flight, self._loop.vehicle.imu.delay
        motion, faulty, said = output.motion, output.faulty, output.said
        flight.angles[rows], flight.body_rate[rows] = motion.angles, motion.body_rate
        flight.disturbance[rows] = motion.disturbance
        if motion.flight is not None:
            flight.position[rows], flight.rotor_speeds[rows] = motion.flight.position, motion.flight.speeds
        came = np.flatnonzero(output.left & faulty.present)
        taken = rows.start + came - delay
        faulty, said = rows_of(faulty, came), rows_of(said, came)
        self._note_truth(taken, faulty)
        self._note_estimate(taken, said.estimate.said)
        flight.disturbance_estimate[taken] = said.disturbance.said
        if isinstance(said.guidance, GuidanceOutput):
            flight.position_reference[taken] = said.guidance.reference.position
            flight.position_estimate[taken] = said.guidance.estimate.position
        output_now = said.attitude.said.output
        flight.reference[taken] = said.command.attitude.angles
        flight.torque[taken], flight.saturated[taken] = output_now.torque, output_now.saturated
        flight.error[taken], flight.sliding_variable[taken] = output_now.error, output_now.sliding_variable
        if self._watch is not None:
            for row, stamp_ns in enumerate(flight.stamp_ns[taken].tolist()):
                self._watch(stamp_ns, rows_of(faulty.sample, row))

    def flight(self) -> Flight:
        """Return the flight: the samples that came out before its end."""
        note_reports(self._flight, self.reports)
        return self._flight.first(max(len(self._flight) - self._loop.vehicle.imu.delay, 0))

    def _note_truth(self, rows: Rows, faulty: Faulty) -> None:
        """Note that samples came, and the true faults; those of gyro and accelerometer if there are some."""
        flight = self._flight
        flight.delivered[rows] = True
        flight.fault[rows] = faulty.attitude
        if "gyro" in self._channels:
            flight.gyro_fault[rows] = faulty.gyro
        if "accelerometer" in self._channels:
            flight.accelerometer_fault[rows] = faulty.accelerometer
        if faulty.rotors is not None:
            flight.rotor_effectiveness[rows] = true_effectiveness(faulty.rotors)

    def _note_estimate(self, rows: Rows, estimate: FaultEstimate) -> None:
        """Note what the fault observer says of the attitude and of the rotors, and what it reports."""
        if not len(rows):
            return
        flight = self._flight
        flight.fault_estimate[rows], flight.fault_std_dev[rows] = estimate.fault, estimate.std_dev
        flight.fault_state[rows] = estimate.state
        stamps = flight.stamp_ns[rows]
        flight.fault_onset_ns[rows] = onset_ns(stamps[:, None], estimate.onset_age)
        if (rotors := estimate.rotors) is not None:
            flight.rotor_state[rows], flight.rotor_estimate[rows] = rotors.state, rotors.effectiveness
            flight.rotor_std_dev[rows], flight.rotor_probability[rows] = rotors.std_dev, rotors.probability
            flight.rotor_ambiguous[rows] = rotors.ambiguous
        self._reports.note(stamps, estimate)
