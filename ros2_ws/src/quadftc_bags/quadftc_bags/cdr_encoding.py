"""From arrays to serialised ROS 2 messages (CDR), a whole topic at a time.

The inverse of `quadftc_bags.cdr`.

All messages of a topic have the shape of one template, whose strings they keep.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from quadftc_bags.cdr import Leaf, find_layout, find_leaves

Bytes = NDArray[np.uint8]


def encode(
    type_name: str, definition: str, template: bytes, columns: Mapping[str, NDArray[Any]]
) -> list[bytes]:
    """Serialise n messages.

    Parameters
    ----------
    type_name : str
        ``package/msg/Name``.
    definition : str
        Text of the type and of all types it uses.
    template : bytes
        A message, little-endian; fields that are no column are taken from it.
    columns : mapping
        Field, named as `quadftc_bags.cdr` does, to its values over all messages (n, ...).

    Raises
    ------
    ValueError
        If the type has no fixed places, or a column does not fit its field.
    """
    layout = find_layout(find_leaves(get_types_from_msg(definition, type_name), type_name), template)
    if layout is None or not template[1] & 1:
        raise ValueError(f"{type_name}: the messages have no common layout")
    places = {leaf.name: (leaf, offset, number) for leaf, offset, number in layout.places}
    count = len(next(iter(columns.values())))
    matrix = np.tile(np.frombuffer(template, np.uint8), (count, 1))
    for name, values in columns.items():
        if name not in places:
            raise ValueError(f"{type_name}: no field '{name}'; fields: {', '.join(places)}")
        leaf, offset, number = places[name]
        raw = _raw(leaf, values, number)
        matrix[:, offset : offset + raw.shape[1]] = raw
    return [row.tobytes() for row in matrix]


def _raw(leaf: Leaf, values: NDArray[Any], number: int) -> Bytes:
    """Bytes of a field (n, size)."""
    dtype = np.dtype(leaf.dtype).newbyteorder("<")
    if leaf.kind == "time":
        pairs = np.stack(np.divmod(np.asarray(values, np.int64), 1_000_000_000), axis=-1)
        cells = pairs.astype("<i4").reshape(len(values), -1)
    else:
        cells = np.ascontiguousarray(values, dtype).reshape(len(values), -1)
    if leaf.kind == "string" or cells.shape[1] != number * leaf.width:
        raise ValueError(f"field '{leaf.name}': values of shape {values.shape} do not fit")
    return np.ascontiguousarray(cells).view(np.uint8)
