"""From a scenario to the parameters of each node: the one compiled form, for graph and closed loop alike.

| node | parameters |
|---|---|
| plant | vehicle, rate [Hz], duration [s], seed, <parameter>, disturbances, imu.<parameter> |
| fault_injector | seed, faults |
| fault_observer, disturbance_observer | vehicle, observer, <observer>.<parameter> |
| controller | vehicle, controller, <controller>.<parameter> |
| reference | references |

Lists of components are lists of specifications (quadftc_model.spec) in SI. Of plant, observers and
controllers every parameter is there, defaults included.
"""

from __future__ import annotations

from quadftc_flight.scenario.types import Part, Scenario, Scheme
from quadftc_model.assembly import NodeValue, node_values


def node_parameters(
    scenario: Scenario, scheme: Scheme | str | None = None
) -> dict[str, dict[str, NodeValue]]:
    """Compile a scenario and one of its schemes (the first by default): node name to parameters.

    Raises
    ------
    ScenarioError
        If the scenario has no scheme of that name.
    """
    chosen = scheme if isinstance(scheme, Scheme) else scenario.scheme(scheme)
    vehicle = scenario.vehicle
    return {
        "plant": {
            "vehicle": vehicle,
            "rate": scenario.rate,
            "duration": scenario.duration,
            "seed": scenario.seed,
            **node_values(scenario.plant, ""),
            "disturbances": [part.spec for part in scenario.disturbances],
            **node_values(scenario.sensor, "imu"),
        },
        "fault_injector": {"seed": scenario.seed, "faults": [fault.spec for fault in scenario.faults]},
        "fault_observer": _with_vehicle(vehicle, "observer", chosen.observer),
        "disturbance_observer": _with_vehicle(vehicle, "observer", chosen.disturbance_observer),
        "controller": _with_vehicle(vehicle, "controller", chosen.controller),
        "reference": {"references": [part.spec for part in scenario.references]},
    }


def _with_vehicle(vehicle: str, selector: str, part: Part) -> dict[str, NodeValue]:
    return {"vehicle": vehicle, selector: part.kind, **node_values(part.law, part.kind)}
