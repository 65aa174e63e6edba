"""Scenarios and tuned gains: files found by name or given by path; and gains put into a scenario.

``quadftc tune`` writes files of gains:

    vehicle: qball_x4
    grade: mems
    disturbance_observer: {kind: exosystem, bandwidth: 9.1}
    controller: {kind: ismc, k_c1: [14.6, 17.1, 9.9]}

A scheme takes the gains of its parts of the kinds that the file names; so one file serves all schemes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ConfigDict, ValidationError

from quadftc_flight.scenario.document import ROLES, Document, Problem, ScenarioError, read_document
from quadftc_flight.scenario.model import problems_of
from quadftc_model.hints import nearest

SEARCH_PATH = "QUADFTC_SCENARIO_PATH"  # environment variable: directories, separated as in PATH


def find_scenario(name_or_path: str) -> Path:
    """Find a scenario by path, or by name in $QUADFTC_SCENARIO_PATH, ./scenarios, the repository's."""
    return _find_file(name_or_path, _scenario_folders(), "scenario", f"give a path, or set {SEARCH_PATH}")


def find_gains(name_or_path: str) -> Path:
    """Find a file of gains: by its path, or by its name in ./gains or the repository's."""
    return _find_file(name_or_path, _folders_named("gains"), "gains", "give a path")


def scenario_names() -> tuple[str, ...]:
    """Return the names of all scenarios that can be found without a path, sorted."""
    return _names_in(_scenario_folders())


def _scenario_folders() -> tuple[Path, ...]:
    given = [Path(part) for part in os.environ.get(SEARCH_PATH, "").split(os.pathsep) if part]
    return (*given, *_folders_named("scenarios"))


def _find_file(name_or_path: str, folders: Sequence[Path], what: str, advice: str) -> Path:
    """Find a YAML file by its path, or by its name in one of some folders; messages call it ``what``."""
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml") or path.name != name_or_path:
        if path.is_file():
            return path
        raise ScenarioError(f"{path}: {'a directory; expected a file' if path.is_dir() else 'no such file'}")
    for file in (folder / f"{name_or_path}.yaml" for folder in folders):
        if file.is_file():  # the path as one would type it, if it is below the working directory
            full, here = file.resolve(), Path.cwd()
            return full.relative_to(here) if full.is_relative_to(here) else file
    names = _names_in(folders)
    there = ", ".join(names) or f"none; {advice}"
    raise ScenarioError(f"no {what} '{name_or_path}'{nearest(name_or_path, names)}; there are: {there}")


def _names_in(folders: Sequence[Path]) -> tuple[str, ...]:
    return tuple(sorted({file.stem for folder in folders for file in folder.glob("*.yaml")}))


def _folders_named(name: str) -> tuple[Path, ...]:
    """Return a folder in the working directory, and the repository's, if there is one."""
    above = (parent / name for parent in Path(__file__).resolve().parents)
    own = next((folder for folder in above if any(folder.glob("*.yaml"))), None)
    return (Path(name),) if own is None else (Path(name), own)


class _PartGains(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)
    kind: str


class _GainsFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    vehicle: str
    grade: str
    observer: _PartGains | None = None
    disturbance_observer: _PartGains | None = None
    controller: _PartGains | None = None


def with_gains_of(document: Document, path: Path) -> Document:
    """Put the gains of a file into all schemes of a scenario; ScenarioError if they do not fit."""
    file = read_document(path)
    try:
        gains = _GainsFile.model_validate(file.data)
    except ValidationError as error:
        raise file.error(problems_of(error, lambda _: _GainsFile)) from None
    there = {"vehicle": document.data.get("vehicle"), "grade": grade_of(document)}
    problems = [
        Problem((key,), f"'{getattr(gains, key)}': {document.source} has '{value}'")
        for key, value in there.items()
        if getattr(gains, key) != value
    ]
    changed, schemes = document, _mapping(document.data.get("schemes"))
    for name, scheme in schemes.items():
        for role in ROLES:
            part: _PartGains | None = getattr(gains, role)
            raw = _mapping(scheme).get(role)
            given = _mapping(raw) or {"kind": raw}
            if part is not None and given.get("kind") == part.kind:
                values = {**given, **(part.model_extra or {})}
                changed = changed.replaced({("schemes", name, role): values}, f"gains {path}")
    if changed is document and not problems:
        problems.append(Problem((), f"no scheme of {document.source} has a part of these kinds"))
    if problems:
        raise file.error(problems)
    return changed


def grade_of(document: Document) -> str:
    """Return the grade of the sensors, as the scenario names it."""
    return str(_mapping(document.data.get("sensors")).get("grade", "ideal"))


def _mapping(value: object) -> dict[str, object]:
    """Return what should be a mapping; of anything else, an empty one."""
    return cast("dict[str, object]", value) if isinstance(value, dict) else {}
