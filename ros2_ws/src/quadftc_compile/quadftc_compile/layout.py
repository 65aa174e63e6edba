"""How nested tuples of arrays lie in memory: as structs of C, whose members have the names of the fields.

A layout is described in plain data, so that it can be kept beside a library and read without JAX:

    ["array", "f8", [3]]                          an array: type of NumPy, shape
    ["none"]                                      what is absent by structure
    ["tuple", "module:Name", [[field, layout]]]   a NamedTuple; without a name, a plain tuple
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import io
import json
import math
import re
import tokenize
from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import numpy as np

from quadftc_model.arrays import Array

Layout = list[Any]  # as described above
C_TYPES = {"f8": "double", "f4": "float", "b1": "bool"} | {
    f"{kind}{size}": f"{word}{8 * size}_t"
    for kind, word in (("i", "int"), ("u", "uint"))
    for size in (1, 2, 4, 8)
}


@dataclasses.dataclass(frozen=True)
class Leaf:
    """One array of a layout."""

    path: tuple[str, ...]  # of fields
    dtype: np.dtype
    shape: tuple[int, ...]
    offset: int  # bytes from the start of the struct

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)


def layout_of(tree: object) -> Layout:
    """Return the layout of nested tuples of arrays, numbers and None."""
    if tree is None:
        return ["none"]
    if isinstance(tree, tuple):
        parts = cast("tuple[object, ...]", tree)
        names: Sequence[str] | None = getattr(parts, "_fields", None)
        kind = f"{type(parts).__module__}:{type(parts).__qualname__}" if names else ""
        fields = names or [f"part{k}" for k in range(len(parts))]
        return ["tuple", kind, [[name, layout_of(each)] for name, each in zip(fields, parts, strict=True)]]
    shape, dtype = getattr(tree, "shape", None), getattr(tree, "dtype", None)
    if shape is None or dtype is None:
        array = np.asarray(tree)
        shape, dtype = array.shape, array.dtype
    code = np.dtype(dtype).str[1:]
    if code not in C_TYPES:
        raise ValueError(f"{tree!r}: expected arrays of numbers or flags, not of type {dtype}")
    return ["array", code, [int(n) for n in shape]]


def with_real(layout: Layout, real: str) -> Layout:
    """Return a layout with floats of a type, "f8" or "f4"."""
    if layout[0] == "array":
        return ["array", real if layout[1][0] == "f" else layout[1], layout[2]]
    if layout[0] == "none":
        return layout
    return ["tuple", layout[1], [[name, with_real(each, real)] for name, each in layout[2]]]


def numpy_type(layout: Layout) -> np.dtype:
    """Return the type of NumPy that lies in memory as the struct of a layout."""
    if layout[0] == "array":
        return np.dtype((np.dtype(layout[1]), tuple(layout[2])))
    members = [(name, numpy_type(each)) for name, each in layout[2] if _has_numbers(each)]
    return np.dtype(members or [("nothing", "u1")], align=True)


def leaves_of(layout: Layout) -> list[Leaf]:
    """Return the arrays of a layout, in order."""
    return list(_leaves(layout, numpy_type(layout), (), 0))


def _leaves(layout: Layout, dtype: Any, path: tuple[str, ...], offset: int) -> Iterator[Leaf]:
    if not _has_numbers(layout):
        return
    if layout[0] == "array":
        yield Leaf(path, np.dtype(layout[1]), tuple(layout[2]), offset)
        return
    for name, inside in layout[2]:
        if _has_numbers(inside):
            member, at = dtype.fields[name][:2]
            yield from _leaves(inside, member, (*path, name), offset + at)


def _has_numbers(layout: Layout) -> bool:
    if layout[0] == "array":
        return math.prod(layout[2]) > 0
    return layout[0] == "tuple" and (not layout[2] or any(_has_numbers(each) for _, each in layout[2]))


def flatten(layout: Layout, tree: object, shapes: bool = True) -> list[Array]:
    """Return the arrays of nested tuples in the order of :func:`leaves_of`; ValueError if they do not fit.

    Without ``shapes`` arrays may have others.
    """
    return list(_flat(layout, tree, "", shapes))


def _flat(layout: Layout, tree: Any, path: str, shapes: bool) -> Iterator[Array]:
    if layout[0] == "none":
        if tree is not None:
            raise ValueError(f"{path or 'value'}: expected None, not {type(tree).__name__}")
    elif layout[0] == "array":
        if math.prod(layout[2]):
            if shapes and np.shape(tree) != tuple(layout[2]):
                raise ValueError(
                    f"{path or 'value'}: expected shape {tuple(layout[2])}, not {np.shape(tree)}"
                )
            yield tree
    else:
        fields = layout[2]
        if not isinstance(tree, tuple) or len(cast("tuple[object, ...]", tree)) != len(fields):
            found = type(cast("Any", tree)).__name__
            raise ValueError(f"{path or 'value'}: expected a tuple of {len(fields)}, not {found}")
        for (name, inside), each in zip(fields, cast("tuple[object, ...]", tree), strict=True):
            yield from _flat(inside, each, f"{path}.{name}" if path else name, shapes)


def unflatten(layout: Layout, leaves: Iterator[object]) -> Any:
    """Return the nested tuples of arrays in the order of :func:`leaves_of`."""
    if layout[0] == "none":
        return None
    if layout[0] == "array":
        return next(leaves) if math.prod(layout[2]) else np.zeros(layout[2], layout[1])
    parts = [unflatten(each, leaves) for _, each in layout[2]]
    return kind_of(layout[1])(*parts) if layout[1] else tuple(parts)


@functools.cache
def kind_of(name: str) -> type[Any]:
    """Return the NamedTuple of a name "module:Name"; ValueError if it is not there any more."""
    module, _, qualified = name.partition(":")
    try:
        return functools.reduce(getattr, qualified.split("."), cast("Any", importlib.import_module(module)))
    except (ImportError, AttributeError) as error:
        raise ValueError(f"{name}: no such type") from error


# words of C99 and C++20 that Python takes for names
RESERVED = re.compile(
    "auto|bool|case|catch|char|const|constexpr|default|delete|do|double|enum|explicit|export|extern|false|float|"
    "friend|goto|inline|int|long|mutable|namespace|new|operator|private|protected|public|register|restrict|"
    "short|signed|sizeof|static|struct|switch|template|this|throw|true|typedef|typename|union|unsigned|using|"
    "virtual|void|volatile"
)


# -- C --------------------------------------------------------------------------------------------


class Structs:
    """The structs of a program in C: one for each kind of NamedTuple and layout."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self.names: dict[str, str] = {}  # by layout, as JSON
        self._taken: set[str] = set()
        self.definitions: list[str] = []

    def name_of(self, layout: Layout, wanted: str, comments: Callable[[str], str] | None = None) -> str:
        """Return the name of a layout's struct; define it if it is new.

        ``wanted`` is the name of what has none; ``comments`` says what its members are.
        """
        key = json.dumps(layout)
        if key not in self.names:
            name = _unused(
                f"{self._prefix}_{snake_case(layout[1].split(':')[-1]) if layout[1] else wanted}", self._taken
            )
            self.names[key] = name
            self.definitions.append(self._define(layout, name, comments))
        return self.names[key]

    def _define(self, layout: Layout, name: str, comments: Callable[[str], str] | None) -> str:
        told = field_comments(kind_of(layout[1])) if layout[1] else {}
        lines: list[str] = []
        for field, inside in layout[2]:
            if not _has_numbers(inside):
                continue
            words = comments(field) if comments else told.get(field, "")
            if inside[0] == "array":
                kind, shape = C_TYPES[inside[1]], tuple(inside[2])
                member = f"{kind} {c_name(field)}{f'[{math.prod(shape)}]' if shape else ''};"
                if len(shape) > 1:
                    words = f"{shape} {words}".strip()
            else:
                inner = self.name_of(inside, f"{name.removeprefix(self._prefix)[1:]}_{field}")
                member = f"{inner} {c_name(field)};"
            lines.append(f"    {member}{f'  /* {words} */' if words else ''}")
        lines = lines or ["    uint8_t nothing;"]
        summary = _summary(kind_of(layout[1])) if layout[1] else ""
        head = f"/* {summary} */\n" if summary else ""
        return head + "typedef struct {\n" + "\n".join(lines) + f"\n}} {name};\n"


def member(path: Sequence[str]) -> str:
    """Return the text of a member of a struct."""
    return ".".join(map(c_name, path))


def c_name(field: str) -> str:
    """Return a name that C and C++ take for a member: theirs get an underscore."""
    return f"{field}_" if RESERVED.fullmatch(field) else field


def _unused(name: str, taken: set[str]) -> str:
    unique, number = name, 2
    while unique in taken:
        unique, number = f"{name}_{number}", number + 1
    taken.add(unique)
    return unique


def snake_case(name: str) -> str:
    """Return the last part of the name of a class as names are written in C."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.rsplit(".", maxsplit=1)[-1]).lower()


@functools.cache
def field_comments(kind: type) -> dict[str, str]:
    """Return what the comments behind the fields of a class say of them: units, meanings."""
    try:
        source = inspect.getsource(kind)
    except (OSError, TypeError):
        return {}
    found: dict[str, str] = {}
    field = ""
    for token in tokenize.generate_tokens(io.StringIO(inspect.cleandoc(source)).readline):
        if (
            token.type == tokenize.NAME
            and re.match(rf"\s*{token.string}\s*:", token.line)
            and token.start[1] <= 4
        ):
            field = token.string
        elif token.type == tokenize.COMMENT and field and token.line.strip() != token.string:
            found.setdefault(field, _plain(token.string.lstrip("# ")))
    return found


def _summary(kind: type) -> str:
    words = (inspect.getdoc(kind) or "").splitlines()
    return _plain(words[0]) if words and not words[0].startswith(kind.__name__ + "(") else ""


def _plain(text: str) -> str:
    """Return a text that can stand in a comment of C."""
    return text.replace("*/", "* /").strip()
