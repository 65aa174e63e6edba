"""Flights without a control loop: IMU samples with faults on them, through a fault observer alone.

The samples are simulated, or those of a recording whose IMU is healthy. The simulated vehicle follows the
references of its scenario exactly, and its healthy IMU has no delay. Nothing acts on it that an observer
could know, so the torque is zero. The faults are those of the scenario; one for which a recording is too
short is left out.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from quadftc_campaign.batch.engine import Progress
from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.flights import generator_of
from quadftc_campaign.table import Row, Rows
from quadftc_compile.engine import engine_named
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_control.reference import combined
from quadftc_fdi.observation import Observation
from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.diagnosis_metrics.which_sensor import summed_confusion
from quadftc_flight.fault_schedule import attitude_events
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.reported import joined
from quadftc_flight.scenario import Fault, Scenario
from quadftc_model.arrays import Array, Quaternion, Scalar, Vector
from quadftc_model.composition import Calls, Composition
from quadftc_model.guarded import Guarded
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import AXES, ImuSample
from quadftc_model.units import quantity
from quadftc_replay.diagnose import diagnose, flight_of
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_replay.open_loop import OpenLoop
from quadftc_replay.overlay import replay_events
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.sensor_draws import DRAWS, SensorDraws, TurnOn
from quadftc_sim.sensors import ImuInputs, ImuSensor, ImuState, resting_force

DELAY = "source.delay"
# those of tracking have no value here, but the reader looks for them
WHOLE_METRICS = ("tracking_rmse_deg", "tracking_max_deg", "fault_estimate_rmse_deg", "fault_estimate_max_deg")
_read_recording = functools.lru_cache(maxsize=2)(recording_from_bag)


class MotionInputs(NamedTuple):
    """How a vehicle moves, and the random numbers of its IMU."""

    q_xyzw: Quaternion
    body_rate: Vector  # [rad/s]
    draws: Array  # (..., 7, 3), see `quadftc_sim.sensor_draws`
    turn_on: TurnOn  # read at the first sample alone


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MovedImu:
    """An IMU on a body that moves in a known way and does not accelerate."""

    imu: ImuSensor  # without a delay
    period: float  # [s]

    @classmethod
    def of(cls, scenario: Scenario) -> MovedImu:
        """Return that of a scenario."""
        return cls(imu=dataclasses.replace(scenario.sensor, delay=0), period=1.0 / scenario.rate)

    def example(self) -> MotionInputs:
        """Return the inputs at a first sample."""
        level = np.array([0.0, 0.0, 0.0, 1.0])
        return MotionInputs(level, np.zeros(3), np.zeros(DRAWS), SensorDraws(0).turn_on)

    def init(self, inputs: MotionInputs) -> ImuState:
        """Return the state before the first sample."""
        return self.imu.init(inputs.turn_on)

    def step(self, state: ImuState, inputs: MotionInputs, dt: float) -> tuple[ImuState, ImuSample]:
        """Measure the motion."""
        force = resting_force(inputs.q_xyzw)
        seen = ImuInputs(inputs.q_xyzw, inputs.body_rate, force, inputs.draws)
        state, output = self.imu.step(state, seen, self.period)
        return state, output.sample


@dataclasses.dataclass(frozen=True, eq=False)
class Alone:
    """A law alone as a composition, of inputs and time steps."""

    law: object

    @property
    def laws(self) -> Mapping[str, object]:
        """It alone."""
        return {"law": self.law}

    def init(self, calls: Calls) -> object:
        """Return its state."""
        return calls.init("law")

    def step(self, calls: Calls, state: object, inputs: tuple[object, Scalar]) -> tuple[object, object]:
        """Advance to the next sample."""
        return calls.step("law", state, *inputs)


def simulate(scenario: Scenario, engine: str = "c") -> Recording:
    """Simulate the healthy IMU of a scenario."""
    count, period = sample_count(scenario.duration, scenario.rate), period_ns(scenario.rate)
    law = MovedImu.of(scenario)
    flown = flown_by(engine_named(engine), Alone(law), (law.example(), 0.0))
    random, dt = SensorDraws(scenario.seed), np.where(np.arange(count) == 0, 0.0, law.period)
    inputs = MotionInputs(*_motion(scenario, count), random.next(count), random.turn_on)
    parts: list[ImuSample] = []
    for begin in range(0, count, BLOCK):
        rows = slice(begin, min(begin + BLOCK, count))
        q_xyzw, body_rate, draws = (each[rows] for each in inputs[:3])
        given = MotionInputs(q_xyzw, body_rate, draws, inputs.turn_on)
        parts.append(joined([flown.run((given, dt[rows]), rows.stop - begin)]))  # a copy
    return Recording(
        name="simulated",
        path=Path("simulated"),
        topic="/imu/data",
        namespace="/",
        stamp_ns=EPOCH_NS + period * np.arange(count, dtype=np.int64),
        imu=joined(parts),
        torque=np.zeros((count, len(AXES))),
    )


def _motion(scenario: Scenario, count: int) -> tuple[Floats, Floats]:
    """Attitude (n, 4) and body rate (n, 3) [rad/s] along the references of a scenario."""
    time = np.arange(count, dtype=np.float64)[:, None] / scenario.rate
    motion = combined([part.law for part in scenario.references], time)
    angles, rates = (np.broadcast_to(each, (count, len(AXES))) for each in (motion.angles, motion.rates))
    return quaternion_from_euler(angles), body_rates(angles, rates)


def fly_open(
    campaign: Campaign, numbers: Sequence[int], scenarios: Sequence[Scenario], progress: Progress
) -> Iterator[tuple[Row, Rows]]:
    """Diagnose some flights of a campaign; yield the metrics of each flight and of its faults."""
    for number, scenario in zip(numbers, scenarios, strict=True):
        recording, faults, delay = prepare(campaign, number, scenario)
        law, injections = scenario.scheme(None).observer.law, [fault.injection for fault in faults]
        diagnosed = diagnose(recording, law, injections, scenario.seed, campaign.engine)
        flight = flight_of(recording, diagnosed)
        every = replay_events(recording, faults)
        metrics = flight_metrics(flight, (), every)
        diagnosis: Metrics = metrics["diagnosis"]
        records: Rows = diagnosis.pop("events")
        specs = {(axis, fault.injection.start): fault.spec for fault in faults for axis in fault.axes}
        for event, record in zip(attitude_events(every), records, strict=True) if records else ():
            record["spec"] = specs.get((event.axis, event.start))
        whole: Row = {
            DELAY: delay,
            "recording": recording.name,
            "finite": bool(np.isfinite(flight.fault_estimate[flight.delivered]).all()),
            **flatten({name: metrics[name] for name in WHOLE_METRICS}),
            **flatten(diagnosis),
            **summed_confusion(metrics["sensors"]),
        }
        progress(len(recording))
        yield whole, records


def loops_of(scenario: Scenario) -> list[Composition]:
    """Return what simulates and diagnoses the samples of a scenario."""
    injections = tuple(fault.injection.for_period(1.0 / scenario.rate) for fault in scenario.faults)
    observer = Guarded(Observation(scenario.scheme(None).observer.law))
    return [Alone(MovedImu.of(scenario)), OpenLoop(injections=injections, observer=observer)]


def prepare(campaign: Campaign, number: int, scenario: Scenario) -> tuple[Recording, list[Fault], float]:
    """Return samples without faults of flight ``number``, the faults to put on them, and their delay [s]."""
    delay, delays, bags = 0.0, campaign.source.delay, campaign.recordings
    if delays is not None:
        delay = quantity(delays.draw(generator_of(campaign, number, DELAY)), "s")
    recording = _read_recording(bags[number % len(bags)]) if bags else simulate(scenario, campaign.engine)
    end = recording.duration - GRACE_TIME if bags else scenario.duration
    faults: list[Fault] = []
    for injection, given in ((fault.injection, fault.given) for fault in scenario.faults):
        start, stop = (round(time + delay, 9) for time in (injection.start, injection.stop))
        if stop <= end:  # what the samples are too short for is left out
            faults.append(Fault(dataclasses.replace(injection, start=start, stop=stop), given))
    return recording, faults, delay


def flatten(nested: Mapping[str, object], prefix: str = "") -> Row:
    """Return nested mappings as one, with dotted names."""
    flat: Row = {}
    for name, value in nested.items():
        inside = cast("Mapping[str, object]", value) if isinstance(value, Mapping) else None
        flat |= {f"{prefix}{name}": value} if inside is None else flatten(inside, f"{prefix}{name}.")
    return flat
