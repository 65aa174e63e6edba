"""What is flown unless somebody asks for something else, and its laws, compiled before they are waited for.

``python -m quadftc_flight.recommended`` compiles the laws of the demo and of ``quadftc live``.
"""

from __future__ import annotations

import sys

from quadftc_compile.engine import CEngine
from quadftc_control.guidance import live_guidance_from
from quadftc_control.reference import SetpointFilter
from quadftc_flight.closed_loop import loop_of
from quadftc_flight.scenario import Scenario, find_scenario, load_scenario, node_parameters, parse_scenario

DEMO = ("mems_faults", "paper_faults", "paper_constant_disturbance", "paper_varying_disturbance")
COMMON = """
name: live
duration: 3600 s
rate: 250 Hz
seed: 1
sensors: {grade: mems}
"""
HOVER = f"""
{COMMON}
description: Hover in a light wind
vehicle: x500
plant: {{kind: free_flight, start: [0, 0, 1.5]}}
position_sensor: {{grade: mocap}}
trajectories:
  - {{kind: hover, position: [0, 0, 1.5]}}
wind:
  - {{kind: dryden, wind_speed: 3, airspeed: 2, height: 6}}
schemes:
  bank:
    observer: bank
    disturbance_observer: exosystem
    controller: ismc
    position_controller: geometric
"""
LEVEL = f"""
{COMMON}
description: Level on a test stand
vehicle: qball_x4
schemes:
  bank: {{observer: bank, disturbance_observer: exosystem, controller: ismc}}
"""


def recommended_laws() -> list[object]:
    """Return the laws of the demo and of ``quadftc live``; those that take longest to compile come first."""
    live = [parse_scenario(text, "live") for text in (HOVER, LEVEL)]
    flown = [*live, *(load_scenario(find_scenario(name)) for name in DEMO)]
    laws = [law for each in flown for scheme in each.schemes for law in _laws(each, scheme)]
    steered = node_parameters(live[0], None)["position_controller"]
    return [*laws, live_guidance_from(steered), SetpointFilter()]


def _laws(scenario: Scenario, scheme: str) -> list[object]:
    return list(loop_of(scenario, scenario.scheme(scheme)).laws.values())


if __name__ == "__main__":
    sys.exit(None in CEngine().prepare(recommended_laws()))
