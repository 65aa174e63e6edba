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

    def replaced(self, path: Keys, value: Any, origin: str) -> Document:
        """Return the document with one value replaced, or added to a mapping; ``origin`` says by what."""
        changed = self._copy()
        changed._put(path, value, origin, f"{self.source}: {origin}")
        return changed

    def overridden(self, assignments: Iterable[str]) -> Document:
        """Apply overrides, one after the other.

        Each is ``path=value``: the path dotted, with indices for lists; the value in YAML. A key that a
        mapping lacks is added. A path that leads nowhere is a ScenarioError that names what there is.
        """
        changed = self._copy()
        for assignment in assignments:
            origin = f"override {assignment!r}"
            where = f"{self.source}: {origin}"
            target, equals, text = assignment.partition("=")
            words = _words(target)
            if not equals or not all(words):
                raise ScenarioError(f"{where}: expected path=value, such as 'faults.0.value=2 deg'")
            changed._put(words, parse_value(text, where), origin, where)
        return changed

    def with_values(self, values: Mapping[str, Any], origin: str) -> Document:
        """Put values in place of others by dotted path, as `overridden` does; ``origin`` is for messages."""
        changed = self._copy()
        for target, value in values.items():
            because, where = f"{origin}, {target} = {value}", f"{self.source}: {origin}"
            changed._put(_words(target), copy.deepcopy(value), because, where)
        return changed

    def _copy(self) -> Document:
        return Document(self.source, self.text, copy.deepcopy(self.data), dict(self.origins))

    def _put(self, words: Sequence[str | int], value: Any, origin: str, where: str) -> None:
        """Put a value in its place, through mappings that are made where they are missing."""
        place: Any = self.data
        path: Keys = ()
        for word in words:
            if not isinstance(place, (dict, list)):
                raise ScenarioError(f"{where}: {_dotted(path)} is a single value; it has no '{word}'")
            key = _key(place, word, path, where)  # pyright: ignore[reportUnknownArgumentType]
            path = (*path, key)
            if len(path) < len(words):
                self.origins.setdefault(path, origin)
                place = _enter(place, key)
        for known in [known for known in self.origins if known[: len(path)] == path]:
            del self.origins[known]
        cast("Any", place)[path[-1]] = value
        self.origins[path] = origin

    def _origin(self, path: Keys) -> int | str:
        while path and path not in self.origins:
            path = path[:-1]
        return self.origins.get(path, 1)

    def _report(self, origin: int | str, problem: Problem) -> str:
        where = f"{self.source}:{origin}" if isinstance(origin, int) else f"{self.source}: {origin}"
        parts = [where, *([_dotted(problem.path)] if problem.path else []), _one_line(problem.text)]
        return ": ".join(parts)


def _words(target: str) -> list[str]:
    return re.sub(r"\[(\d+)\]", r".\1", target).strip().split(".")


def _dotted(path: Keys) -> str:
    """Write a path as people read it: ``faults[0].value``."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)
    return text.removeprefix(".")


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
        inside = {} if inside is None else {"kind": inside}
        place[key] = inside
    return inside


def read_document(path: Path) -> Document:
    """Read a YAML file; one that cannot be read, or holds no mapping, is a ScenarioError."""
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from None
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    return parse_document(text, str(path))


def parse_document(text: str, source: str) -> Document:
    """Parse YAML text as `read_document` does; ``source`` is named in errors."""
    reader = _Reader(source)
    node = reader.compose(text)
    if node is None:
        raise ScenarioError(f"{source}:1: empty; expected a scenario")
    if not _is(node, nodes.MappingNode):
        raise ScenarioError(f"{source}:{_line(node)}: expected a mapping of keys such as 'duration: 80 s'")
    document = Document(source, text, reader.value(node, ()), reader.origins)
    if reader.problems:
        raise document.error(reader.problems)
    return document


def parse_value(text: str, source: str) -> Any:
    """Parse the YAML text of one value; ``source`` is named in errors."""
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
            if self._count <= _MAX_VALUES + 1:
                self.problems.append(Problem(path, "too large or too deep for a scenario"))
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
                inner, wrong = (*path, "<<" if key else "?"), "a key must be a text"
            else:
                inner = (*path, key)
                wrong = f"given twice, first in line {self.origins[inner]}" if key in values else ""
            self.origins[inner] = _line(key_node)
            if wrong:
                self.problems.append(Problem(inner, wrong))
            else:
                values[str(key)] = self.value(value_node, inner)
        return values

    def _scalar(self, node: Node, path: Keys) -> Any:
        kind = str(node.tag).rpartition(":")[2]
        if kind in ("str", "timestamp"):
            return str(node.value)
        wrong = f"'{node.tag}' is no type of value that a scenario knows"
        if kind in ("null", "bool", "int", "float"):
            try:
                value: Any = self._yaml.constructor.construct_object(node)
                if isinstance(value, int):
                    float(value)  # refuses an integer beyond all floats
                return value
            except (YAMLError, ValueError, OverflowError, KeyError, IndexError):
                wrong = f"{str(node.value)[:40]!r}: expected a number"
        self.problems.append(Problem(path, wrong))
        return None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _is(node: Node, kind: type) -> bool:
    return isinstance(node, kind)


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1
