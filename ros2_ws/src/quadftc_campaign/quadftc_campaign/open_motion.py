"""Simulated samples without a control loop: vehicles that follow the references of their scenarios exactly.

Each is seen by the healthy IMU of its scenario, without a delay. Nothing acts on the vehicle that an observer
could know, so the torque is zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from quadftc_control.reference import combined
from quadftc_flight.scenario import Scenario
from quadftc_model.rotations import body_rates, quaternion_from_euler
from quadftc_model.samples import AXES, ImuSample
from quadftc_replay.imu_recording import Recording
from quadftc_sim.assembly import EPOCH_NS, period_ns, sample_count
from quadftc_sim.sensor_draws import SensorDraws, TurnOn
from quadftc_sim.sensors import resting_force


def simulate(scenario: Scenario) -> Recording:
    """Simulate the healthy IMU of one scenario."""
    return simulate_all([scenario])[0]


def simulate_all(scenarios: Sequence[Scenario]) -> list[Recording]:
    """Simulate the healthy IMU of each scenario; those with the same sensor, rate and duration at once."""
    groups: dict[Any, list[int]] = {}
    for place, each in enumerate(scenarios):
        key = (each.rate, each.duration, *dataclasses.astuple(each.sensor))
        groups.setdefault(key, []).append(place)
    found: dict[int, Recording] = {}
    for places in groups.values():
        found |= dict(zip(places, _simulate_alike([scenarios[place] for place in places]), strict=True))
    return [found[place] for place in range(len(scenarios))]


def _simulate_alike(scenarios: Sequence[Scenario]) -> list[Recording]:
    """Simulate scenarios of one sensor, rate and duration."""
    first = scenarios[0]
    count, dt = sample_count(first.duration, first.rate), 1.0 / first.rate
    sensor = dataclasses.replace(first.sensor, delay=0)
    random = [SensorDraws(each.seed) for each in scenarios]
    q_xyzw, body_rate = (np.stack(each, axis=1) for each in zip(*map(_motion, scenarios), strict=True))
    draws = np.stack([each.next(count, sensor.wanders) for each in random], axis=1)
    turn_on = TurnOn(*map(np.stack, zip(*(each.turn_on for each in random), strict=True)))
    state, samples = sensor.turn_on(turn_on), list[ImuSample]()
    for row in range(count):
        force = resting_force(q_xyzw[row])
        state, sample = sensor.step(state, q_xyzw[row], body_rate[row], force, draws[row], dt)
        samples.append(cast("ImuSample", sample))  # as nothing is delayed
    columns = [np.stack(column, axis=1) for column in zip(*samples, strict=True)]  # (flights, n, ...)
    return [
        Recording(
            name="simulated",
            path=Path("simulated"),
            topic="/imu/data",
            namespace="/",
            stamp_ns=EPOCH_NS + period_ns(first.rate) * np.arange(count, dtype=np.int64),
            imu=ImuSample(*(column[flight] for column in columns)),
            torque=np.zeros((count, len(AXES))),
        )
        for flight in range(len(scenarios))
    ]


def _motion(scenario: Scenario) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Attitude (n, 4) and body rate (n, 3) [rad/s] along the references of a scenario."""
    count = sample_count(scenario.duration, scenario.rate)
    time = np.arange(count, dtype=np.float64)[:, None] / scenario.rate
    motion = combined([part.law for part in scenario.references], time)
    angles, rates = (np.broadcast_to(each, (count, len(AXES))) for each in (motion.angles, motion.rates))
    return quaternion_from_euler(angles), body_rates(angles, rates)
