"""A short hover as a table of fields, any of which can hold what no sensor gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

COUNT, PERIOD = 300, 0.04  # samples, s
START = 1_700_000_000.0  # s since 1970, where a format has such a clock
AXES, ROTORS = "xyz", "1234"
Flight = dict[str, NDArray[np.float64]]  # column to (COUNT,)
HOSTILE = (
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 3.4e38, 1e30, 1e18, 1e9, 1e4, -1e4, 5e-324),
    *(0.0, -0.0, 1.0, -1.0, 2.0**31, 2.0**63, -(2.0**63), 255.0, 65535.0, 32768.0, 0.1, 1e-9),
)
JUMPS = (-3600.0, 3600.0, -1e-6, -PERIOD, -2.5, 30.0, 86400.0, 1e9, -1e9, 1e12, float("nan"), float("inf"))
TEXTS = (
    "",
    "nan",
    "1e999",
    "-1",
    "0x7fc00000",
    "0",
    "9" * 400,
    "1,2",
    "2047,158",
    "\x00",
    "é",
    "Rotorflight",
)


def hover() -> Flight:
    """Return a hover of 12 s with noise."""
    noise = np.random.default_rng(1).normal(size=(COUNT, 16))
    time = PERIOD * np.arange(COUNT)
    flight: dict[str, Any] = {"time": time}
    for k, axis in enumerate(AXES):
        flight[f"gyro.{axis}"] = 0.1 * np.cos(time + k) + 0.01 * noise[:, k]
        flight[f"force.{axis}"] = 0.05 * noise[:, 3 + k] + (9.81 if axis == "z" else 0.0)
        flight[f"angle.{axis}"] = 0.1 * np.sin(time + k) + 0.001 * noise[:, 6 + k]
        flight[f"position.{axis}"] = 0.01 * noise[:, 9 + k] + (2.0 if axis == "z" else 0.0)
    for k, rotor in enumerate(ROTORS):
        flight[f"rotor.{rotor}"] = 0.5 + 0.01 * noise[:, 12 + k]
    flight["battery"] = np.full(COUNT, 12.0)
    return flight


class Spoil(NamedTuple):
    """Rows of a column that get a value; of the time, which jumps by it."""

    column: str
    row: int
    length: int
    value: float


def spoils() -> st.SearchStrategy[list[Spoil]]:
    """Draw some fields that are no measurements, and jumps of time."""
    rows = (st.integers(0, COUNT - 1), st.sampled_from((1, 1, 2, 20, COUNT)))
    jump = st.builds(Spoil, st.just("time"), *rows, st.sampled_from(JUMPS))
    columns = st.sampled_from([name for name in hover() if name != "time"])
    field = st.builds(Spoil, columns, *rows, st.sampled_from(HOSTILE) | st.floats())
    return st.lists(field | field | jump, min_size=1, max_size=5)


def spoiled(spoils: Sequence[Spoil]) -> Flight:
    """Return the hover with some fields spoiled."""
    flight = hover()
    for column, row, length, value in spoils:
        part = flight[column][row : row + length]
        part[:] = part + value if column == "time" else value
    return flight


def whole(values: NDArray[np.float64], kind: str) -> NDArray[Any]:
    """Whole numbers of a type; NaN becomes zero, what is beyond its range the nearest end."""
    ends = np.iinfo(kind)
    with np.errstate(invalid="ignore"):
        inside = np.nan_to_num(np.rint(values), nan=0.0, posinf=np.inf, neginf=-np.inf)
        cast = np.clip(inside, float(ends.min), float(ends.max) * (1.0 - 2.0**-52)).astype(kind)
    return np.where(inside >= float(ends.max), ends.max, cast)


def rows(kind: Sequence[tuple[Any, ...]], columns: Mapping[str, Any]) -> list[bytes]:
    """Pack columns into rows of a packed type; those not given are zero."""
    table = np.zeros(COUNT, np.dtype(list(kind)))
    for name, values in columns.items():
        field = table.dtype[name]
        is_whole = isinstance(values, np.ndarray) and field.kind in "iu" and values.dtype.kind == "f"
        with np.errstate(over="ignore", invalid="ignore"):
            table[name] = whole(values, field.str) if is_whole else values
    return [row.tobytes() for row in table]


def braid(*streams: list[bytes]) -> bytes:
    """Put the first rows of all streams one after the other, then the second ones."""
    return b"".join(row for rows in zip(*streams, strict=True) for row in rows)


def vector(flight: Flight, name: str, factor: float = 1.0, signs: Sequence[float] = (1, 1, 1)) -> Any:
    """Return a vector of the table (COUNT, 3), in the axes and the unit of a format."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack(
            [sign * factor * flight[f"{name}.{a}"] for a, sign in zip(AXES, signs, strict=True)], 1
        )


def rotors(flight: Flight) -> Any:
    """Return the shares of the rotors (COUNT, 4)."""
    return np.stack([flight[f"rotor.{number}"] for number in ROTORS], 1)
