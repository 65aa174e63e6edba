"""The confusion matrices of a diagnosis: what is faulty, against what is named."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from quadftc_flight.diagnosis_metrics.which_rotor import SAID as SAID_OF_ROTORS
from quadftc_flight.diagnosis_metrics.which_sensor import AMBIGUOUS, NOTHING, SAID, TIME
from quadftc_report.wording import NOTHING as EMPTY
from quadftc_report.wording import plain

COLUMNS = tuple(said for said in SAID if said != TIME)
ROTOR_COLUMNS = tuple(said for said in SAID_OF_ROTORS if said != TIME)
CAPTION = "Which sensor is named, by the one that is faulty: share of the time of its axes."
ROTOR_CAPTION = "Whether a rotor, a sensor or nothing is named, by what is faulty: share of the time."
Times = Mapping[str, Mapping[str, float | Mapping[str, float | None] | None]]  # [s], by fault and claim
_RIGHT = {"rotor": "faulty_rotor"}  # what is right to say, if it is not the name of what is faulty


class Cell(NamedTuple):
    """A share of the time of a row."""

    text: str
    share: float
    look: str  # CSS class: right, unsure, wrong


class Confusion(NamedTuple):
    """What one run or variant said: by the faulty sensor, the time of all axes and a cell for each claim."""

    label: str
    rows: Mapping[str, tuple[str, Sequence[Cell]]]


class ConfusionTable(NamedTuple):
    """The matrices of runs or variants, one below the other."""

    id: str  # in the page
    caption: str
    columns: Sequence[str]
    matrices: Sequence[Confusion]


def confusion_tables(said: Iterable[tuple[str, Times, Times]]) -> list[ConfusionTable]:
    """Return the tables of sensors and of rotors, by label and what is said of each, in times [s].

    Those without any time are left out, and of rotors those in which none is ever faulty.
    """
    sensors, rotors = list[Confusion](), list[Confusion]()
    for label, of_sensors, of_rotors in said:
        if rows := _rows(of_sensors, COLUMNS):
            sensors.append(Confusion(label, rows))
        if "rotor" in (rows := _rows(of_rotors, ROTOR_COLUMNS)):
            rotors.append(Confusion(label, rows))
    tables = (
        ConfusionTable("confusion", CAPTION, COLUMNS, sensors),
        ConfusionTable("rotor-confusion", ROTOR_CAPTION, ROTOR_COLUMNS, rotors),
    )
    return [table for table in tables if table.matrices]


def _rows(times: Times, columns: Sequence[str]) -> dict[str, tuple[str, Sequence[Cell]]]:
    """Return time and cells of each thing that was faulty for some time."""
    rows: dict[str, tuple[str, Sequence[Cell]]] = {}
    for true, row in times.items():
        said = {claim: _total(time) for claim, time in row.items()}
        if time := said[TIME]:
            rows[true] = (f"{plain(time)} s", [_cell(true, claim, said[claim] / time) for claim in columns])
    return rows


def _total(time: float | Mapping[str, float | None] | None) -> float:
    """Return a time, or that of all axes [s]; what is not known counts as none."""
    return sum(each or 0.0 for each in time.values()) if isinstance(time, Mapping) else time or 0.0


def _cell(true: str, claim: str, share: float) -> Cell:
    missed = claim == NOTHING and true != NOTHING
    look = (
        "right" if claim == _RIGHT.get(true, true) else "unsure" if claim == AMBIGUOUS or missed else "wrong"
    )
    percent = 100.0 * share
    text = EMPTY if share == 0.0 else "below 0.01 %" if percent < 0.01 else f"{plain(percent)} %"
    return Cell(text, share, look)
