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
from typing import Any, NamedTuple, cast

from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError

from quadftc_model.hints import nearest
from quadftc_model.small_files import read_small

Node = Any  # a node of ruamel.yaml, which has no complete types
Keys = tuple[str | int, ...]  # where a value is: keys and indices from the root
Change = tuple[Sequence[str | int], object, str, str]  # path, new value, what gives it, how an error begins

ROLES = ("observer", "disturbance_observer", "controller")  # keys of a scheme that may hold a name only
OVERRIDE = "override"  # begins the origin of what an assignment gives
MAX_SHOWN = 10  # problems in one report
KINDS = {  # of files: the command that flies them, and keys that only they have
    "scenario": ("run", ("duration", "vehicle")),
    "campaign": ("campaign", ("scenario", "flights")),
}
_MAX_VALUES = 20_000  # values in one document; aliases of aliases grow without bound
_MAX_DEPTH = 20
TOO_LARGE = "too large or too deep for a scenario"


class ScenarioError(ValueError):
    """A scenario that cannot be used; one line of text for each problem, with file, line and key."""


class Problem(NamedTuple):
    """What is wrong, and where."""

    path: Keys
    text: str


@dataclasses.dataclass(frozen=True)
class Document:
    """The contents of a file and where they come from."""

    source: str  # the file as the user named it
    text: str  # its contents
    data: dict[str, Any]  # plain dicts, lists and scalars
    origins: dict[Keys, int | str]  # for each value its line (from 1), or the override that gave it

    def error(self, problems: Iterable[Problem]) -> ScenarioError:
        """Return the error that reports these problems, in the order of the file."""
        found = [(self._origin(problem.path), problem) for problem in dict.fromkeys(problems)]
        found.sort(key=lambda pair: pair[0] if isinstance(pair[0], int) else 0)
        lines = [self._report(*pair) for pair in found[:MAX_SHOWN]]
        if len(found) > MAX_SHOWN:
            lines.append(f"{self.source}: and {len(found) - MAX_SHOWN} more")
        return ScenarioError("\n".join(lines))

    def replaced(self, changes: Mapping[Keys, object], origin: str) -> Document:
        """Return the document with values replaced, or added to mappings; ``origin`` says by what."""
        where = f"{self.source}: {origin}"
        return self._changed((path, value, origin, where) for path, value in changes.items())

    def overridden(self, assignments: Iterable[str]) -> Document:
        """Apply overrides ``path=value``: the path dotted, with indices for lists; the value in YAML.

        A key that a mapping lacks is added. A path that leads nowhere is a ScenarioError.
        """
        return self._changed(self._parse_override(assignment) for assignment in assignments)

    def with_values(self, values: Mapping[str, object], origin: str) -> Document:
        """Put values in place of others by dotted path, as `overridden` does; ``origin`` is for messages."""
        where = f"{self.source}: {origin}"
        return self._changed(
            (_words(target), copy.deepcopy(value), f"{origin}, {target} = {value}", where)
            for target, value in values.items()
        )

    def is_overridden(self, path: Keys) -> bool:
        """Whether a value comes from an assignment, not from the file or a campaign."""
        origin = self._origin(path)
        return isinstance(origin, str) and origin.startswith(OVERRIDE)

    def _parse_override(self, assignment: str) -> Change:
        origin = f"{OVERRIDE} {assignment!r}"
        where = f"{self.source}: {origin}"
        target, equals, text = assignment.partition("=")
        words = _words(target)
        if not equals or not all(words):
            raise ScenarioError(f"{where}: expected path=value, such as 'faults.0.value=2 deg'")
        return words, parse_value(text, where), origin, where

    def _changed(self, changes: Iterable[Change]) -> Document:
        """Put values in their places, through mappings that are made where they are missing."""
        changed = Document(self.source, self.text, copy.deepcopy(self.data), dict(self.origins))
        origins = changed.origins
        for words, value, origin, where in changes:
            place: Any = changed.data
            path: Keys = ()
            for word in words:
                if not isinstance(place, (dict, list)):
                    raise ScenarioError(f"{where}: {_dotted(path)} is a single value; it has no '{word}'")
                key = _key(place, word, path, where)  # pyright: ignore[reportUnknownArgumentType]
                path = (*path, key)
                if len(path) < len(words):
                    origins.setdefault(path, origin)
                    place = _enter(place, key)
            for known in [known for known in origins if known[: len(path)] == path]:
                del origins[known]
            cast("Any", place)[path[-1]] = value  # pyright: ignore[reportGeneralTypeIssues]
            origins[path] = origin
        return changed

    def _origin(self, path: Keys) -> int | str:
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path, 1)

    def _report(self, origin: int | str, problem: Problem) -> str:
        where = f"{self.source}:{origin}" if isinstance(origin, int) else f"{self.source}: {origin}"
        return ": ".join(filter(None, (where, _dotted(problem.path), _one_line(problem.text))))


def _words(target: str) -> list[str]:
    return re.sub(r"\[(\d+)\]", r".\1", target).strip().split(".")


def _dotted(path: Keys) -> str:
    """Write a path as people read it: ``faults[0].value``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).removeprefix(".")


def _key(place: dict[str, Any] | list[Any], word: str | int, path: Keys, where: str) -> str | int:
    if isinstance(place, list):
        if not str(word).isdecimal() or int(word) >= len(place):
            there = f"0 to {len(place) - 1}" if place else "none, the list is empty"
            raise ScenarioError(f"{where}: no '{word}' in {_dotted(path)}; there are: {there}")
        return int(word)
    if path == ("schemes",) and word not in place:
        hint = nearest(str(word), place)
        raise ScenarioError(f"{where}: no scheme '{word}'{hint}; there are: {', '.join(place)}")
    return word


def _enter(place: Any, key: str | int) -> Any:
    """Return what is in a place; where there is nothing yet, a new mapping."""
    inside: Any = cast("dict[Any, Any]", place).get(key) if isinstance(place, dict) else place[key]
    if inside is None or (isinstance(inside, str) and key in ROLES):
        inside = place[key] = {} if inside is None else {"kind": inside}
    return inside


def read_document(path: Path) -> Document:
    """Read a YAML file; one that cannot be read, or holds no mapping, is a ScenarioError."""
    if path.suffix == ".toml":
        raise ScenarioError(f"{path}: the file of a vehicle; judge it by: quadftc check {path}")
    try:
        text = read_small(path)
    except (OSError, ValueError) as error:  # a file that is no UTF-8 text among them
        raise ScenarioError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    return parse_document(text, str(path))


def refuse_kind(document: Document, kind: str) -> None:
    """Raise a ScenarioError if a document is of a kind, "scenario" or "campaign", and not of the other."""
    keys, command, needed = document.data, *KINDS[kind]
    if all(key in keys for key in needed):
        raise ScenarioError(f"{document.source}: a {kind}; fly it by: quadftc {command} {document.source}")


def parse_document(text: str, source: str) -> Document:
    """Parse YAML text as `read_document` does; ``source`` is named in errors."""
    reader = _Reader(source)
    node = reader.compose(text)
    if node is None:
        raise ScenarioError(f"{source}:1: empty; expected a mapping of keys")
    if node.id != "mapping":
        raise ScenarioError(f"{source}:{_line(node)}: expected a mapping of keys such as 'duration: 80 s'")
    document = Document(source, text, reader.value(node, ()), reader.origins)
    if reader.problems:
        raise document.error(reader.problems)
    return document


def parse_value(text: str, source: str) -> object:
    """Parse the YAML text of one value; ``source`` is named in errors."""
    reader = _Reader(source)
    node = reader.compose(text)
    value = None if node is None else reader.value(node, ())
    if reader.problems:
        raise ScenarioError(f"{source}: {reader.problems[0].text}")
    return value


class _BoundedComposer(Composer):
    """Ends at the first value that is too many or too deep, before the rest of the text is looked at."""

    depth = count = 0

    def compose_node(self, parent: Node, index: object) -> Node:
        """Compose a node and what is in it."""
        untyped: Any = super()
        self.count, self.depth = self.count + 1, self.depth + 1
        if self.count > 2 * _MAX_VALUES or self.depth > _MAX_DEPTH + 2:  # keys are nodes, too, and the root
            raise MarkedYAMLError(problem=TOO_LARGE, problem_mark=untyped.parser.peek_event().start_mark)
        node = untyped.compose_node(parent, index)
        self.depth -= 1
        return node


class _Reader:
    """Turns the nodes of one document into plain values, and notes lines and problems."""

    def __init__(self, source: str) -> None:
        self.origins: dict[Keys, int | str] = {}
        self.problems: list[Problem] = []
        self._source = source
        self._yaml: Any = YAML(typ="safe", pure=True)
        self._yaml.Composer = _BoundedComposer
        self._count = 0

    def compose(self, text: str) -> Node | None:
        try:
            return self._yaml.compose(text)
        except YAMLError as error:
            mark: Any = getattr(error, "problem_mark", None)
            position = int(getattr(error, "position", None) or 0)
            line = mark.line if mark is not None else text[:position].count("\n")
            reason = getattr(error, "problem", None) or getattr(error, "reason", None)
            words = _one_line(str(reason or "it cannot be parsed"))
            raise ScenarioError(f"{self._source}:{line + 1}: not YAML: {words}") from None
        except (RecursionError, ValueError, AssertionError, AttributeError, TypeError, IndexError) as error:
            kind = type(error).__name__
            raise ScenarioError(f"{self._source}:1: not YAML: it cannot be parsed ({kind})") from None

    def value(self, node: Node, path: Keys) -> Any:
        self.origins.setdefault(path, _line(node))
        self._count += 1
        if self._count > _MAX_VALUES or len(path) > _MAX_DEPTH:
            if self._count <= _MAX_VALUES + 1:  # once; then no value is read any more
                self.problems.append(Problem(path, TOO_LARGE))
                self._count = _MAX_VALUES + 1
            return None
        if node.id == "mapping":
            return self._mapping(node, path)
        if node.id == "sequence":
            return [self.value(item, (*path, index)) for index, item in enumerate(node.value)]
        return self._scalar(node, path)

    def _mapping(self, node: Node, path: Keys) -> dict[str, object]:
        values: dict[str, object] = {}
        for key_node, value_node in node.value:
            is_text = key_node.id == "scalar"
            key = str(key_node.value) if is_text else "?"
            inner, wrong = (*path, key), "a key must be a text"
            if is_text and key_node.tag != "tag:yaml.org,2002:merge":
                wrong = f"given twice, first in line {self.origins[inner]}" if key in values else ""
            self.origins[inner] = _line(key_node)
            if wrong:
                self.problems.append(Problem(inner, wrong))
            else:
                values[key] = self.value(value_node, inner)
        return values

    def _scalar(self, node: Node, path: Keys) -> object:
        kind = str(node.tag).rpartition(":")[2]
        if kind in ("str", "timestamp"):
            return str(node.value)
        wrong = f"'{node.tag}' is no type of value that a scenario knows"
        if kind in ("null", "bool", "int", "float"):
            try:
                value: object = self._yaml.constructor.construct_object(node)
                if isinstance(value, int):
                    float(value)  # refuses an integer beyond all floats
                return value
            except (YAMLError, ValueError, OverflowError, KeyError, IndexError):
                wrong = f"{str(node.value)[:40]!r}: expected a number"
        self.problems.append(Problem(path, wrong))
        return None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1
