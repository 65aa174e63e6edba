"""Scenarios: one experiment a file, found by name, checked whole and built before anything flies.

>>> scenario = load_scenario(find_scenario("paper_faults"))
>>> parameters = node_parameters(scenario, "proposed")
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from quadftc_flight.scenario.build import build_scenario
from quadftc_flight.scenario.gains import find_gains, with_gains_of
from quadftc_flight.scenario.lookup import find_file, folders_named, names_in
from quadftc_flight.scenario.node_parameters import node_parameters
from quadftc_flight.scenario.overrides import overridden
from quadftc_flight.scenario.types import Check, Fault, Part, Scenario, Scheme
from quadftc_flight.scenario.yaml_document import Document, Keys, ScenarioError, parse_document, read_document

__all__ = [
    "Check",
    "Fault",
    "Part",
    "Scenario",
    "ScenarioError",
    "Scheme",
    "changed_document",
    "find_scenario",
    "load_scenario",
    "node_parameters",
    "parse_scenario",
    "scenario_directories",
    "scenario_names",
    "with_controller",
    "with_disturbance_observer",
    "with_duration",
    "with_observer",
    "with_rate",
    "with_seed",
]

SEARCH_PATH = "QUADFTC_SCENARIO_PATH"  # environment variable: directories, separated as in PATH


def load_scenario(path: str | os.PathLike[str], overrides: Sequence[str] = (), gains: str = "") -> Scenario:
    """Load a scenario file.

    Parameters
    ----------
    path : path
    overrides : sequence of str
        Values to put in place of the file's: ``seed=3``, ``faults.0.value=2 deg``.
    gains : str
        Name or path of a file of tuned gains (`quadftc_flight.scenario.gains`); overrides come after them.

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


def find_scenario(name_or_path: str) -> Path:
    """Find a scenario file: by its path, or by its name in one of the `scenario_directories`.

    Raises
    ------
    ScenarioError
        If there is none.
    """
    advice = f"give a path, or set {SEARCH_PATH}"
    return find_file(name_or_path, scenario_directories(), "scenario", advice)


def scenario_names() -> tuple[str, ...]:
    """Return the names of all scenarios that can be found without a path, sorted."""
    return names_in(scenario_directories())


def scenario_directories() -> tuple[Path, ...]:
    """Return where scenarios are looked for: $QUADFTC_SCENARIO_PATH, ./scenarios, the repository's."""
    given = [Path(part) for part in os.environ.get(SEARCH_PATH, "").split(os.pathsep) if part]
    return (*given, *folders_named("scenarios"))


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
