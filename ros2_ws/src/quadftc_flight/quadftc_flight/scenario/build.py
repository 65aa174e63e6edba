"""From the document of a scenario to the scenario: shape checked, everything built, all problems reported."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from quadftc_control.controller import controllers
from quadftc_control.reference import references
from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.fault_observer import fault_observers
from quadftc_flight.metrics import known_metrics, look_up
from quadftc_flight.scenario.parts import PartBuilder
from quadftc_flight.scenario.schema import MAX_DURATION, MIN_DURATION, CheckShape, ScenarioShape, shape_of
from quadftc_flight.scenario.types import Check, Part, Scenario, Scheme
from quadftc_flight.scenario.yaml_document import Document, Keys, Problem
from quadftc_model.samples import AXES
from quadftc_model.units import quantity
from quadftc_model.vehicle import Vehicle
from quadftc_sim.disturbance import disturbances
from quadftc_sim.plant import Plant

LAG_A_STEP = 2.0  # 1; motor bandwidth times integration step; from 2.78 on Runge-Kutta of order 4 is unstable

_ROLES = {
    "observer": fault_observers,
    "disturbance_observer": disturbance_observers,
    "controller": controllers,
}  # what a scheme consists of


def build_scenario(document: Document) -> Scenario:
    """Check a document and build everything in it.

    Raises
    ------
    ScenarioError
        If anything is wrong: one line for each problem.
    """
    data = document.data
    shape, problems = shape_of(data)
    builder = PartBuilder(_duration(data))
    vehicle = builder.vehicle(data.get("vehicle"), Path(document.source).parent)
    sensor = builder.sensor(data.get("sensors"))
    plant = builder.plant(data.get("plant"), vehicle[1] if vehicle else None)
    parts: dict[str, Any] = {
        "references": builder.parts(references, data.get("references"), ("references",)),
        "disturbances": builder.parts(disturbances, data.get("disturbances"), ("disturbances",)),
        "faults": builder.faults(data.get("faults")),
    }
    roles = _roles(builder, data.get("schemes"), vehicle[1] if vehicle else None)
    problems += builder.problems
    if shape is not None and plant is not None:
        problems += _unstable_lag(plant, shape.rate)
    if problems or shape is None or vehicle is None or plant is None or sensor is None:
        raise document.error(problems)
    scenario = Scenario(
        name=shape.name or re.sub(r"\W", "_", Path(document.source).stem),
        description=shape.description,
        duration=shape.duration,
        rate=shape.rate,
        seed=shape.seed,
        vehicle=vehicle[0],
        plant=plant,
        sensor=sensor,
        schemes={
            name: Scheme(name=name, checks=tuple(map(_check, scheme.checks)), **roles[name])
            for name, scheme in shape.schemes.items()
        },
        document=document,
        **parts,
    )
    problems = list(_wrong_checks(shape, scenario))
    if problems:
        raise document.error(problems)
    return scenario


def _duration(data: dict[str, Any]) -> float | None:
    """The duration [s] if the file gives a good one."""
    try:
        duration = quantity(data["duration"], "s")
    except (KeyError, ValueError, TypeError):
        return None
    return duration if MIN_DURATION <= duration <= MAX_DURATION else None


def _roles(builder: PartBuilder, raw: Any, vehicle: Vehicle | None) -> dict[str, dict[str, Part]]:
    """Build observers and controller of every scheme; what the file leaves out is ``none``."""
    schemes: dict[str, dict[str, Part]] = {}
    for name, scheme in cast("dict[str, Any]", raw if isinstance(raw, dict) else {}).items():
        if not isinstance(scheme, dict):
            continue
        given = {"observer": "none", "disturbance_observer": "none", **cast("dict[str, Any]", scheme)}
        built = {
            role: builder.part(registry, given.get(role), ("schemes", name, role), vehicle=vehicle)
            for role, registry in _ROLES.items()
        }
        schemes[name] = {role: part for role, part in built.items() if part is not None}
    return schemes


def _unstable_lag(plant: Plant, rate: float) -> Iterator[Problem]:
    """Refuse a motor lag that is too fast to be integrated at a rate [Hz]."""
    steps = 1.0 / (rate * plant.motor_time_constant)
    needed = math.ceil(steps / LAG_A_STEP)
    if plant.motor_lag and plant.substeps < needed:
        lag = f"{steps * rate:.4g} rad/s of motor lag at {rate:g} Hz"
        text = f"{plant.substeps}: {lag} need {needed} at least"
        yield Problem(("plant", "substeps"), text)


def _check(shape: CheckShape) -> Check:
    return Check(shape.metric, shape.axis, shape.above, shape.below)


def _wrong_checks(shape: ScenarioShape, scenario: Scenario) -> Iterator[Problem]:
    """Find the checks on metrics that no flight of this scenario has."""
    if not any(scheme.checks for scheme in shape.schemes.values()):
        return
    metrics = known_metrics(len(scenario.fault_windows), scenario.fault_events)
    for name, scheme in shape.schemes.items():
        for index, check in enumerate(scheme.checks):
            path: Keys = ("schemes", name, "checks", index)
            try:
                found = look_up(metrics, check.metric)
            except KeyError as error:
                yield Problem((*path, "metric"), str(error.args[0]))
                continue
            has_axes = isinstance(found, dict) and set(cast("dict[str, Any]", found)) == set(AXES)
            if check.axis is not None and not has_axes:
                yield Problem((*path, "axis"), f"'{check.metric}' has no axes")
            elif not has_axes and found is not None and not isinstance(found, (int, float)):
                yield Problem((*path, "metric"), f"'{check.metric}' is no number")
