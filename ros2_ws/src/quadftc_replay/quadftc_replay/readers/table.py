"""A table (CSV) as a flight log, by a mapping that says what its columns mean.

The columns stand under their names: in the first line that has the name of the column of the time, whatever
comes before. Between them are commas, semicolons, tabs or spaces, as in that line. A cell that is no number
is missing; a signal has the rows in which it has a number. The mapping is a TOML file, with the column of
the time, and one table per signal:

    [time]
    column = "t"
    unit = "us"                      # s, ms, us, ns

    [[signal]]
    quantity = "gyro"                # see `QUANTITIES`
    columns = ["gx", "gy", "gz"]
    unit = "deg/s"
    frame = "frd"                    # axes; flu is taken without it
    name = "2"                       # of another sensor than the main one of its kind

Beside them may stand ``vehicle = "NAME"``, for the layout of the rotors, and ``attitude_from_gyro``, whether
the attitude was computed from this gyro. Commands of rotors in pulses have their ends as ``low``, ``high``.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from quadftc_bags.bag import BagError
from quadftc_model.frames import enu_flu_from_ned_frd, enu_flu_from_ned_frd_angles, enu_from_ned, flu_from_frd
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_model.small_files import read_toml
from quadftc_replay.flight_log import FlightLog, Floats
from quadftc_replay.readers.contents import list_some
from quadftc_replay.readers.signals import DEGREE, NAMED, RPM, Signals
from quadftc_replay.thinning import Thinning

MOST_ROTORS = 16
Turn = Callable[[Floats], Floats]
_RATE = {"rad/s": 1.0, "deg/s": DEGREE, "mrad/s": 1e-3}
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_SPEED = {f"{unit}/s": scale for unit, scale in _LENGTH.items()}
_FORCE = {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
_FIELD = {"mG": 1.0, "G": 1e3, "uT": 10.0, "T": 1e7, "1": 1.0}
_THREE, _ROTORS, _ONE = range(3, 4), range(2, MOST_ROTORS + 1), range(1, 2)
TIME_UNITS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}  # ns
FORMAT = "CSV"
DELIMITERS = ",;\t "
FIRST_LINES = 1000  # in which the names are looked for
LONGEST_LINE = 1 << 20  # characters
BLOCK = 8192  # rows made numbers at a time
LATEST = 2.0**62  # ns
SHOWN = 30  # columns in one line


class Quantity(NamedTuple):
    """What a signal can be."""

    field: str  # of `FlightLog`
    widths: range  # how many columns it has
    units: dict[str, float]  # to SI
    frames: dict[str, Turn]  # into that of `FlightLog`; the first is the default; empty: it has none


def _keep(value: Floats) -> Floats:
    return value


def _attitude_of_ned(value: Floats) -> Floats:
    """Attitude FLU to ENU of one FRD to NED: a quaternion x, y, z, w or roll, pitch, yaw."""
    if value.shape[1] == 4:
        return enu_flu_from_ned_frd(value[:, [3, 0, 1, 2]])
    return enu_flu_from_ned_frd_angles(value)


def _attitude_of_enu(value: Floats) -> Floats:
    return value if value.shape[1] == 4 else quaternion_from_euler(value)


_BODY: dict[str, Turn] = {"flu": _keep, "frd": flu_from_frd}
_EARTH: dict[str, Turn] = {"enu": _keep, "ned": enu_from_ned}
_ATTITUDE: dict[str, Turn] = {"enu": _attitude_of_enu, "ned": _attitude_of_ned}
QUANTITIES = {
    "gyro": Quantity("gyros", _THREE, _RATE, _BODY),
    "accelerometer": Quantity("accelerometers", _THREE, _FORCE, _BODY),
    "magnetometer": Quantity("magnetometers", _THREE, _FIELD, _BODY),
    "barometer": Quantity("barometers", _ONE, _LENGTH, {}),
    "attitude": Quantity("attitude", range(3, 5), {"rad": 1.0, "deg": DEGREE, "1": 1.0}, _ATTITUDE),
    "body_rate": Quantity("body_rate", _THREE, _RATE, _BODY),
    "position": Quantity("position", _THREE, _LENGTH, _EARTH),
    "velocity": Quantity("velocity", _THREE, _SPEED, _EARTH),
    "gps_position": Quantity("gps_positions", _THREE, _LENGTH, _EARTH),
    "gps_velocity": Quantity("gps_velocities", _THREE, _SPEED, _EARTH),
    "acceleration": Quantity("acceleration", _THREE, _FORCE, _EARTH),
    "rotor_speeds": Quantity("rotor_speeds", _ROTORS, {"rad/s": 1.0, "rpm": RPM}, {}),
    "rotor_commands": Quantity("rotor_commands", _ROTORS, {"1": 1.0, "%": 0.01, "us": 1.0}, {}),
    "torque_command": Quantity("torque_command", _THREE, {"N m": 1.0, "1": 1.0}, _BODY),
    "thrust_command": Quantity("thrust_command", _ONE, {"1": 1.0}, {}),
    "battery": Quantity("battery", _ONE, {"V": 1.0, "mV": 0.001}, {}),
}


class _Keys(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class TimeColumn(_Keys):
    """Where the time of a row stands."""

    column: str
    unit: Literal["s", "ms", "us", "ns"] = "s"


class SignalColumns(_Keys):
    """Where a signal stands."""

    quantity: str
    columns: list[str]
    unit: str
    frame: str = ""
    name: str = ""
    low: float | None = None  # command of a rotor without thrust, and of one at full thrust
    high: float | None = None

    def problem(self) -> str:
        """What does not fit together, in words; empty: nothing."""
        if self.quantity not in QUANTITIES:
            return f"quantity '{self.quantity}'; expected one of {', '.join(QUANTITIES)}"
        kind, count = QUANTITIES[self.quantity], len(self.columns)
        if count not in kind.widths:
            least, most = kind.widths.start, kind.widths.stop - 1
            expected = str(least) if least == most else f"{least} to {most}"
            return f"{count} columns of {self.quantity}; expected {expected}"
        units = list(kind.units)
        if self.quantity == "attitude":
            units = ["1"] if count == 4 else ["rad", "deg"]
        if self.unit not in units:
            return f"unit '{self.unit}' of {self.quantity}; expected {', '.join(units)}"
        if self.frame and self.frame not in kind.frames:
            return f"frame '{self.frame}' of {self.quantity}; expected {', '.join(kind.frames) or 'none'}"
        if self.name and kind.field not in NAMED:
            return f"name '{self.name}' of {self.quantity}; only a sensor has one"
        return self._range_problem()

    def _range_problem(self) -> str:
        if self.low is None and self.high is None:
            is_pulse = self.unit == "us"
            return "unit 'us' without low and high, the pulses at no and at full thrust" if is_pulse else ""
        if self.quantity != "rotor_commands":
            return f"low and high of {self.quantity}; only rotor_commands have them"
        if self.low is None or self.high is None or not self.low < self.high:
            return f"low {self.low}, high {self.high}; expected low < high"
        return ""

    def convert(self, value: Floats) -> Floats:
        """Turn the columns (n, k) into SI and the axes of REP-103."""
        kind = QUANTITIES[self.quantity]
        value = value * kind.units[self.unit]
        if self.low is not None and self.high is not None:
            value = np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0)
        return kind.frames[self.frame or next(iter(kind.frames))](value) if kind.frames else value


class Mapping(_Keys):
    """A whole mapping."""

    time: TimeColumn
    signal: list[SignalColumns] = Field(min_length=1)
    vehicle: str = ""
    attitude_from_gyro: bool | None = None


def load_mapping(path: Path) -> Mapping:
    """Read a mapping; a BagError of one line says what is wrong where."""
    try:
        mapping = Mapping.model_validate(read_toml(path))
    except OSError as error:
        raise BagError(f"{path}: {error.strerror or error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(each + 1 if isinstance(each, int) else each) for each in first["loc"])
        raise BagError(f"{path}: {where}: {first['msg'][0].lower()}{first['msg'][1:]}") from None
    except ValueError as error:  # of TOML, and of bytes that are no text
        raise BagError(f"{path}: not a mapping in TOML: {' '.join(str(error).split())}") from None
    taken = set[tuple[str, str]]()
    for number, signal in enumerate(mapping.signal, 1):
        if problem := signal.problem():
            raise BagError(f"{path}: signal {number}: {problem}")
        if (key := (signal.quantity, signal.name)) in taken:
            raise BagError(f"{path}: signal {number}: {' '.join(key).strip()} again; expected each once")
        taken.add(key)
    return mapping


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
