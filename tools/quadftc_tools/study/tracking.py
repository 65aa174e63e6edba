"""The table of position errors in docs/free_flight.md: every vehicle on three trajectories, in wind.

    python -m quadftc_tools.study.tracking [--docs docs]

Wind and sensors are those of the scenario `free_circle`, and all gains are defaults. Without ``--docs`` the
table is printed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadftc_cli.commands import BAD_INPUT, GOOD
from quadftc_cli.screen import say
from quadftc_control.position_controller import position_controllers
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Floats
from quadftc_flight.scenario import Scenario, build_scenario, changed_document
from quadftc_flight.scenario.document import Keys
from quadftc_flight.scenario.files import find_scenario
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_model.vehicle import vehicle_names
from quadftc_tools.study.numbers import write_number
from quadftc_tools.study.page import markdown, publish_tables

PAGE = "free_flight.md"
DURATION, JUDGED = 16.0, 5.0  # s; of a flight, and from when on it is judged
BIAS = 1.0  # m/s²
CIRCLE = {"kind": "circle", "centre": [0, 0, 1.5], "radius": 2.0, "speed": 2.0, "start": 1.0}
TRAJECTORIES: dict[str, tuple[dict[str, Any], list[Any]]] = {  # with the place to start from
    "hover": ({"kind": "hover", "position": [0, 0, 1.5]}, [0, 0, 1.5]),
    "circle": (CIRCLE, [2, 0, 1.5]),
    "figure of eight": (
        {"kind": "figure_eight", "centre": [0, 0, 1.5], "period": 8.0, "start": 1.0},
        [0, 0, 1.5],
    ),
}


class Tracking(NamedTuple):
    """How far a vehicle was from where it should have been, after `JUDGED`."""

    rms: float  # [m]
    largest: float  # [m]


def scenario_of(vehicle: str, trajectory: str, controller: str, faults: Sequence[Any] = ()) -> Scenario:
    """Return the scenario `free_circle` with another vehicle, trajectory and position controller."""
    flown, start = TRAJECTORIES[trajectory]
    scheme = {"observer": "none", "disturbance_observer": "exosystem", "controller": "ismc"}
    changes: dict[Keys, Any] = {
        ("vehicle",): vehicle,
        ("duration",): DURATION,
        ("plant", "start"): start,
        ("trajectories",): [flown],
        ("faults",): list(faults),
        ("schemes",): {"tracking": {**scheme, "position_controller": controller}},
    }
    document = changed_document(find_scenario("free_circle"), ())
    return build_scenario(document.replaced(changes, "study of tracking"))


def tracked(scenario: Scenario) -> Tracking:
    """Fly a scenario and measure the errors."""
    flight = fly(scenario)
    late = flight.stamp_ns - flight.stamp_ns[0] >= JUDGED * NANOSECONDS_PER_SECOND
    squares: Floats = np.sum((flight.position - flight.position_reference)[late] ** 2, axis=1)
    return Tracking(float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares))))


def make() -> dict[str, str]:
    """Fly all of them and return the table."""
    bias = {"kind": "bias", "channel": "accelerometer", "axes": "x", "value": BIAS, "start": 8.0}
    flights: dict[str, tuple[str, list[Any]]] = {name: (name, []) for name in TRAJECTORIES}
    flights["circle, accelerometer +1 m/s²"] = ("circle", [bias])
    rows = [
        [vehicle, controller]
        + [
            _write(tracked(scenario_of(vehicle, name, controller, faults)))
            for name, faults in flights.values()
        ]
        for vehicle in vehicle_names()
        for controller in position_controllers.names()
    ]
    return {"tracking": markdown(["vehicle", "position controller", *flights], rows)}


def _write(result: Tracking) -> str:
    return f"{write_number(result.rms)} / {write_number(result.largest)} m"


def main() -> int:
    """Write the table into the page, or print it."""
    parser = argparse.ArgumentParser(prog="tracking", description=f"Table of position errors of docs/{PAGE}.")
    parser.add_argument("--docs", type=Path, help=f"directory of {PAGE}")
    options = parser.parse_args()
    try:
        publish_tables(make(), options.docs and options.docs / PAGE)
    except (ValueError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return BAD_INPUT
    return GOOD


if __name__ == "__main__":
    raise SystemExit(main())
