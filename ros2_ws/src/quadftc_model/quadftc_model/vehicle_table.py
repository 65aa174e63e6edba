"""Read a table of a vehicle's file: texts, numbers and arrays, each refused by its key."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 1e9  # in SI; no number of a vehicle is larger


def read_section(
    table: dict[str, Any], prefix: str, kinds: dict[str, Any], *, optional: bool = False
) -> dict[str, Any]:
    """Return the values of a table by key; messages call the table by a prefix.

    A kind is ``str``, ``float`` or the shape of an array, -1 being any length. Any key of an ``optional``
    table may be missing.
    """
    names = [key for key in kinds if key in table or not optional]
    values = {key: _read(f"{prefix}{key}", table.get(key), kinds[key]) for key in names}
    for key in table.keys() - kinds:
        raise ValueError(f"{prefix}{key}: unknown key")
    return values


def _read(key: str, value: Any, kind: Any) -> Any:
    """Return a text, a number or an array as the vehicle holds it."""
    if kind is str:
        found, expected = value if isinstance(value, str) else None, "a text"
    elif kind is float:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        expected = f"a finite number, not beyond {LARGEST:g}"
        found = float(value) if is_number and abs(value) <= LARGEST else None
    else:
        expected = f"finite numbers of shape {kind}, -1 being any length, none beyond {LARGEST:g}"
        found = _array_of(value, kind)
    if found is not None:
        return found
    raise ValueError(f"{key} = {shortened(repr(value))}: expected {expected}")


def shortened(text: str) -> str:
    """Cut a value for a message."""
    return text if len(text) <= 100 else f"{text[:97]}..."


def _array_of(value: Any, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    array.setflags(write=False)
    return array if fits and np.all(np.abs(array) <= LARGEST) else None
