"""The layout of serialised ROS 2 messages (CDR): the one place that knows alignment and length words.

A message type is a list of leaves, the fields that hold something. A walk over one serialised message finds
the place of each leaf, the gaps between them (padding), and the length words of strings and sequences.
Messages of a type with equal length words have the same layout.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Literal, NamedTuple

from quadftc_bags.interfaces import installed_fields

ORIGIN = 4  # bytes of encapsulation before the message; alignment counts from behind them
PLAIN = (b"\x00\x00", b"\x00\x01")  # encapsulation of plain CDR, big and little endian
NANOSECONDS = 1_000_000_000  # per second
STAMP, FRAME_LENGTH, FRAME = 4, 12, 16  # offsets in a message that begins with a header

Kind = Literal["number", "time", "vector", "string", "object"]
# of a message type each field: its name, the type of its elements, and their number as in `Leaf`
Fields = Callable[[str], Iterable[tuple[str, str, int | None]]]

_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_CODES = (  # of numbers, the same for `struct` and NumPy
    {"bool": "?", "boolean": "?", "byte": "B", "char": "B", "octet": "B"}
    | {"float32": "f", "float": "f", "float64": "d", "double": "d"}
    | {f"int{8 << power}": code for power, code in enumerate("bhiq")}
    | {f"uint{8 << power}": code for power, code in enumerate("BHIQ")}
)


class Leaf(NamedTuple):
    """A field, or a field of a nested message, that becomes one array."""

    name: str
    path: tuple[str, ...]  # from the message to it
    kind: Kind
    code: str  # type of its numbers
    width: int  # numbers of one element
    length: int | None  # None for one element, -1 for a sequence, else the length of the array
    parts: tuple[Leaf, ...] | None = None  # of an element of an ``object``; None: not known

    @property
    def is_sliced(self) -> bool:
        """Whether it is one slice of every message of a layout."""
        return self.kind != "object" and (self.kind != "string" or self.length is None)


class Place(NamedTuple):
    """Where the elements of a leaf lie in a message; of a string: its bytes."""

    leaf: Leaf
    offset: int
    number: int


class Layout:
    """The layout of one message, found in one pass over it; struct.error or IndexError if it does not fit."""

    def __init__(self, leaves: Sequence[Leaf], data: bytes) -> None:
        self.end = ORIGIN  # where the bytes end that mean something
        self.places: list[Place] = []
        self.lengths: list[tuple[int, bytes]] = []  # offset and bytes of each length word
        self.gaps: list[tuple[int, int]] = []  # start and stop of each padding
        self._data = data
        self._word = struct.Struct(f"{byte_order(data)}I")
        self._pass_message(leaves)
        if self.end > len(data):
            raise IndexError

    def fits(self, data: bytes) -> bool:
        """Return whether another message of the type has this layout."""
        if len(data) != len(self._data):
            return False
        for at, word in self.lengths:  # noqa: SIM110  # many times as fast as `all` with a generator
            if data[at : at + 4] != word:
                return False
        return True

    def _pass_message(self, leaves: Sequence[Leaf] | None) -> None:
        if leaves is None:
            raise IndexError
        if not leaves:
            self.end += 1  # an empty message holds one byte
        for leaf in leaves:
            number = 1 if leaf.length is None else leaf.length
            if leaf.length == -1:
                number = self._read_length()
            if leaf.kind == "object":
                for _ in range(number):
                    self._pass_message(leaf.parts)
            elif leaf.kind == "string":
                for _ in range(number):
                    self._put(leaf, self._read_length(), 1)
            else:
                self._put(leaf, number, item_size(leaf))

    def _put(self, leaf: Leaf, number: int, size: int) -> None:
        if number:
            self._align(size)
        self.places.append(Place(leaf, self.end, number))
        self.end += number * leaf.width * size

    def _read_length(self) -> int:
        self._align(4)
        at = self.end
        (number,) = self._word.unpack_from(self._data, at)
        if number > len(self._data):
            raise IndexError
        self.lengths.append((at, self._data[at : at + 4]))
        self.end += 4
        return number

    def _align(self, size: int) -> None:
        gap = (ORIGIN - self.end) % size
        if gap:
            self.gaps.append((self.end, self.end + gap))
            self.end += gap


class PaddingCleaner:
    """Make messages of one topic depend on their values only: padding is zero, nothing follows the end.

    Fast DDS leaves the bytes between fields, and a few behind the last, as it finds them in memory. Cleaning
    is fast while strings and sequences keep their lengths. ValueError if the type is not installed.
    """

    def __init__(self, type_name: str) -> None:
        self._leaves = installed_leaves(type_name)
        self._layout: Layout | None = None

    def clean(self, data: bytes) -> bytes:
        """Return the message with zero padding, cut at its end; unchanged if it does not fit its type."""
        layout = self._layout
        if layout is None or not layout.fits(data):
            layout = self._layout = find_layout(self._leaves, data)
        if layout is None:
            return data
        cleaned = bytearray(data[: layout.end])
        for start, stop in layout.gaps:
            cleaned[start:stop] = bytes(stop - start)
        return bytes(cleaned)


def byte_order(data: bytes) -> Literal["<", ">"]:
    """Return the byte order that the encapsulation of a message states."""
    return "<" if data[1] & 1 else ">"


def item_size(leaf: Leaf) -> int:
    """Return the bytes of one number of a leaf."""
    return struct.calcsize(f"={leaf.code}")


def find_layout(leaves: Sequence[Leaf], data: bytes) -> Layout | None:
    """Return the layout of one message; None if it does not fit its type, or a field is not known."""
    try:
        return Layout(leaves, data)
    except (struct.error, IndexError):
        return None


@cache
def installed_leaves(type_name: str) -> tuple[Leaf, ...]:
    """Return the leaves of an installed message type (``package/msg/Name``); ValueError if it is not."""
    return find_leaves(installed_fields, type_name)


def find_leaves(
    fields: Fields, type_name: str, path: tuple[str, ...] = (), prefix: str = ""
) -> tuple[Leaf, ...]:
    """Return the leaves of a message type in order; ``path`` and ``prefix`` lead to a nested message."""
    leaves: list[Leaf] = []
    for name, base, length in fields(type_name):
        leaf = _leaf(fields, base, length, (*path, name), prefix + name)
        is_nested = leaf.kind == "object" and leaf.length is None
        leaves.extend(leaf.parts if is_nested and leaf.parts else [leaf])
    return tuple(leaves)


def _leaf(fields: Fields, base: str, length: int | None, path: tuple[str, ...], name: str) -> Leaf:
    if base == "string":
        return Leaf(name, path, "string", "B", 1, length)
    if base in _CODES:
        return Leaf(name, path, "number", _CODES[base], 1, length)
    if base in _TIMES:
        return Leaf(f"{name}_ns", path, "time", "i", 2, length)
    if "/" not in base:
        return Leaf(name, path, "object", "", 1, length)
    names = [field for field, _, _ in fields(base)]
    codes = {_CODES.get(each, "") if count is None else "" for _, each, count in fields(base)}
    if names in (list("xyz"), list("xyzw")) and codes in ({"f"}, {"d"}):
        suffix = "_xyzw" if len(names) == 4 else ""
        return Leaf(name + suffix, path, "vector", codes.pop(), len(names), length)
    prefix = "" if base == "std_msgs/msg/Header" and name == "header" else f"{name}."
    return Leaf(name, path, "object", "", 1, length, find_leaves(fields, base, path, prefix))
