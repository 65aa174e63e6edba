# pyright: basic
"""Serialised messages without chance: padding set to zero, nothing behind the end.

Fast DDS leaves the bytes between the fields of a message, and sometimes a few behind the last, as it finds
them in memory. Two recordings of the same values would differ there.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple, TypeAlias

from quadftc_bags.interfaces import load_message_class

HEADER_SIZE = 4  # bytes before the message; alignment counts from behind them

_PRIMITIVE_SIZES = {
    **dict.fromkeys(("boolean", "octet", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("float", "int32", "uint32"), 4),
    **dict.fromkeys(("double", "int64", "uint64"), 8),
}
_SEQUENCE = re.compile(r"sequence<(.+?)(?:, \d+)?>")
_ARRAY = re.compile(r"(.+)\[(\d+)\]")
_STRING = re.compile(r"string(?:<\d+>)?")


class _Primitive(NamedTuple):
    size: int
    number: int


class _String(NamedTuple):
    pass


class _Array(NamedTuple):
    element: tuple[_Field, ...]
    number: int


class _Sequence(NamedTuple):
    element: tuple[_Field, ...]


_Field: TypeAlias = _Primitive | _String | _Array | _Sequence


class _Shape(NamedTuple):
    """What messages of equal shape have in common: size, length words, where the padding and the end are."""

    size: int
    lengths: tuple[tuple[int, bytes], ...]
    gaps: tuple[tuple[int, int], ...]
    end: int


class PaddingCleaner:
    """Clean the messages of one topic; quick as long as their strings and sequences keep their lengths.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.

    Raises
    ------
    ValueError
        If the type is not installed, or has fields that are not known here (``wstring``).
    """

    def __init__(self, type_name: str) -> None:
        self._fields = _fields(type_name)
        self._shape: _Shape | None = None

    def clean(self, data: bytes) -> bytes:
        """Return the message with zeros for padding and without what stands behind its end.

        A message that does not fit its type comes back as it is.
        """
        shape = self._shape
        if shape is None or len(data) != shape.size or any(data[at : at + 4] != n for at, n in shape.lengths):
            try:
                shape = self._shape = _Walk(data).shape(self._fields)
            except (struct.error, IndexError):
                return data
        if not shape.gaps:
            return data[: shape.end]
        cleaned = bytearray(data[: shape.end])
        for start, stop in shape.gaps:
            cleaned[start:stop] = bytes(stop - start)
        return bytes(cleaned)


class _Walk:
    """One pass over a serialised message."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = HEADER_SIZE
        self._words = struct.Struct("<I" if data[1] else ">I")
        self._lengths: list[tuple[int, bytes]] = []
        self._gaps: list[tuple[int, int]] = []

    def shape(self, fields: tuple[_Field, ...]) -> _Shape:
        self._pass(fields)
        if self._position > len(self._data):
            raise IndexError
        return _Shape(len(self._data), tuple(self._lengths), tuple(self._gaps), self._position)

    def _pass(self, fields: tuple[_Field, ...]) -> None:
        for field in fields:
            if isinstance(field, _Primitive):
                self._align(field.size)
                self._position += field.size * field.number
            elif isinstance(field, _String):
                length = self._length()
                self._position += length
            else:
                number = field.number if isinstance(field, _Array) else self._length()
                for element in self._elements(field.element, number):
                    self._pass(element)

    def _elements(self, element: tuple[_Field, ...], number: int) -> list[tuple[_Field, ...]]:
        """Return what to pass over for some elements; primitives in one go, as they have no gaps."""
        if number and len(element) == 1 and isinstance(element[0], _Primitive):
            size, each = element[0]
            return [(_Primitive(size, each * number),)]
        if number > len(self._data):
            raise IndexError
        return [element] * number

    def _length(self) -> int:
        self._align(4)
        at = self._position
        (number,) = self._words.unpack_from(self._data, at)
        self._lengths.append((at, self._data[at : at + 4]))
        self._position += 4
        return number

    def _align(self, size: int) -> None:
        gap = (HEADER_SIZE - self._position) % size
        if gap:
            self._gaps.append((self._position, self._position + gap))
            self._position += gap


def _fields(type_name: str) -> tuple[_Field, ...]:
    """Return the fields of a message type; an empty one holds a byte."""
    types: dict[str, str] = load_message_class(type_name).get_fields_and_field_types()  # type: ignore[attr-defined]
    found = [field for text in types.values() for field in _parsed(text)]
    return tuple(found) or (_Primitive(1, 1),)


def _parsed(text: str) -> tuple[_Field, ...]:
    """Return the fields that a type's name in the generated Python class stands for."""
    if text in _PRIMITIVE_SIZES:
        return (_Primitive(_PRIMITIVE_SIZES[text], 1),)
    if _STRING.fullmatch(text):
        return (_String(),)
    if match := _SEQUENCE.fullmatch(text):
        return (_Sequence(_parsed(match[1])),)
    if match := _ARRAY.fullmatch(text):
        return (_Array(_parsed(match[1]), int(match[2])),)
    package, _, name = text.partition("/")
    return _fields(f"{package}/msg/{name}")
