"""Overrides of single values of a scenario: ``seed=3``, ``schemes.proposed.observer.delta=0.002``."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

from quadftc_flight.scenario.yaml_document import Document, Keys, ScenarioError, dotted, parse_value
from quadftc_model.hints import nearest

_COMPONENTS = ("observer", "disturbance_observer", "controller")  # keys that may hold a name only


def overridden(document: Document, assignments: Iterable[str]) -> Document:
    """Apply overrides, one after the other.

    Parameters
    ----------
    document : Document
    assignments : iterable of str
        ``path=value``: the path dotted, with indices for lists; the value in YAML. A key that a mapping lacks
        is added.

    Raises
    ------
    ScenarioError
        If an assignment has another form, or its path leads nowhere; the message names what there is.
    """
    for assignment in assignments:
        document = _assign(document, assignment)
    return document


def with_values(document: Document, values: Mapping[str, Any], origin: str) -> Document:
    """Put values in place of others, all at once: `overridden` for values that have been read.

    Parameters
    ----------
    document : Document
    values : mapping
        By dotted path.
    origin : str
        Where they come from, for messages.

    Raises
    ------
    ScenarioError
        If a path leads nowhere; the message names what there is.
    """
    data, origins = copy.deepcopy(document.data), dict(document.origins)
    for target, value in values.items():
        path, place = _entered_all(data, _words(target), f"{document.source}: {origin}")
        place[path[-1]] = copy.deepcopy(value)
        origins[path] = f"{origin}, {target} = {value}"
    return Document(document.source, document.text, data, origins)


def _words(target: str) -> list[str]:
    return re.sub(r"\[(\d+)\]", r".\1", target).strip().split(".")


def _assign(document: Document, assignment: str) -> Document:
    origin = f"override {assignment!r}"
    target, equals, text = assignment.partition("=")
    words = _words(target)
    if not equals or not all(words):
        raise ScenarioError(
            f"{document.source}: {origin}: expected path=value, such as 'faults.0.value=2 deg'"
        )
    value = parse_value(text, f"{document.source}: {origin}")
    path, grown = _grown(document.data, words, f"{document.source}: {origin}")
    made = {path[:depth]: origin for depth in range(1, len(path))}  # mappings that had to be made on the way
    origins = {**made, **document.origins}
    return Document(document.source, document.text, grown, origins).replaced(path, value, origin)


def _grown(data: dict[str, Any], words: Sequence[str], where: str) -> tuple[Keys, dict[str, Any]]:
    """Return the path that the words name, and the data with every mapping on that path."""
    data = copy.deepcopy(data)
    return _entered_all(data, words, where)[0], data


def _entered_all(data: dict[str, Any], words: Sequence[str], where: str) -> tuple[Keys, Any]:
    """Return the path that the words name, and what its last word is in, made where it was not there."""
    place: Any = data
    path: Keys = ()
    for word in words:
        if not isinstance(place, (dict, list)):
            raise ScenarioError(f"{where}: {dotted(path)} is a single value; it has no '{word}'")
        path = (*path, _key(place, word, path, where))  # pyright: ignore[reportUnknownArgumentType]
        if len(path) < len(words):
            place = _entered(place, path)
    return path, cast("Any", place)


def _key(place: dict[str, Any] | list[Any], word: str, path: Keys, where: str) -> str | int:
    if isinstance(place, list):
        if not word.isdecimal() or int(word) >= len(place):
            there = f"0 to {len(place) - 1}" if place else "none, the list is empty"
            raise ScenarioError(f"{where}: no '{word}' in {dotted(path)}; there are: {there}")
        return int(word)
    if path == ("schemes",) and word not in place:
        hint = nearest(word, place)
        raise ScenarioError(f"{where}: no scheme '{word}'{hint}; there are: {', '.join(place)}")
    return word


def _entered(place: Any, path: Keys) -> Any:
    """What is at ``path``, in ``place``; where there is nothing yet, a new mapping."""
    key = path[-1]
    inside: Any = cast("dict[Any, Any]", place).get(key) if isinstance(place, dict) else place[key]
    if inside is None:
        inside = {}
    elif isinstance(inside, str) and key in _COMPONENTS:
        inside = {"kind": inside}
    place[key] = inside
    return inside
