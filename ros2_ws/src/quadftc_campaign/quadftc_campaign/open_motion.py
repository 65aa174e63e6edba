"""Simulated samples without a control loop: a vehicle that follows the references of its scenario exactly.

It is seen by the healthy IMU of the scenario, without a delay. Nothing acts on the vehicle that an observer
could know, so the torque is zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadftc_compile.engine import engine_named
from quadftc_compile.wiring import BLOCK, flown_by
from quadftc_control.reference import combined
from quadftc_flight.reported import joined
from quadftc_flight.scenario import Scenario
from quadftc_model.arrays import Array, Quaternion, Scalar, Vector
from quadftc_model.composition import Calls
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import AXES, ImuSample
from quadftc_replay.imu_recording import Floats, Recording
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.sensor_draws import DRAWS, SensorDraws, TurnOn
from quadftc_sim.sensors import ImuInputs, ImuSensor, ImuState, resting_force


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
