"""YAML with the line of every key, so that an error can say where; and overrides of single values.

The document is YAML 1.2, restricted to what a configuration needs: mappings with text keys, lists, texts,
numbers, booleans. A key that comes twice is an error.
"""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ruamel.yaml import YAML, YAMLError, nodes

from quadftc_model.hints import nearest

Node = Any  # a node of ruamel.yaml, which has no complete types
Keys = tuple[str | int, ...]  # where a value is: keys and indices from the root

ROLES = ("observer", "disturbance_observer", "controller")  # keys of a scheme that may hold a name only
MAX_SHOWN = 10  # problems in one report
_MAX_VALUES = 20_000  # values in one document; aliases of aliases grow without bound
_MAX_DEPTH = 20


class ScenarioError(ValueError):
    """A scenario that cannot be used; one line of text for each problem, with file, line and key."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """What is wrong, and where."""

    path: Keys
    text: str


@dataclasses.dataclass(frozen=True)
class Document:
    """The contents of a file and where they come from.

    Parameters
    ----------
    source : str
        The file as the user named it.
    text : str
        Its contents.
    data : mapping
        Plain dicts, lists and scalars.
    origins : dict
        For each value its line (from 1), or the override that gave it.
    """

    source: str
    text: str
    data: dict[str, Any]
    origins: dict[Keys, int | str]

    def error(self, problems: Iterable[Problem]) -> ScenarioError:
        """Return the error that reports these problems, in the order of the file."""
        ordered = sorted(dict.fromkeys(problems), key=lambda problem: self._line(problem.path))
        lines = [self._report(problem) for problem in ordered[:MAX_SHOWN]]
        if len(ordered) > MAX_SHOWN:
            lines.append(f"{self.source}: and {len(ordered) - MAX_SHOWN} more")
        return ScenarioError("\n".join(lines))

    def replaced(self, path: Keys, value: Any, origin: str) -> Document:
        """Return the document with one value replaced, or added to a mapping; ``origin`` says by what."""
        data = copy.deepcopy(self.data)
        origins = {known: line for known, line in self.origins.items() if known[: len(path)] != path}
        place: Any = data
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        origins[path] = origin
        return Document(self.source, self.text, data, origins)

    def _origin(self, path: Keys) -> int | str:
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path, 1)

    def _line(self, path: Keys) -> int:
        origin = self._origin(path)
        return origin if isinstance(origin, int) else 0

    def _report(self, problem: Problem) -> str:
        origin = self._origin(problem.path)
        where = f"{self.source}:{origin}" if isinstance(origin, int) else f"{self.source}: {origin}"
        text = _one_line(problem.text)
        return f"{where}: {dotted(problem.path)}: {text}" if problem.path else f"{where}: {text}"


def dotted(path: Keys) -> str:
    """Write a path as people read it: ``faults[0].value``."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
    return text.removeprefix(".")


def read_document(path: Path) -> Document:
    """Read a YAML file.

    Raises
    ------
    ScenarioError
        If it cannot be read, is no YAML, or is no mapping.
    """
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    return parse_document(text, str(path))


def parse_document(text: str, source: str) -> Document:
    """Parse YAML text; ``source`` is named in errors.

    Raises
    ------
    ScenarioError
        If it is no YAML, or no mapping.
    """
    reader = _Reader(source)
    node = reader.compose(text)
    if node is None:
        raise ScenarioError(f"{source}:1: empty; expected a scenario")
    if not _is(node, nodes.MappingNode):
        raise ScenarioError(f"{source}:{_line(node)}: expected a mapping of keys such as 'duration: 80 s'")
    data = reader.value(node, ())
    document = Document(source, text, data, reader.origins)
    if reader.problems:
        raise document.error(reader.problems)
    return document


def parse_value(text: str, source: str) -> Any:
    """Parse the YAML text of one value.

    Raises
    ------
    ScenarioError
        If it is no YAML.
    """
    reader = _Reader(source)
    node = reader.compose(text)
    value = None if node is None else reader.value(node, ())
    if reader.problems:
        raise ScenarioError(f"{source}: {reader.problems[0].text}")
    return value


class _Reader:
    """Turns the nodes of one document into plain values, and notes lines and problems."""

    def __init__(self, source: str) -> None:
        self.origins: dict[Keys, int | str] = {}
        self.problems: list[Problem] = []
        self._source = source
        self._yaml: Any = YAML(typ="safe", pure=True)
        self._count = 0

    def compose(self, text: str) -> Node | None:
        try:
            return self._yaml.compose(text)
        except YAMLError as error:
            mark: Any = getattr(error, "problem_mark", None)
            position = int(getattr(error, "position", None) or 0)
            line = mark.line if mark is not None else text[:position].count("\n")
            reason = (
                getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
            )
            raise ScenarioError(f"{self._source}:{line + 1}: not YAML: {_one_line(str(reason))}") from None
        except (RecursionError, ValueError, AssertionError, AttributeError, TypeError, IndexError) as error:
            raise ScenarioError(
                f"{self._source}:1: not YAML: it cannot be parsed ({type(error).__name__})"
            ) from None

    def value(self, node: Node, path: Keys) -> Any:
        self.origins.setdefault(path, _line(node))
        self._count += 1
        if self._count > _MAX_VALUES or len(path) > _MAX_DEPTH:
            if self._count <= _MAX_VALUES + 1:
                self._problem(path, "too large or too deep for a scenario")
                self._count = _MAX_VALUES + 1
            return None
        if _is(node, nodes.MappingNode):
            return self._mapping(node, path)
        if _is(node, nodes.SequenceNode):
            return [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
        return self._scalar(node, path)

    def _mapping(self, node: Node, path: Keys) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value) if _is(key_node, nodes.ScalarNode) else None
            if key is None or key_node.tag == "tag:yaml.org,2002:merge":
                self._problem((*path, "<<" if key else "?"), "a key must be a text", key_node)
                continue
            inner = (*path, key)
            if key in values:
                self._problem(inner, f"given twice, first in line {self.origins[inner]}", key_node)
                continue
            self.origins[inner] = _line(key_node)
            values[key] = self.value(value_node, inner)
        return values

    def _scalar(self, node: Node, path: Keys) -> Any:
        kind = str(node.tag).rpartition(":")[2]
        if kind in ("str", "timestamp"):
            return str(node.value)
        if kind not in ("null", "bool", "int", "float"):
            self._problem(path, f"'{node.tag}' is no type of value that a scenario knows")
            return None
        try:
            value: Any = self._yaml.constructor.construct_object(node)
            if isinstance(value, int):
                float(value)  # a number too large for arithmetic is none
        except (YAMLError, ValueError, OverflowError, KeyError, IndexError):
            self._problem(path, f"{str(node.value)[:40]!r}: expected a number")
            return None
        return value

    def _problem(self, path: Keys, text: str, node: Node | None = None) -> None:
        if node is not None:
            self.origins[path] = _line(node)
        self.problems.append(Problem(path, text))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _is(node: Node, kind: type) -> bool:
    return isinstance(node, kind)


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1


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
    elif isinstance(inside, str) and key in ROLES:
        inside = {"kind": inside}
    place[key] = inside
    return inside
