"""Files of tuned gains, as ``quadftc tune`` writes them, put into the schemes of a scenario.

vehicle: qball_x4
grade: mems
disturbance_observer: {kind: exosystem, bandwidth: 9.1}
controller: {kind: ismc, k_c1: [14.6, 17.1, 9.9]}

A scheme takes the gains of those of its parts that are of the kind the file names; so one file serves all
schemes of a scenario.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from pydantic import BaseModel, ConfigDict, ValidationError

from quadftc_flight.scenario.lookup import find_file, folders_named
from quadftc_flight.scenario.schema import problems_of
from quadftc_flight.scenario.yaml_document import Document, Keys, Problem, read_document

ROLES = ("observer", "disturbance_observer", "controller")


class PartGains(BaseModel):
    """Gains of a part: its kind, and parameters by name."""

    model_config = ConfigDict(extra="allow", frozen=True)
    kind: str


class GainsShape(BaseModel):
    """The keys of the file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    vehicle: str
    grade: str
    observer: PartGains | None = None
    disturbance_observer: PartGains | None = None
    controller: PartGains | None = None


def find_gains(name_or_path: str) -> Path:
    """Find a file of gains: by its path, or by its name in ./gains or the repository's.

    Raises
    ------
    ScenarioError
        If there is none.
    """
    return find_file(name_or_path, folders_named("gains"), "gains")


def with_gains_of(document: Document, path: Path) -> Document:
    """Put the gains of a file into all schemes of a scenario.

    Raises
    ------
    ScenarioError
        If the file is wrong, is for another vehicle or other sensors, or fits no part of any scheme.
    """
    file = read_document(path)
    try:
        gains = GainsShape.model_validate(file.data)
    except ValidationError as error:
        raise file.error(problems_of(error, lambda _: GainsShape)) from None
    problems = [
        Problem((key,), f"'{wanted}': {document.source} has '{there}'")
        for key, wanted, there in (
            ("vehicle", gains.vehicle, document.data.get("vehicle")),
            ("grade", gains.grade, grade_of(document)),
        )
        if wanted != there
    ]
    changes = _changes(document, gains)
    if not changes and not problems:
        problems.append(Problem((), f"no scheme of {document.source} has a part of these kinds"))
    if problems:
        raise file.error(problems)
    for place, part in changes.items():
        document = document.replaced(place, part, f"gains {path}")
    return document


def _changes(document: Document, gains: GainsShape) -> dict[Keys, dict[str, Any]]:
    found: dict[Keys, dict[str, Any]] = {}
    schemes: Any = document.data.get("schemes")
    for name, scheme in cast("dict[str, Any]", schemes if isinstance(schemes, dict) else {}).items():
        for role in ROLES:
            part: PartGains | None = getattr(gains, role)
            raw: Any = cast("dict[str, Any]", scheme).get(role) if isinstance(scheme, dict) else None
            given = cast("dict[str, Any]", raw if isinstance(raw, dict) else {"kind": raw})
            if part is not None and given.get("kind") == part.kind:
                found["schemes", name, role] = {**given, **(part.model_extra or {})}
    return found


def grade_of(document: Document) -> str:
    """The grade of the sensors, as the scenario names it."""
    sensors: Any = document.data.get("sensors")
    return (
        str(cast("dict[str, Any]", sensors).get("grade", "ideal")) if isinstance(sensors, dict) else "ideal"
    )
