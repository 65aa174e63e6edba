"""What one step of each fault observer costs on this machine, for one vehicle in NumPy."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from typing import Any

from quadftc_campaign.open_loop import simulate
from quadftc_fdi.fault_observer import fault_observer_from, fault_observers
from quadftc_flight.scenario import load_scenario
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_tools.study.diagnosis_results import SCENARIO

RATE = 250.0  # Hz
DURATION = 6.0  # s of flight; by then an observer has started
BATCHES, STEPS = 40, 250
MICROSECONDS = 1e6


def step_costs(vehicle: str = "qball_x4") -> Iterator[dict[str, Any]]:
    """Measure every fault observer on a simulated healthy flight with a MEMS IMU at 250 Hz.

    Yields
    ------
    dict
        ``observer``; ``best_us``, ``median_us`` of batches of 250 steps.
    """
    short = [f"duration={DURATION} s", f"rate={RATE} Hz", "faults=[]"]
    recording = simulate(load_scenario(SCENARIO, short))
    samples = [
        FaultObserverInputs(ImuSample(*row), torque)
        for *row, torque in zip(*recording.imu, recording.torque, strict=True)
    ]
    for name in fault_observers.names():
        law = fault_observer_from({"vehicle": vehicle, "observer": name})
        state, _ = law.step(law.init(samples[0]), samples[0], 0.0)
        for inputs in samples[1:-STEPS]:
            state, _ = law.step(state, inputs, 1.0 / RATE)
        yield {"observer": name, **_costs(law, state, samples[-STEPS:])}


def _costs(law: Any, start: Any, samples: list[FaultObserverInputs]) -> dict[str, float]:
    found: list[float] = []
    for _ in range(BATCHES):
        state, begin = start, time.perf_counter()
        for inputs in samples:
            state, _ = law.step(state, inputs, 1.0 / RATE)
        found.append(MICROSECONDS * (time.perf_counter() - begin) / len(samples))
    return {"best_us": round(min(found), 1), "median_us": round(statistics.median(found), 1)}
