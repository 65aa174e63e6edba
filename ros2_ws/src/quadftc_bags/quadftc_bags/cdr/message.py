# pyright: basic
"""The header and the numbers of single serialised messages, without a message object.

To read a message, rclpy builds a Python object with all its parts; to write one, it reads the numbers back
out of such an object. Both take several times as long as packing the numbers here.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message

from quadftc_bags.cdr import layout
from quadftc_bags.cdr.layout import FRAME, FRAME_LENGTH, NANOSECONDS, PLAIN, STAMP

_STAMPS = struct.Struct(">iI"), struct.Struct("<iI")  # by byte order


def leading_stamp_ns(data: bytes) -> int:
    """Return the stamp [ns] that a serialised message begins with; ValueError if it is too short."""
    if len(data) < FRAME_LENGTH:
        raise ValueError(f"no stamp in {len(data)} bytes")
    sec, nanosec = _STAMPS[data[1] != 0].unpack_from(data, STAMP)
    return sec * NANOSECONDS + nanosec


def leading_frame(data: bytes) -> str:
    """Return the frame of the header that a message in plain CDR begins with; ValueError if there is none."""
    try:
        (length,) = struct.unpack_from("<I" if data[1] else ">I", data, FRAME_LENGTH)
    except (struct.error, IndexError):
        raise ValueError(f"no frame in {len(data)} bytes") from None
    return data[FRAME:][: max(0, length - 1)].decode(errors="replace")


def read_message(data: bytes, message_class: type) -> Any:
    """Return the message object of bytes in any encoding; ValueError if they are no such message."""
    try:
        return deserialize_message(data, message_class)
    except Exception as error:  # of rclpy, which has no class for it
        raise ValueError(f"not a {message_class.__name__}: {error}") from None


def read_numbers(data: bytes, message_class: type) -> tuple[Any, ...]:
    """Return the numbers of a message that is a header and numbers of fixed count, else a ValueError."""
    return _number_reader(message_class, data[1:2] + data[FRAME_LENGTH:FRAME])(data)[1]


@lru_cache(maxsize=64)  # a bag may hold names of any length
def _number_reader(message_class: type, _: bytes) -> FieldReader:
    """Return a reader of all numbers, for a byte order and a length of the frame's name."""
    return FieldReader(message_class)


class FieldReader:
    """Read some numeric fields of messages whose texts and lengths seldom change.

    ``fields`` are named as in `quadftc_bags.cdr.arrays`, in the order of the definition; none: all behind the
    header.
    """

    def __init__(self, message_class: type, *fields: str) -> None:
        self._class, self._fields = message_class, fields
        self._leaves = layout.installed_leaves(_type_name(message_class))
        self._layout: layout.Layout | None = None
        self._head = slice(0)
        self._start, self._body = 0, struct.Struct("")

    def __call__(self, data: bytes) -> tuple[bytes, tuple[Any, ...]]:
        """Return all between the stamp and the numbers, and the numbers; ValueError if it is no such message.

        While the former stays the same, so do names and frames.
        """
        if data[:2] not in PLAIN:
            data = serialize_message(read_message(data, self._class))
        if self._layout is None or not self._layout.fits(data):
            self._learn(data)
        return data[self._head], self._body.unpack_from(data, self._start)

    def _learn(self, data: bytes) -> None:
        found = layout.find_layout(self._leaves, data)
        places = _chosen(found, self._fields) if found else []
        if found is None or not places:
            raise ValueError(f"not a {self._class.__name__}: {len(data)} bytes")
        self._layout = found
        self._start, self._body = _struct_of(places, data)
        self._head = slice(FRAME_LENGTH, self._start)


class FieldWriter:
    """Write messages of which only the stamp and some numeric fields change.

    ``message`` gives the rest; ``fields`` are as of a `FieldReader`, with the lengths that they have in
    ``message``.
    """

    def __init__(self, message: object, *fields: str) -> None:
        type_name = _type_name(type(message))
        clean = layout.PaddingCleaner(type_name).clean(serialize_message(message))
        found = layout.find_layout(layout.installed_leaves(type_name), clean)
        assert found is not None
        chosen = _chosen(found, fields)
        self._data = data = bytearray(clean)
        self._set_stamp = partial(struct.Struct(f"{layout.byte_order(clean)}iI").pack_into, data, STAMP)
        self._runs: list[tuple[Callable[..., None], slice]] = []
        first = 0
        for places in [[place] for place in chosen] if fields else [chosen]:
            start, run = _struct_of(places, clean)
            last = first + sum(place.number * place.leaf.width for place in places)
            self._runs.append((partial(run.pack_into, data, start), slice(first, last)))
            first = last

    def __call__(self, stamp_ns: int, *numbers: float) -> bytes:
        """Return the message of a stamp [ns] and the numbers of the fields."""
        self._set_stamp(*divmod(stamp_ns, NANOSECONDS))
        for write, part in self._runs:
            write(*numbers[part])
        return bytes(self._data)


def _type_name(message_class: type) -> str:
    return f"{message_class.__module__.partition('.')[0]}/msg/{message_class.__name__}"


def _chosen(found: layout.Layout, fields: Sequence[str]) -> Sequence[layout.Place]:
    """Return the places of some fields; of none: all behind stamp and frame."""
    return [place for place in found.places if place.leaf.name in fields] if fields else found.places[2:]


def _struct_of(places: Sequence[layout.Place], data: bytes) -> tuple[int, struct.Struct]:
    """Return where the first of some places begins, and what packs their numbers; the rest is zero."""
    start = position = places[0].offset
    codes = layout.byte_order(data)
    for leaf, offset, number in places:
        code = "iI" if leaf.kind == "time" else leaf.code * leaf.width
        codes += "x" * (offset - position) + code * number
        position = offset + number * leaf.width * layout.item_size(leaf)
    return start, struct.Struct(codes)
