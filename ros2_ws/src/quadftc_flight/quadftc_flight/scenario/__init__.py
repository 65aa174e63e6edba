# pyright: reportUnusedImport=false
# ruff: noqa: F401
"""Scenarios: one experiment a file, found by name, checked whole and built before anything flies.

>>> scenario = load_scenario(find_scenario("paper_faults"))
>>> parameters = node_parameters(scenario, "proposed")
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from quadftc_flight.scenario.components import Fault, Part, Setting
from quadftc_flight.scenario.document import (
    ROLES,
    Document,
    Keys,
    Problem,
    ScenarioError,
    parse_document,
    parse_value,
    read_document,
    refuse_kind,
)
from quadftc_flight.scenario.files import find_gains, find_scenario, grade_of, scenario_names, with_gains_of
from quadftc_flight.scenario.model import (
    MAX_SEED,
    Check,
    Name,
    Scenario,
    ScheduledFault,
    Scheme,
    build_scenario,
    estimator_for,
    keys_of,
    node_parameters,
    problems_of,
)


def load_scenario(path: str | os.PathLike[str], overrides: Sequence[str] = (), gains: str = "") -> Scenario:
    """Load a scenario file; a ScenarioError has one line for each problem.

    ``overrides`` replace values: ``seed=3``, ``faults.0.value=2 deg``, also those of ``gains``, the name or
    path of a file of tuned gains (`quadftc_flight.scenario.files`).
    """
    return build_scenario(changed_document(Path(path), overrides, gains))


def changed_document(path: Path, overrides: Sequence[str], gains: str = "") -> Document:
    """Read a scenario file, with overrides and gains as in `load_scenario`; nothing is built yet."""
    document = read_document(path)
    refuse_kind(document, "campaign")
    document = document.overridden(overrides)
    if gains:  # for the vehicle that overrides may have set; and what they say of gains counts
        document = with_gains_of(document, find_gains(gains)).overridden(overrides)
    return document


def parse_scenario(text: str, source: str = "scenario.yaml", overrides: Sequence[str] = ()) -> Scenario:
    """Load a scenario from YAML text, as `load_scenario` does from a file; ``source`` is named in errors."""
    return build_scenario(parse_document(text, source).overridden(overrides))


def with_rate(scenario: Scenario, rate: float | str) -> Scenario:
    """Return the scenario at another rate [Hz, or a text with its unit]."""
    return build_scenario(scenario.document.replaced({("rate",): rate}, f"rate {rate}"))


def with_seed(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with another seed."""
    return build_scenario(scenario.document.replaced({("seed",): seed}, f"seed {seed}"))


def with_components(scenario: Scenario, scheme: str | None = None, **kinds: str) -> Scenario:
    """Return the scenario with other components, at their defaults, in one scheme or (None) in all.

    ``kinds`` gives observer, disturbance_observer and controller by name; empty: they stay as they are.
    """
    schemes = list(scenario.schemes) if scheme is None else [scenario.scheme(scheme).name]
    for role, kind in kinds.items():
        if kind:
            changes: dict[Keys, object] = {("schemes", name, role): kind for name in schemes}
            scenario = build_scenario(scenario.document.replaced(changes, f"{role} {kind}"))
    return scenario


def label_of(scenario: Scenario, scheme: str, plain: Scenario) -> str:
    """Name a scheme by its components that are not those of the plain scenario: ``proposed-pid``."""
    mine, original = scenario.schemes[scheme], plain.schemes[scheme]
    pairs = [(getattr(mine, role).kind, getattr(original, role).kind) for role in ROLES]
    return "-".join([scheme, *(kind for kind, before in pairs if kind != before)])


def relabelled(scenario: Scenario, scheme: str, label: str) -> tuple[Scenario, Scheme]:
    """Return the scenario with a scheme under another name, and that scheme."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}", label):
        raise ScenarioError(f"label {label!r}: expected letters, digits, _ and -")
    if label == scheme:
        return scenario, scenario.schemes[scheme]
    if label in scenario.schemes:
        raise ScenarioError(f"label {label!r}: the scenario has a scheme of that name")
    schemes = scenario.raw["schemes"]
    renamed = {label if name == scheme else name: parts for name, parts in schemes.items()}
    named = build_scenario(scenario.document.replaced({("schemes",): renamed}, f"label {label}"))
    return named, named.schemes[label]


def with_duration(scenario: Scenario, duration: float) -> Scenario:
    """Return the beginning of a scenario, up to ``duration`` [s]: as the whole one flies it.

    What would start later is left out, and so are the checks, which were made for the whole flight.
    """
    changes: dict[Keys, object] = {("duration",): duration}
    changes |= {("schemes", scheme, "checks"): [] for scheme in scenario.schemes}
    scheduled: dict[str, list[object]] = {
        "references": [part.law for part in scenario.references],
        "disturbances": [part.law for part in scenario.disturbances],
        "faults": [fault.injection for fault in scenario.faults],
        "wind": [part.law for part in scenario.winds],
        "trajectories": [part.law for part in scenario.trajectories],
    }
    for key, laws in scheduled.items():
        pairs = zip(scenario.raw.get(key) or (), laws, strict=True)
        kept = [_cut(item, law, duration) for item, law in pairs if getattr(law, "start", 0.0) < duration]
        changes |= {(key,): kept} if laws else {}
    return build_scenario(scenario.document.replaced(changes, f"duration {duration:g} s"))


def _cut(item: Mapping[str, object], law: object, duration: float) -> dict[str, object]:
    late = getattr(law, "stop", 0.0) > duration
    return {name: value for name, value in item.items() if not (late and name in ("stop", "duration"))}
