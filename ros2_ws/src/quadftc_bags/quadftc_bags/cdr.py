"""From serialised ROS 2 messages (CDR) to NumPy arrays, a whole topic at a time.

The messages of a topic usually have equal length and equal strings' and sequences' lengths, so that a field
lies at the same place in each. The places are found once, from the type's definition and the first message;
then each field of all messages is one slice of a matrix of bytes. Where that does not hold, every message is
decoded by itself.

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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_typestore

Arrays = dict[str, NDArray[Any]]
Kind = Literal["number", "time", "vector", "string", "object"]

_HEADER_SIZE = 4  # bytes before the message; alignment counts from behind them
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_DTYPES = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "float32": "f4",
    "float64": "f8",
    **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
}


class Leaf(NamedTuple):
    """A field that becomes one array.

    ``path`` leads to it from the message; ``width`` is how many numbers make one element; ``length`` is None
    for one element, -1 for a sequence, else the length of the array.
    """

    name: str
    path: tuple[str, ...]
    kind: Kind
    dtype: str
    width: int
    length: int | None


@dataclass(frozen=True)
class Layout:
    """Where the leaves lie in every message: (leaf, offset, elements); and the offsets of length words."""

    places: tuple[tuple[Leaf, int, int], ...]
    lengths: tuple[int, ...]


def decode(types: Typesdict, type_name: str, data: bytes, sizes: Sequence[int]) -> Arrays:
    """Decode all messages of a topic.

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

    Returns
    -------
    dict of str to array
        One array per field, as the module's text describes; empty for no messages.

    Raises
    ------
    ValueError
        If a message does not fit its type.
    """
    if not sizes:
        return {}
    leaves = find_leaves(types, type_name)
    if min(sizes) == max(sizes):
        matrix = np.frombuffer(data, np.uint8).reshape(len(sizes), sizes[0])
        layout = find_layout(leaves, bytes(matrix[0]))
        if layout is not None and _is_common(layout, matrix):
            return {leaf.name: _take(matrix, leaf, offset, number) for leaf, offset, number in layout.places}
    return _decode_each(types, type_name, leaves, data, sizes)


def find_leaves(
    types: Typesdict, type_name: str, path: tuple[str, ...] = (), prefix: str = ""
) -> tuple[Leaf, ...]:
    """Return the fields of a message type that become arrays, in their order."""
    leaves: list[Leaf] = []
    for name, field in types[type_name][1]:
        inner_path, full_name = (*path, name), prefix + name
        nested = field[1] if field[0] == Nodetype.NAME else None
        leaf = _leaf(types, full_name, inner_path, field)
        if leaf is None and isinstance(nested, str):
            is_header = nested == "std_msgs/msg/Header" and full_name == "header"
            leaves.extend(find_leaves(types, nested, inner_path, "" if is_header else f"{full_name}."))
        else:
            leaves.append(leaf or Leaf(full_name, inner_path, "object", "", 1, None))
    return tuple(leaves)


def find_layout(leaves: Sequence[Leaf], sample: bytes) -> Layout | None:
    """Return where the leaves lie in messages like ``sample``, or None if the type has no such places."""
    order = _byte_order(sample[1])
    words = np.dtype(f"{order}u4")
    position = _HEADER_SIZE
    places: list[tuple[Leaf, int, int]] = []
    lengths: list[int] = []
    for leaf in leaves:
        if leaf.kind == "object" or (leaf.kind == "string" and leaf.length is not None):
            return None
        number = 1 if leaf.length is None else leaf.length
        if leaf.kind == "string" or number < 0:
            position = _aligned(position, 4)
            if position + 4 > len(sample):
                return None
            lengths.append(position)
            number = int(np.frombuffer(sample, words, 1, position)[0])
            position += 4
        size = np.dtype(leaf.dtype).itemsize
        if number:
            position = _aligned(position, size)
        places.append((leaf, position, number))
        position += number * leaf.width * size
    return Layout(tuple(places), tuple(lengths)) if position <= len(sample) else None


def _leaf(types: Typesdict, name: str, path: tuple[str, ...], field: FieldDesc) -> Leaf | None:
    """Return the leaf that a field is, or None if it is a message with fields of its own."""
    length: int | None = None
    element: Any = field
    if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        element, size = cast("tuple[Any, int]", field[1])
        length = size if field[0] == Nodetype.ARRAY else -1
    if element[0] == Nodetype.BASE:
        base = element[1][0]
        if base == "string":
            return Leaf(name, path, "string", "u1", 1, length)
        return Leaf(name, path, "number", _DTYPES[base], 1, length) if base in _DTYPES else None
    if element[1] in _TIMES:
        return Leaf(f"{name}_ns", path, "time", "i4", 2, length)
    inner: list[tuple[str, Any]] = list(types[element[1]][1])
    if [key for key, _ in inner] in (["x", "y", "z"], ["x", "y", "z", "w"]):
        bases = {kind[1][0] for _, kind in inner if kind[0] == Nodetype.BASE}
        if len(bases) == 1 and bases <= {"float32", "float64"}:
            suffix = "_xyzw" if len(inner) == 4 else ""
            return Leaf(name + suffix, path, "vector", _DTYPES[bases.pop()], len(inner), length)
    return None if length is None and inner else Leaf(name, path, "object", "", 1, length)


def _is_common(layout: Layout, matrix: NDArray[np.uint8]) -> bool:
    """Return whether byte order and all lengths are the same in each message."""
    columns = [1] + [offset + k for offset in layout.lengths for k in range(4)]
    chosen = matrix[:, columns]
    return bool(np.all(chosen == chosen[0]))


def _take(matrix: NDArray[np.uint8], leaf: Leaf, offset: int, number: int) -> NDArray[Any]:
    """Return one leaf of all messages."""
    rows = len(matrix)
    dtype = np.dtype(leaf.dtype).newbyteorder(_byte_order(int(matrix[0, 1])))
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
            body = data[start + _HEADER_SIZE : start + size]
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


def _byte_order(flag: int) -> Literal["<", ">"]:
    return "<" if flag & 1 else ">"


def _aligned(position: int, size: int) -> int:
    return position + (_HEADER_SIZE - position) % size
