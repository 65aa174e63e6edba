"""The layout of serialised ROS 2 messages (CDR): the one place that knows alignment and length words.

A message type is a list of leaves, the fields that hold something. A walk over one serialised message finds
the place of each leaf, the gaps between them (padding), and the length words of strings and sequences.
Messages of a type with equal length words have the same layout.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from quadftc_bags.interfaces import load_message_class

ORIGIN = 4  # bytes of encapsulation before the message; alignment counts from behind them
PLAIN = (b"\x00\x00", b"\x00\x01")  # encapsulation of plain CDR, big and little endian
STAMP, FRAME_LENGTH, FRAME = (
    4,
    12,
    16,
)  # of a header at the start of a message

Kind = Literal["number", "time", "vector", "string", "object"]

_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_DTYPES = {
    **dict.fromkeys(("bool", "boolean"), "?"),
    **dict.fromkeys(("byte", "char", "octet"), "u1"),
    **dict.fromkeys(("float32", "float"), "f4"),
    **dict.fromkeys(("float64", "double"), "f8"),
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
}
_FIELD_TYPE = re.compile(r"(sequence<)?([\w/]+)(?:<\d+>)?(?:(?:, \d+)?>)?(?:\[(\d+)\])?")


class Field(NamedTuple):
    """A field of a message type; ``base`` is a number, ``string`` or ``package/msg/Name``.

    ``length`` is None for one element, -1 for a sequence, else the length of the array.
    """

    name: str
    base: str
    length: int | None


class Leaf(NamedTuple):
    """A field, or a field of a nested message, that becomes one array.

    ``path`` leads to it from the message, ``width`` counts the numbers of one element, ``length`` is that of
    `Field`. An ``object`` has the leaves of one element as ``parts``; None: its layout is not known.
    """

    name: str
    path: tuple[str, ...]
    kind: Kind
    dtype: str
    width: int
    length: int | None
    parts: tuple[Leaf, ...] | None = None


class Place(NamedTuple):
    """Where the elements of a leaf lie in a message; of a string: its bytes."""

    leaf: Leaf
    offset: int
    number: int


class Layout(NamedTuple):
    """The layout of one message of ``size`` bytes, the last of them that mean something before ``end``.

    ``lengths`` has offset and bytes of each length word, ``gaps`` start and stop of each padding.
    """

    size: int
    end: int
    places: tuple[Place, ...]
    lengths: tuple[tuple[int, bytes], ...]
    gaps: tuple[tuple[int, int], ...]

    def fits(self, data: bytes) -> bool:
        """Return whether another message of the type has this layout."""
        return len(data) == self.size and all(data[at : at + 4] == word for at, word in self.lengths)


def byte_order(data: bytes) -> Literal["<", ">"]:
    """Return the byte order that the encapsulation of a message states."""
    return "<" if data[1] & 1 else ">"


def installed_fields(type_name: str) -> list[Field]:
    """Return the fields of an installed message type.

    Raises ValueError if the type is not installed, or has a field that has no known layout (``wstring``).
    """
    message_class: Any = load_message_class(type_name)
    types: dict[str, str] = message_class.get_fields_and_field_types()
    return [_parse_field(name, text) for name, text in types.items()]


def find_leaves(
    fields_of: Callable[[str], Sequence[Field]],
    type_name: str,
    path: tuple[str, ...] = (),
    prefix: str = "",
) -> tuple[Leaf, ...]:
    """Return the leaves of a message type in their order.

    ``fields_of`` gives the fields of a type; ``path`` and ``prefix`` lead to a nested message.
    """
    leaves: list[Leaf] = []
    for field in fields_of(type_name):
        leaf = _leaf(fields_of, field, (*path, field.name), prefix + field.name)
        is_nested = leaf.kind == "object" and leaf.length is None
        leaves.extend(leaf.parts if is_nested and leaf.parts else [leaf])
    return tuple(leaves)


def find_layout(leaves: Sequence[Leaf], data: bytes) -> Layout | None:
    """Return the layout of one message; None if it does not fit its type, or a field is not known."""
    try:
        walk = _Walk(data)
        walk.pass_message(leaves)
    except (struct.error, IndexError):
        return None
    if walk.position > len(data):
        return None
    return Layout(len(data), walk.position, tuple(walk.places), tuple(walk.lengths), tuple(walk.gaps))


class _Walk:
    """One pass over a serialised message."""

    def __init__(self, data: bytes) -> None:
        self.position = ORIGIN
        self.places: list[Place] = []
        self.lengths: list[tuple[int, bytes]] = []
        self.gaps: list[tuple[int, int]] = []
        self._data = data
        self._word = struct.Struct(f"{byte_order(data)}I")

    def pass_message(self, leaves: Sequence[Leaf] | None) -> None:
        if leaves is None:
            raise IndexError
        if not leaves:
            self.position += 1  # an empty message holds one byte
        for leaf in leaves:
            self._pass_leaf(leaf)

    def _pass_leaf(self, leaf: Leaf) -> None:
        number = 1 if leaf.length is None else leaf.length
        if leaf.length == -1:
            number = self._read_length()
        if leaf.kind == "object":
            for _ in range(number):
                self.pass_message(leaf.parts)
        elif leaf.kind == "string":
            for _ in range(number):
                self._put(leaf, self._read_length(), 1)
        else:
            self._put(leaf, number, np.dtype(leaf.dtype).itemsize)

    def _put(self, leaf: Leaf, number: int, size: int) -> None:
        if number:
            self._align(size)
        self.places.append(Place(leaf, self.position, number))
        self.position += number * leaf.width * size

    def _read_length(self) -> int:
        self._align(4)
        at = self.position
        (number,) = self._word.unpack_from(self._data, at)
        if number > len(self._data):
            raise IndexError
        self.lengths.append((at, self._data[at : at + 4]))
        self.position += 4
        return number

    def _align(self, size: int) -> None:
        gap = (ORIGIN - self.position) % size
        if gap:
            self.gaps.append((self.position, self.position + gap))
            self.position += gap


def _leaf(
    fields_of: Callable[[str], Sequence[Field]], field: Field, path: tuple[str, ...], name: str
) -> Leaf:
    base, length = field.base, field.length
    if base == "string":
        return Leaf(name, path, "string", "u1", 1, length)
    if base in _DTYPES:
        return Leaf(name, path, "number", _DTYPES[base], 1, length)
    if base in _TIMES:
        return Leaf(f"{name}_ns", path, "time", "i4", 2, length)
    if "/" not in base:
        return Leaf(name, path, "object", "", 1, length)
    inner = fields_of(base)
    dtypes = {_DTYPES.get(each.base) if each.length is None else None for each in inner}
    if [each.name for each in inner] in (list("xyz"), list("xyzw")) and dtypes in ({"f4"}, {"f8"}):
        suffix = "_xyzw" if len(inner) == 4 else ""
        return Leaf(name + suffix, path, "vector", dtypes.pop() or "", len(inner), length)
    prefix = "" if base == "std_msgs/msg/Header" and name == "header" else f"{name}."
    return Leaf(name, path, "object", "", 1, length, find_leaves(fields_of, base, path, prefix))


def _parse_field(name: str, text: str) -> Field:
    """Return a field from the name of its type in the generated Python class."""
    match = _FIELD_TYPE.fullmatch(text)
    base = match[2] if match else text
    if match is None or not (base in _DTYPES or base == "string" or "/" in base):
        raise ValueError(f"field '{name}' of type {text}: no known layout")
    length = -1 if match[1] else int(match[3]) if match[3] else None
    return Field(name, base.replace("/", "/msg/"), length)
