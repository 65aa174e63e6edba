"""The closed loop of one vehicle: which law gets what of which, sample by sample.

    vehicle -> faults -> fault observer -> disturbance observer, guidance -> attitude loop -> vehicle

The nodes of the graph run the same laws, and in lock-step in this order. So a flight without ROS is that of
the graph, bit for bit. Whatever is computed, a law computes: see `quadftc_model.composition`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from quadftc_control.attitude_loop import AttitudeLoopInputs, AttitudeLoopOutput
from quadftc_control.guidance import FlightGuidance, FlightGuidanceInputs, GuidanceOutput, StandGuidance
from quadftc_fdi.disturbance_observer import DisturbanceObservationInputs
from quadftc_fdi.observation import ObservationInputs
from quadftc_model.arrays import Components, Flag, Scalar, Vector, where
from quadftc_model.composition import Calls
from quadftc_model.guarded import Guarded, GuardedOutput
from quadftc_model.samples import (
    HEALTHY,
    NO_PLACE,
    AttitudeCommand,
    FaultEstimate,
    RotorCondition,
    RotorEstimate,
    RotorReading,
    effectiveness_of,
)
from quadftc_model.stepper import MAX_GAP, NANOSECONDS_PER_SECOND
from quadftc_sim.delay_line import DelayLine
from quadftc_sim.injection import Injection
from quadftc_sim.injector import FaultDraws, Faulty, begin, inject, laws_of, without_faults
from quadftc_sim.rotor_fault import healthy_rotors
from quadftc_sim.sensor_draws import Due, FirstDraws, SampleDraws
from quadftc_sim.vehicle_simulation import VehicleInputs, VehicleOutput, VehicleSimulation


class LoopInputs(NamedTuple):
    """Times and random numbers of a sample."""

    before: Scalar  # scenario time of the sample before [s]
    now: Scalar  # [s]
    dt: Scalar  # between these [s]; 0 at the first
    taken: Scalar  # when the sample was taken that leaves the IMU now [s]
    number: Scalar  # of samples that were taken before that one
    taken_dt: Scalar  # since the sample before that one [s]; 0 at the first
    due: Due
    draws: SampleDraws
    first_draws: FirstDraws
    faults: tuple[FaultDraws | None, ...]  # of each injection


class Said(NamedTuple):
    """What the avionics say of the last sample that came."""

    estimate: GuardedOutput[FaultEstimate]
    disturbance: GuardedOutput[Vector]  # [rad/s²]
    guidance: GuidanceOutput | AttitudeCommand  # of the position controller or of the reference
    attitude: GuardedOutput[AttitudeLoopOutput]

    @property
    def command(self) -> AttitudeCommand:
        """What the guidance commands."""
        return self.guidance.command if isinstance(self.guidance, GuidanceOutput) else self.guidance


class LoopState(NamedTuple):
    """States of the laws, and what goes from one sample to the next."""

    vehicle: object
    speeds: object  # of the rotors at the samples that are inside the IMU
    injections: tuple[object, ...]
    clock: object
    observer: object
    disturbance_observer: object
    guidance: object
    attitude: object
    faulty: Faulty  # the last sample that left the IMU
    said: Said


class LoopOutput(NamedTuple):
    """What is known after a sample; what is not of the motion belongs to the sample that has left the IMU."""

    motion: VehicleOutput
    left: Flag  # a sample has left the IMU
    faulty: Faulty
    said: Said  # nothing new where the sample is withheld


class Times(NamedTuple):
    """Times of a sample that comes."""

    dt: Scalar  # since the last one [s]; 0: the laws begin
    elapsed: Scalar  # since the first one [s]


class ClockState(NamedTuple):
    """The samples that came, by how many were taken before."""

    first: Scalar  # -1: none yet
    last: Scalar


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SampleClock:
    """Time steps between samples that come, as `quadftc_model.stepper.Stepper` has them of their stamps."""

    period_ns: float  # of the IMU [ns], a whole number

    def example(self) -> float:
        """Return the count of a first sample."""
        return 0.0

    def init(self, inputs: Scalar) -> ClockState:
        """Return the state before the first sample."""
        return ClockState(0.0 * inputs - 1.0, 0.0 * inputs)

    def step(self, state: ClockState, inputs: Scalar, dt: float) -> tuple[ClockState, Times]:
        """Return the times of the sample before which so many were taken."""
        begins = state.first < 0.0
        first = where(begins, inputs, state.first)
        gap = (inputs - state.last) * self.period_ns / NANOSECONDS_PER_SECOND
        step = where(begins | (gap > MAX_GAP), 0.0, gap)
        elapsed = (inputs - first) * self.period_ns / NANOSECONDS_PER_SECOND
        return ClockState(first, inputs), Times(step, elapsed)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RotorTrust:
    """What the controller takes the effectiveness of each rotor for, by what is said of them."""

    rotors: int

    def example(self) -> RotorEstimate:
        """Return what is said of healthy rotors."""
        zeros = np.zeros(self.rotors)
        state = np.full(self.rotors, HEALTHY, np.uint8)
        return RotorEstimate(state, zeros + 1.0, zeros, zeros, zeros, state, zeros > 0.0)

    def init(self, inputs: RotorEstimate) -> tuple[()]:
        """Return no state."""
        return ()

    def step(self, state: tuple[()], inputs: RotorEstimate, dt: float) -> tuple[tuple[()], Components]:
        """Return the effectiveness (..., n) [1]."""
        return state, effectiveness_of(inputs)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ClosedLoop:
    """The laws of a vehicle, its faults and its avionics; a `quadftc_model.composition.Composition`."""

    vehicle: VehicleSimulation
    injections: tuple[Injection, ...]  # those for the period, see `Injection.for_period`
    clock: SampleClock
    observer: Guarded[ObservationInputs, FaultEstimate]
    disturbance_observer: Guarded[DisturbanceObservationInputs, Vector]
    guidance: StandGuidance | FlightGuidance
    attitude: Guarded[AttitudeLoopInputs, AttitudeLoopOutput]

    @property
    def flies(self) -> bool:
        """Whether it is a free flight."""
        return self.vehicle.plant.flies

    @property
    def laws(self) -> Mapping[str, object]:
        """The laws by name."""
        found: dict[str, object] = {"vehicle": self.vehicle, "clock": self.clock}
        if self.flies:
            found["speeds"] = DelayLine(self.vehicle.plant.first_command, self.vehicle.imu.delay)
            found["trust"] = RotorTrust(rotors=self.vehicle.plant.command_size)
        found |= laws_of(self.injections)
        names = ("observer", "disturbance_observer", "guidance", "attitude")
        return {**found, **{name: getattr(self, name) for name in names}}

    def init(self, calls: Calls) -> LoopState:
        """Return a state to begin with: no sample has come, and the rotors have their first command."""
        said = Said(*(said_at_first(each) for each in list(self.laws.values())[-4:]))
        first = said.attitude.said
        speeds = self.vehicle.plant.first_command if self.flies else None
        nothing = first.output._replace(torque=np.zeros(3))
        attitude = said.attitude._replace(said=AttitudeLoopOutput(nothing, speeds))
        return LoopState(
            vehicle=calls.init("vehicle"),
            speeds=calls.init("speeds") if self.flies else None,
            injections=begin(calls, self.injections),
            clock=calls.init("clock"),
            observer=calls.init("observer"),
            disturbance_observer=calls.init("disturbance_observer"),
            guidance=calls.init("guidance"),
            attitude=calls.init("attitude"),
            faulty=without_faults(self.observer.example().sample, self._healthy),
            said=said._replace(attitude=attitude),
        )

    def step(self, calls: Calls, state: LoopState, inputs: LoopInputs) -> tuple[LoopState, LoopOutput]:
        """Fly to the next sample, and react to the one that leaves the IMU then."""
        given = state.said.attitude.said
        command = given.output.torque if given.speeds is None else given.speeds
        since: Any = inputs.before
        now: Any = inputs.now
        draws = inputs.due, inputs.draws, inputs.first_draws
        condition = state.faulty.rotors
        vehicle, motion = calls.step(
            "vehicle", state.vehicle, VehicleInputs(command, condition, since, now, *draws), inputs.dt
        )
        state = state._replace(vehicle=vehicle)
        speeds = None
        if self.flies:
            line, speeds = calls.step("speeds", state.speeds, motion.flight.speeds, inputs.dt)
            state = state._replace(speeds=line)
        left = motion.imu.there
        state = calls.branch(left, lambda: self._leave(calls, state, motion, speeds, inputs), lambda: state)
        return state, LoopOutput(motion, left, state.faulty, state.said)

    def _leave(
        self,
        calls: Calls,
        state: LoopState,
        motion: VehicleOutput,
        speeds: Components | None,
        inputs: LoopInputs,
    ) -> LoopState:
        """Put the faults on a sample that leaves the IMU, and react to it if it comes."""
        given = inputs.taken, inputs.taken_dt, inputs.faults
        injections, faulty = inject(
            calls, self.injections, state.injections, motion.imu.sample, self._healthy, *given
        )
        state = state._replace(injections=injections, faulty=faulty)
        return calls.branch(
            faulty.present, lambda: self._react(calls, state, motion, speeds, inputs), lambda: state
        )

    def _react(
        self,
        calls: Calls,
        state: LoopState,
        motion: VehicleOutput,
        speeds: Components | None,
        inputs: LoopInputs,
    ) -> LoopState:
        """Run the avionics over a sample that comes."""
        clock, times = calls.step("clock", state.clock, inputs.number, 1.0)
        # the command of the sample before led to this one
        sample, before, dt = state.faulty.sample, state.said.attitude.said, times.dt
        torque = before.output.torque
        measured = np.True_ if self.flies else None
        if speeds is not None and before.speeds is not None:
            rotors, place = RotorReading(before.speeds, speeds, measured), motion.position or NO_PLACE
            seen = ObservationInputs(sample, None, rotors, place)
        else:
            seen = ObservationInputs(sample, torque)
        observer, estimate = calls.step("observer", state.observer, seen, dt)
        corrected, known = estimate.said.corrected, estimate.said.rotors
        effectiveness = self._all_there
        if known is not None:
            _, effectiveness = calls.step("trust", (), known, 1.0)
        # what follows flies on the corrected sample
        rate = DisturbanceObservationInputs(corrected, torque)
        disturbance_observer, disturbance = calls.step(
            "disturbance_observer", state.disturbance_observer, rate, dt
        )
        wanted = times.elapsed
        if self.flies:
            wanted = FlightGuidanceInputs(corrected, motion.position or NO_PLACE, times.elapsed)
        guidance, guided = calls.step("guidance", state.guidance, wanted, dt)
        said = Said(estimate, disturbance, guided, state.said.attitude)
        # the torque wanted; in free flight the speeds for it, by what the rotors still give
        loop = AttitudeLoopInputs(corrected, said.command, disturbance.said, torque)
        if self.flies:
            loop = loop._replace(speeds=speeds, measured=measured, effectiveness=effectiveness)
        attitude, given = calls.step("attitude", state.attitude, loop, dt)
        return state._replace(
            clock=clock,
            observer=observer,
            disturbance_observer=disturbance_observer,
            guidance=guidance,
            attitude=attitude,
            said=said._replace(attitude=given),
        )

    @property
    def _healthy(self) -> RotorCondition | None:
        return healthy_rotors(self.vehicle.plant.first_command) if self.flies else None

    @property
    def _all_there(self) -> Components | None:
        return np.ones(self.vehicle.plant.command_size) if self.flies else None


def said_at_first(law: Any) -> Any:
    """Return what a law says of its example."""
    inputs = law.example()
    with np.errstate(all="ignore"):
        return law.step(law.init(inputs), inputs, 0.0)[1]
