"""A table (CSV) as a flight log, by a mapping that says what its columns mean (`mapping`).

The columns stand under their names: in the first line that has the name of the column of the time, whatever
comes before. Between them are commas, semicolons, tabs or spaces, as in that line. A cell that is no number
is missing; a signal has the rows in which it has a number.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from quadftc_bags.bag import BagError
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.contents import list_some
from quadftc_replay.readers.mapping import QUANTITIES, TIME_UNITS, Mapping, load_mapping
from quadftc_replay.readers.signals import Signals
from quadftc_replay.thinning import Thinning

FORMAT = "CSV"
DELIMITERS = ",;\t "
FIRST_LINES = 1000  # in which the names are looked for
LONGEST_LINE = 1 << 20  # characters
BLOCK = 8192  # rows made numbers at a time
LATEST = 2.0**62  # ns
SHOWN = 30  # columns in one line


def read(path: Path, mapping: Path) -> FlightLog:
    """Read a table; BagError if a column is missing, or if nothing in it can be used."""
    meaning, signals = load_mapping(mapping), Signals(path, FORMAT)
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
            lines = (line.replace("\0", "") for line in iter(lambda: stream.readline(LONGEST_LINE), ""))
            names, delimiter = _find_header(lines, meaning.time.column, f"{mapping}: time", path)
            places = _places(names, meaning, mapping, path)
            numbers = _numbers(csv.reader(lines, delimiter=delimiter), places, signals.notes)
    except (OSError, csv.Error) as error:
        raise BagError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    time = numbers[:, 0] * TIME_UNITS[meaning.time.unit]
    timed = np.abs(time) < LATEST  # False for NaN, too
    stamp_ns = np.rint(time[timed]).astype(np.int64)
    if lost := int(np.sum(~timed)):
        signals.notes.append(f"{lost} of {len(time)} rows have no time; left out")
    column = 1
    for each in meaning.signal:
        value = numbers[timed, column : column + len(each.columns)]
        column += len(each.columns)
        field, name = QUANTITIES[each.quantity].field, f"{each.quantity} {each.name}".strip()
        signals.add(field, stamp_ns, each.convert(value), name, each.name)
    torque_units = [each.unit for each in meaning.signal if each.quantity == "torque_command"]
    field_units = [each.unit for each in meaning.signal if each.quantity == "magnetometer"]
    return signals.flight_log(
        field_unit="" if "1" in field_units else None,
        vehicle=meaning.vehicle or None,
        attitude_from_gyro=meaning.attitude_from_gyro,
        torque_unit=torque_units[0] if torque_units else None,
    )


def _find_header(lines: Iterator[str], column: str, where: str, path: Path) -> tuple[list[str], str]:
    """Find the line with the names of the columns; return these, and what is between them."""
    first: list[str] = []
    for line in itertools.islice(lines, FIRST_LINES):
        for delimiter in DELIMITERS:
            names = [name.strip() for row in csv.reader([line], delimiter=delimiter) for name in row]
            if column in names:
                return names, delimiter
            first = first if len(first) >= len(names) else names
    raise BagError(f"{where}: no column '{column}' in {path.name}; columns there: {list_some(first, SHOWN)}")


def _places(names: Sequence[str], meaning: Mapping, mapping: Path, path: Path) -> list[int]:
    """Places of the wanted columns, that of the time first."""
    wanted = [("time", meaning.time.column)]
    for number, signal in enumerate(meaning.signal, 1):
        wanted += [(f"signal {number} ({signal.quantity})", column) for column in signal.columns]
    for where, column in wanted:
        if names.count(column) != 1:
            problem = f"{names.count(column)} columns" if column in names else "no column"
            there = f"columns there: {list_some(names, SHOWN)}"
            raise BagError(f"{mapping}: {where}: {problem} '{column}' in {path.name}; {there}")
    return [names.index(column) for _, column in wanted]


def _numbers(rows: Iterator[list[str]], places: list[int], notes: list[str]) -> Floats:
    """Wanted columns of all rows (n, k), NaN where there is no number; a row may be short."""
    blocks: list[Floats] = [np.empty((0, len(places)))]
    thinning, width, wrong = Thinning(), max(places) + 1, 0
    while block := list(itertools.islice(rows, BLOCK)):
        kept: list[list[str]] = []
        for row in block:
            if row and thinning.keeps():
                whole = row + [""] * (width - len(row))
                kept.append([whole[place].strip() or "nan" for place in places])
        try:
            values = np.array(kept or blocks[0], np.float64)
        except ValueError:
            values = np.array([[_number(cell) for cell in row] for row in kept])
            wrong += int(np.sum(np.isnan(values))) - sum(row.count("nan") for row in kept)
        blocks.append(values)
        if thinning.is_full():
            blocks = [np.concatenate(blocks)[::2].copy()]
    notes += thinning.notes("rows")
    if wrong:
        notes.append(f"{wrong} cells are no numbers; left out")
    return np.concatenate(blocks)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")
