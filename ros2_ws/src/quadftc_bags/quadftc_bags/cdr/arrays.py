"""Serialised messages of a whole topic to NumPy arrays and back.

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

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadftc_bags.cdr.layout import ORIGIN, Field, Layout, Leaf, Place, byte_order, find_layout, find_leaves

Arrays = dict[str, NDArray[Any]]
Bytes = NDArray[np.uint8]


def decode_topic(types: Typesdict, type_name: str, data: bytes, sizes: Sequence[int]) -> Arrays:
    """Decode all messages of a topic; return one array per field, none for no messages.

    Parameters
    ----------
    types : dict
        Definitions of the type and all it uses (`rosbags.typesys.get_types_from_msg`).
    type_name : str
        ``package/msg/Name``.
    data : bytes
        The serialised messages, one after the other.
    sizes : sequence of int
        Their lengths [bytes].

    Raises ValueError if a message does not fit its type.
    """
    leaves = find_leaves(_stored_fields(types), type_name) if sizes else ()
    if not leaves:
        return {}
    if min(sizes) == max(sizes):
        matrix = np.frombuffer(data, np.uint8).reshape(len(sizes), sizes[0])
        layout = _common_layout(leaves, bytes(matrix[0]))
        if layout is not None and _is_common(layout, matrix):
            return {place.leaf.name: _take(matrix, place) for place in layout.places}
    return _decode_each(types, type_name, leaves, data, sizes)


def encode_topic(
    type_name: str, definition: str, template: bytes, columns: Mapping[str, NDArray[Any]]
) -> list[bytes]:
    """Serialise n messages of the layout of one template, whose strings they keep.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    definition : str
        Text of the type and of all types it uses.
    template : bytes
        A message, little-endian; fields that are no column are taken from it.
    columns : mapping
        Field, named as in the module's table, to its values over all messages (n, ...).

    Raises ValueError if the messages cannot have a common layout, or a column does not fit its field.
    """
    types = get_types_from_msg(definition, type_name)
    layout = _common_layout(find_leaves(_stored_fields(types), type_name), template)
    if layout is None or byte_order(template) != "<":
        raise ValueError(f"{type_name}: the messages have no common layout")
    places = {place.leaf.name: place for place in layout.places}
    count = len(next(iter(columns.values())))
    matrix = np.tile(np.frombuffer(template, np.uint8), (count, 1))
    for name, values in columns.items():
        if name not in places:
            raise ValueError(f"{type_name}: no field '{name}'; fields: {', '.join(places)}")
        raw = _put(places[name], values)
        offset = places[name].offset
        matrix[:, offset : offset + raw.shape[1]] = raw
    return [row.tobytes() for row in matrix]


def _stored_fields(types: Typesdict) -> Callable[[str], list[Field]]:
    """Return what gives the fields of a message type by the definitions in a bag."""

    def fields_of(type_name: str) -> list[Field]:
        return [_stored_field(name, content) for name, content in types[type_name][1]]

    return fields_of


def _stored_field(name: str, content: FieldDesc) -> Field:
    length: int | None = None
    element: Any = content
    if content[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, size = cast("tuple[Any, int]", content[1])
        length = size if content[0] == Nodetype.ARRAY else -1
    return Field(name, element[1][0] if element[0] == Nodetype.BASE else element[1], length)


def _common_layout(leaves: Sequence[Leaf], sample: bytes) -> Layout | None:
    """Return the layout of messages like ``sample``; None if some field cannot be one slice of them."""
    if any(leaf.kind == "object" or (leaf.kind == "string" and leaf.length is not None) for leaf in leaves):
        return None
    return find_layout(leaves, sample)


def _is_common(layout: Layout, matrix: Bytes) -> bool:
    """Return whether byte order and all lengths are the same in each message."""
    columns = [1] + [offset + k for offset, _ in layout.lengths for k in range(4)]
    chosen = matrix[:, columns]
    return bool(np.all(chosen == chosen[0]))


def _take(matrix: Bytes, place: Place) -> NDArray[Any]:
    """Return one leaf of all messages."""
    leaf, offset, number = place
    rows = len(matrix)
    dtype = np.dtype(leaf.dtype).newbyteorder(byte_order(bytes(matrix[0, :2])))
    width = number * leaf.width
    raw = np.ascontiguousarray(matrix[:, offset : offset + width * dtype.itemsize])
    if leaf.kind == "string":
        return _texts(raw)
    values = raw.view(dtype).reshape(rows, width) if width else np.empty((rows, 0), dtype)
    values = values.astype(dtype.newbyteorder("="), copy=False)
    shape = () if leaf.length is None else (number,)
    if leaf.kind == "time":
        return _nanoseconds(values.reshape(rows, *shape, 2))
    return values.reshape(rows, *shape, *((leaf.width,) if leaf.kind == "vector" else ()))


def _put(place: Place, values: NDArray[Any]) -> Bytes:
    """Return the bytes of a field over all messages (n, size)."""
    leaf = place.leaf
    dtype = np.dtype(leaf.dtype).newbyteorder("<")
    if leaf.kind == "time":
        pairs = np.stack(np.divmod(np.asarray(values, np.int64), 1_000_000_000), axis=-1)
        cells = pairs.astype("<i4").reshape(len(values), -1)
    else:
        cells = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
    if leaf.kind == "string" or cells.shape[1] != place.number * leaf.width:
        raise ValueError(f"field '{leaf.name}': values of shape {values.shape} do not fit")
    return np.ascontiguousarray(cells).view(np.uint8)


def _texts(raw: NDArray[np.uint8]) -> NDArray[Any]:
    """Return the strings whose bytes, with the closing zero, are the rows."""
    if bool(np.all(raw == raw[0])):
        return np.full(len(raw), raw[0].tobytes().rstrip(b"\0").decode("utf-8", "replace"))
    return np.array([row.tobytes().rstrip(b"\0").decode("utf-8", "replace") for row in raw])


def _nanoseconds(pairs: NDArray[Any]) -> NDArray[np.int64]:
    """Return int64 nanoseconds from (..., 2): signed seconds and unsigned nanoseconds."""
    return pairs[..., 0].astype(np.int64) * 1_000_000_000 + pairs[..., 1].view(np.uint32).astype(np.int64)


def _decode_each(
    types: Typesdict, type_name: str, leaves: Sequence[Leaf], data: bytes, sizes: Sequence[int]
) -> Arrays:
    """Decode message by message."""
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    definition: Any = store.get_msgdef(type_name)
    columns: dict[str, list[Any]] = {leaf.name: [] for leaf in leaves}
    start = 0
    for size in sizes:
        try:
            # Not store.deserialize_cdr: it refuses the bytes that Fast DDS may leave behind a message's end.
            body = data[start + ORIGIN : start + size]
            read = definition.deserialize_cdr_le if data[start + 1] & 1 else definition.deserialize_cdr_be
            message: Any = read(body, 0, definition.cls, store)[0]
        except Exception as error:
            raise ValueError(f"a message of {size} bytes is no {type_name} ({error!r})") from error
        start += size
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
        rows = np.array(parts, leaf.dtype).reshape(len(parts), leaf.width)
    return rows[0] if leaf.length is None else rows


def _column(leaf: Leaf, values: list[Any]) -> NDArray[Any]:
    """Stack the values of all messages; values of different lengths stay objects."""
    ragged = leaf.length == -1 and len({len(value) for value in values}) > 1
    if leaf.kind != "object" and not ragged and not (leaf.kind == "string" and leaf.length is not None):
        return np.array(values, dtype=np.dtype(leaf.dtype) if leaf.kind == "number" else None)
    column = np.empty(len(values), object)
    for row, value in enumerate(values):
        column[row] = value
    return column
