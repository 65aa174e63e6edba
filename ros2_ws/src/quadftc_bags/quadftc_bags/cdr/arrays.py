"""Serialised messages of a whole topic to NumPy arrays, and back.

The messages of a topic usually have the same layout. Then each field of all messages is one slice of a matrix
of bytes. Where they differ, every message is decoded by itself.

Names of the arrays (n messages):

| in the message | array |
|---|---|
| ``float64 x``, ``uint8[3] state`` | ``x`` (n,), ``state`` (n, 3) |
| ``geometry_msgs/Vector3 v`` and others of x, y, z | ``v`` (n, 3) |
| ``geometry_msgs/Quaternion q`` | ``q_xyzw`` (n, 4) |
| ``builtin_interfaces/Time t``, ``Time[3] t`` | ``t_ns`` (n,), ``t_ns`` (n, 3), int64 [ns] |
| ``std_msgs/Header header`` | ``stamp_ns`` (n,), ``frame_id`` (n,) |
| field ``b`` of another message ``a`` | ``a.b`` |
| sequences of messages and what varies in length | array of objects (n,) |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_typestore

from quadftc_bags.cdr.layout import NANOSECONDS, ORIGIN, Leaf, Place, byte_order, find_layout, find_leaves

Column = NDArray[Any]  # a field of all messages (n, ...)
Arrays = dict[str, Column]
Bytes = NDArray[np.uint8]


def decode_topic(types: Typesdict, type_name: str, messages: Sequence[bytes]) -> Arrays:
    """Decode all messages of a topic; return one array per field, none for no messages.

    ``types`` defines ``type_name`` (``package/msg/Name``) and all it uses. Raises ValueError if a message
    does not fit its type.
    """
    if not messages:
        return {}
    leaves = _leaves_of(types, type_name)
    may_fit = all(leaf.kind != "object" for leaf in leaves) and len({len(data) for data in messages}) == 1
    if may_fit and (layout := find_layout(leaves, messages[0])):
        matrix = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), -1)
        # byte order and all lengths
        columns = matrix[:, [1] + [offset + k for offset, _ in layout.lengths for k in range(4)]]
        if bool(np.all(columns == columns[0])):
            return {leaf.name: _take_leaf(matrix, leaf, layout.places) for leaf in leaves}
    return _decode_each(types, type_name, leaves, messages)


def encode_topic(types: Typesdict, type_name: str, fields: Mapping[str, Any], count: int) -> list[bytes]:
    """Write ``count`` messages in plain little-endian CDR; ``fields`` are named as `decode_topic` names them.

    A text, or list of texts, is that of all messages. A number that is not given is NaN or 0, a text and a
    sequence empty. ValueError for a type with lists of messages.
    """
    parts: list[Bytes] = [np.tile(np.array([0, 1, 0, 0], np.uint8), (count, 1))]

    def put(values: Column, size: int) -> None:
        raw = np.ascontiguousarray(values).view(np.uint8).reshape(count, -1)
        gap = (ORIGIN - sum(part.shape[1] for part in parts)) % size if raw.size else 0
        parts.extend((np.zeros((count, gap), np.uint8), raw))

    for leaf in _leaves_of(types, type_name):
        if leaf.kind == "object":
            raise ValueError(f"{type_name}: {leaf.name} is a list of messages")
        given = fields.get(leaf.name)
        if leaf.kind == "string":
            texts = [str(given or "")] if leaf.length is None else list(given or ())
            if leaf.length == -1:
                put(np.full(count, len(texts), "<u4"), 4)
            for text in (f"{each}\0".encode() for each in texts):
                put(np.full(count, len(text), "<u4"), 4)
                put(np.tile(np.frombuffer(text, np.uint8), (count, 1)), 1)
            continue
        # numbers, a row a message: a length goes before those of a sequence
        dtype = np.dtype(leaf.code).newbyteorder("<")
        unknown = np.nan if dtype.kind == "f" else 0
        number = np.shape(given)[1] if leaf.length == -1 and given is not None else max(0, leaf.length or 1)
        values = np.full((count, number), unknown) if given is None else np.asarray(given)
        if leaf.kind == "time":
            values = np.stack(np.divmod(values.astype(np.int64), NANOSECONDS), axis=-1)
        elif given is None:
            values = np.full((count, number * leaf.width), unknown)
        if leaf.length == -1:
            put(np.full(count, number, "<u4"), 4)
        put(values.reshape(count, -1).astype(dtype), dtype.itemsize)
    return [row.tobytes() for row in np.concatenate(parts, axis=1)]


def _leaves_of(types: Typesdict, type_name: str) -> tuple[Leaf, ...]:
    return find_leaves(lambda name: [(each, *_element(field)) for each, field in types[name][1]], type_name)


def _element(content: FieldDesc) -> tuple[str, int | None]:
    """Return the type of a field's elements, and their number as in `Leaf`."""
    length: int | None = None
    element: Any = content
    if content[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, size = cast("tuple[Any, int]", content[1])
        length = size if content[0] == Nodetype.ARRAY else -1
    return element[1][0] if element[0] == Nodetype.BASE else element[1], length


def _take_leaf(matrix: Bytes, leaf: Leaf, places: Sequence[Place]) -> Column:
    """Return one leaf of all messages; of several strings an array of lists."""
    own = [place for place in places if place.leaf.name == leaf.name]
    if leaf.is_sliced:
        return _take(matrix, own[0])
    texts = zip(*(_take(matrix, place).tolist() for place in own), strict=True) if own else [()] * len(matrix)
    column = np.empty(len(matrix), object)
    for row, values in enumerate(texts):
        column[row] = list(values)
    return column


def _take(matrix: Bytes, place: Place) -> Column:
    """Return one leaf of all messages."""
    leaf, offset, number = place
    dtype = np.dtype(leaf.code).newbyteorder(byte_order(bytes(matrix[0, :2])))
    raw = np.ascontiguousarray(matrix[:, offset : offset + number * leaf.width * dtype.itemsize])
    if leaf.kind == "string":
        return _texts(raw)
    shape = (len(matrix), *(() if leaf.length is None else (number,)))
    values = np.frombuffer(raw.tobytes(), dtype).astype(dtype.newbyteorder("="))
    if leaf.kind == "time":  # signed seconds, unsigned nanoseconds
        pairs = values.reshape(*shape, 2)
        return pairs[..., 0].astype(np.int64) * 1_000_000_000 + pairs[..., 1].view(np.uint32)
    return values.reshape(*shape, *((leaf.width,) if leaf.kind == "vector" else ()))


def _texts(raw: Bytes) -> Column:
    """Return the strings whose bytes, with the closing zero, are the rows."""
    rows = raw[:1] if bool(np.all(raw == raw[0])) else raw
    texts = np.array([row.tobytes().rstrip(b"\0").decode("utf-8", "replace") for row in rows])
    return texts if len(texts) == len(raw) else np.full(len(raw), texts[0])


def _decode_each(
    types: Typesdict, type_name: str, leaves: Sequence[Leaf], messages: Sequence[bytes]
) -> Arrays:
    """Decode message by message."""
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    definition = store.get_msgdef(type_name)
    columns: dict[str, list[Any]] = {leaf.name: [] for leaf in leaves}
    for data in messages:
        try:
            # Not store.deserialize_cdr: it refuses the bytes that Fast DDS may leave behind a message's end.
            read = definition.deserialize_cdr_le if data[1] & 1 else definition.deserialize_cdr_be
            message: Any = read(data[ORIGIN:], 0, definition.cls, store)[0]
        except Exception as error:
            raise ValueError(f"a message of {len(data)} bytes is no {type_name} ({error!r})") from error
        for leaf in leaves:
            columns[leaf.name].append(_value(leaf, message))
    return {leaf.name: _column(leaf, columns[leaf.name]) for leaf in leaves}


def _value(leaf: Leaf, message: Any) -> Any:
    """Return a leaf of one decoded message, in the form of the array's element."""
    value = message
    for name in leaf.path:
        value = getattr(value, name)
    if leaf.kind not in ("time", "vector"):
        return value
    elements = [value] if leaf.length is None else value
    if leaf.kind == "time":
        rows = np.array([e.sec * 1_000_000_000 + e.nanosec for e in elements], np.int64)
    else:
        parts = [[getattr(e, axis) for axis in "xyzw"[: leaf.width]] for e in elements]
        rows = np.array(parts, leaf.code).reshape(len(parts), leaf.width)
    return rows[0] if leaf.length is None else rows


def _column(leaf: Leaf, values: list[Any]) -> Column:
    """Stack the values of all messages; values of different lengths stay objects."""
    ragged = leaf.length == -1 and len({len(value) for value in values}) > 1
    if leaf.is_sliced and not ragged:
        return np.array(values, dtype=np.dtype(leaf.code) if leaf.kind == "number" else None)
    column = np.empty(len(values), object)
    for row, value in enumerate(values):
        column[row] = value
    return column
