"""The table of a campaign: one row for each flight, variant and fault.

| columns | what |
|---|---|
| ``flight``, ``variant`` | number of the flight, from 0; what it was flown with |
| ``observer``, ``disturbance_observer``, ``controller`` | the parts of the variant |
| ``seed`` and each path that varies | the values drawn, as numbers in the unit of the campaign file |
| ``fault`` | number of the fault in the flight; null in the one row of a flight without faults |
| ``fault.<metric>`` | of this fault |
| ``<metric>``, ``<metric>.<axis>`` | of the whole flight, the same in all its rows |
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import polars as pl

Row = dict[str, Any]
Rows = list[Row]

ORDER = ("flight", "variant", "fault")
FLAGS = ("finite", "fault.detected", "fault.already_declared", "fault.recovered", "fault.above_threshold")
WHOLE = ("flight", "seed", "fault")  # columns of whole numbers


def table_of(rows: Rows) -> pl.DataFrame:
    """Make a table of rows; columns of numbers are Float64, but for `WHOLE`."""
    frame = pl.DataFrame(rows, infer_schema_length=None, strict=False)
    types: dict[str, Any] = {
        name: pl.Int64 if name in WHOLE else pl.Float64
        for name, kind in frame.schema.items()
        if kind.is_numeric() or (kind == pl.Null and name not in FLAGS)
    }
    types |= {name: pl.Boolean for name in FLAGS if name in frame.columns}
    return frame.cast(types)  # pyright: ignore[reportArgumentType]


def write_table(frame: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet, all of it or nothing.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("wb") as file:
            frame.write_parquet(file, compression="zstd", statistics=True)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def joined(paths: Iterable[Path]) -> pl.DataFrame:
    """Join the tables of chunks, in the order of the flights."""
    frames = [pl.read_parquet(path) for path in paths]
    return pl.concat(frames, how="diagonal_relaxed").sort(ORDER, nulls_last=True)
