"""Scenarios: one experiment a file, found by name, checked whole and built before anything flies.

>>> scenario = load_scenario(find_scenario("paper_faults"))
>>> parameters = node_parameters(scenario, "proposed")
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quadftc_flight.scenario.components import Fault, Part, Setting
from quadftc_flight.scenario.document import (
    ROLES,
    Document,
    Keys,
    Problem,
    ScenarioError,
    overridden,
    parse_document,
    parse_value,
    read_document,
    with_values,
)
from quadftc_flight.scenario.files import (
    find_gains,
    find_scenario,
    grade_of,
    scenario_directories,
    scenario_names,
    with_gains_of,
)
from quadftc_flight.scenario.model import (
    MAX_SEED,
    Check,
    Name,
    Scenario,
    ScheduledFault,
    Scheme,
    build_scenario,
    keys_of,
    node_parameters,
    problems_of,
)

__all__ = [
    "MAX_SEED",
    "ROLES",
    "Check",
    "Document",
    "Fault",
    "Keys",
    "Name",
    "Part",
    "Problem",
    "Scenario",
    "ScenarioError",
    "ScheduledFault",
    "Scheme",
    "Setting",
    "build_scenario",
    "changed_document",
    "find_scenario",
    "grade_of",
    "keys_of",
    "load_scenario",
    "node_parameters",
    "parse_scenario",
    "parse_value",
    "problems_of",
    "read_document",
    "scenario_directories",
    "scenario_names",
    "with_controller",
    "with_disturbance_observer",
    "with_duration",
    "with_observer",
    "with_rate",
    "with_seed",
    "with_values",
]


def load_scenario(path: str | os.PathLike[str], overrides: Sequence[str] = (), gains: str = "") -> Scenario:
    """Load a scenario file.

    Parameters
    ----------
    path : path
    overrides : sequence of str
        Values to put in place of the file's: ``seed=3``, ``faults.0.value=2 deg``.
    gains : str
        Name or path of a file of tuned gains (`quadftc_flight.scenario.files`); overrides come after them.

    Raises
    ------
    ScenarioError
        If anything is wrong with it: one line for each problem.
    """
    return build_scenario(changed_document(Path(path), overrides, gains))


def changed_document(path: Path, overrides: Sequence[str], gains: str = "") -> Document:
    """Read a scenario file, with overrides and gains as in `load_scenario`; nothing is built yet."""
    document = overridden(read_document(path), overrides)
    if gains:  # for the vehicle that overrides may have set; and what they say of gains counts
        document = overridden(with_gains_of(document, find_gains(gains)), overrides)
    return document


def parse_scenario(text: str, source: str = "scenario.yaml", overrides: Sequence[str] = ()) -> Scenario:
    """Load a scenario from YAML text, as `load_scenario` does from a file; ``source`` is named in errors."""
    return build_scenario(overridden(parse_document(text, source), overrides))


def with_rate(scenario: Scenario, rate: float | str) -> Scenario:
    """Return the scenario at another rate [Hz, or a text with its unit]."""
    return _changed(scenario, {("rate",): rate}, f"rate {rate}")


def with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with another seed."""
    return _changed(scenario, {("seed",): seed}, f"seed {seed}")


def with_observer(scenario: Scenario, kind: str, scheme: str | None = None) -> Scenario:
    """Return the scenario with another fault observer, at its defaults, in one scheme or (None) in all."""
    return _with_component(scenario, "observer", kind, scheme)


def with_disturbance_observer(scenario: Scenario, kind: str, scheme: str | None = None) -> Scenario:
    """Return the scenario with another disturbance observer, at its defaults, in one scheme or in all."""
    return _with_component(scenario, "disturbance_observer", kind, scheme)


def with_controller(scenario: Scenario, kind: str, scheme: str | None = None) -> Scenario:
    """Return the scenario with another controller, at its defaults, in one scheme or (None) in all."""
    return _with_component(scenario, "controller", kind, scheme)


def with_duration(scenario: Scenario, duration: float) -> Scenario:
    """Return the beginning of a scenario, up to ``duration`` [s]: as the whole one flies it.

    What would start later is left out, and so are the checks, which were made for the whole flight.
    """
    data = scenario.raw
    changes: dict[Keys, Any] = {("duration",): duration}
    scheduled: dict[str, Sequence[Any]] = {
        "references": [part.law for part in scenario.references],
        "disturbances": [part.law for part in scenario.disturbances],
        "faults": [fault.injection for fault in scenario.faults],
    }
    for key, laws in scheduled.items():
        if laws:
            pairs = zip(data[key], laws, strict=True)
            changes[key,] = [
                _cut(item, law, duration) for item, law in pairs if getattr(law, "start", 0.0) < duration
            ]
    for scheme in scenario.schemes:
        changes["schemes", scheme, "checks"] = []
    return _changed(scenario, changes, f"duration {duration:g} s")


def _cut(item: dict[str, Any], law: Any, duration: float) -> dict[str, Any]:
    late = getattr(law, "stop", 0.0) > duration
    return {name: value for name, value in item.items() if not (late and name in ("stop", "duration"))}


def _with_component(scenario: Scenario, key: str, kind: str, scheme: str | None) -> Scenario:
    schemes = list(scenario.schemes) if scheme is None else [scenario.scheme(scheme).name]
    return _changed(scenario, {("schemes", name, key): kind for name in schemes}, f"{key} {kind}")


def _changed(scenario: Scenario, changes: dict[Keys, Any], origin: str) -> Scenario:
    document = scenario.document
    for path, value in changes.items():
        document = document.replaced(path, value, origin)
    return build_scenario(document)
