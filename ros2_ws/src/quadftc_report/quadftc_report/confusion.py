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


def confusions(times: Iterable[tuple[str, Times]], columns: Sequence[str] = COLUMNS) -> list[Confusion]:
    """Return matrices by their labels and times [s], or times of each axis, by what is faulty and claim.

    Those without any time are left out, and of rotors those in which none is ever faulty.
    """
    found: list[Confusion] = []
    for label, matrix in times:
        rows: dict[str, tuple[str, Sequence[Cell]]] = {}
        for true, row in matrix.items():
            said = {claim: _total(time) for claim, time in row.items()}
            if time := said[TIME]:
                cells = [_cell(true, claim, said[claim] / time) for claim in columns]
                rows[true] = (f"{plain(time)} s", cells)
        if rows and (columns == COLUMNS or "rotor" in rows):
            found.append(Confusion(label, rows))
    return found


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
