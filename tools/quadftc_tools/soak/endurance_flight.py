# pyright: basic
"""Repeats flights in one process; prints how far it is, one JSON object a line.

``python3 -m quadftc_tools.soak.endurance_flight MODE GRAPH RATE LENGTH MINUTES FOLDER``. Every flight is
recorded to ``FOLDER/NUMBER``; in lock-step the time may cut the last, unless it is the first.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.runs import GRAPHS
from quadftc_flight.scenario import Scenario, node_parameters
from quadftc_ros.scheduling import ORDINARY
from quadftc_tools.soak.node_flight import best_scheduling, soak_scenario

TOLD_EVERY = 5.0  # s
CYCLE, REST = 60.0, 5.0  # s; in each of which both faults act and end, once the gyro bias is learned

BASE = """
name: soak_endurance
description: Long flights with a sensor fault and a disturbance in every minute
vehicle: qball_x4
sensors: {grade: mems}
references:
  - {kind: sine, amplitude: [3 deg, 2 deg, 5 deg], frequency: [0.7 rad/s, 0.9 rad/s, 0.5 rad/s]}
schemes:
  supervised: {observer: supervised, disturbance_observer: exosystem, controller: ismc}
"""


def scenario_of(rate: float, length: float, seed: int) -> Scenario:
    """Flight of a length [s] at a rate [Hz]."""
    faults: list[str] = []
    disturbances: list[str] = []
    for cycle in range(int(length // CYCLE)):
        begin = REST + CYCLE * cycle
        for fault, start in (("axes: roll, value: 2 deg", 5.0), ("axes: pitch, value: -3 deg", 10.0)):
            first = begin + start
            faults.append(f"kind: bias, {fault}, start: {first:g} s, stop: {first + 20.0:g} s")
        disturbances.append(f"start: {begin + 35.0:g} s, stop: {begin + 50.0:g} s")
    return soak_scenario(BASE, faults, disturbances, rate, length, seed)


def fly_repeatedly(mode: str, kind: str, rate: float, length: float, minutes: float, folder: Path) -> None:
    """Fly until the time is over; a flight in real time to its end."""
    end = time.monotonic() + 60.0 * minutes
    scheduling = best_scheduling() if mode == "realtime" else ORDINARY
    number = 0
    while time.monotonic() < end:
        number += 1
        parameters = node_parameters(scenario_of(rate, length, number))
        plan = GraphPlan(parameters, mode, bag=folder / str(number), scheduling=scheduling)
        told = 0.0
        _tell(flight=number)

        def cut() -> bool:
            return mode == "lockstep" and number > 1 and time.monotonic() >= end  # noqa: B023

        def follow(samples: int) -> bool:
            nonlocal told
            now = time.monotonic()
            if now - told >= TOLD_EVERY:
                told = now
                _tell(samples=samples)
            return not cut()

        with GRAPHS[kind](plan) as graph:
            wall = graph.run(follow)
            recorder = graph.recorder
            assert recorder is not None
            status = recorder.finish()
        _tell(flown=number, wall_s=wall, cut=cut(), dropped=sum(status.dropped.values()) + status.lost)


def _tell(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    chosen, of_graph, *numbers, where = sys.argv[1:]
    fly_repeatedly(chosen, of_graph, *(float(each) for each in numbers), folder=Path(where))
