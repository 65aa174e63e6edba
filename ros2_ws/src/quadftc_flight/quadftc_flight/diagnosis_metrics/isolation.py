"""Which axis is blamed for which fault: confusion matrices in seconds, and the isolation accuracy.

Rows are the truth, columns what is declared. Several axes may be declared at once, so the entries of a row
may add up to more than its time, ``time``. The time in which an axis is in the grace after a fault does not
count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from quadftc_flight.diagnosis_metrics.columns import Columns, Mask
from quadftc_flight.diagnosis_metrics.healthy import Truth
from quadftc_flight.diagnosis_metrics.statistics import number
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_model.samples import AXES

NO_AXIS = "none"  # the row of the time without a fault, the column of the time in which nothing is declared
TIME = "time"  # the column of the time of a row

Matrix = dict[str, dict[str, float | None]]


def isolation_metrics(columns: Columns, true: Truth, events: Sequence[FaultEvent]) -> dict[str, Any]:
    """Hold what is declared against what is faulty.

    Parameters
    ----------
    columns : Columns
    true : Truth
    events : sequence of FaultEvent
        For the matrix by kind; those that cannot be judged have times of zero.

    Returns
    -------
    dict
        ``confusion_single_s``: where no other axis is faulty; ``confusion_any_s``: whatever the others are;
        ``confusion_by_kind_s``: whether the faulty axis itself, a healthy one (other), or none is declared;
        ``isolation_tested_s``: how long something is declared while some axes are faulty and others are
        healthy; ``isolation_correct_s``: how long of it no healthy axis is; ``isolation_accuracy``: the
        share.
    """
    counted = np.all(columns.known & (true.faulty | true.healthy), axis=1)
    declared, faulty = columns.declared & counted[:, None], true.faulty & counted[:, None]
    wrong = np.any(declared & ~faulty, axis=1)
    tested = np.any(declared, axis=1) & np.any(faulty, axis=1) & ~np.all(faulty, axis=1)
    total = number(np.sum(tested) * columns.period)
    correct = number(np.sum(tested & ~wrong) * columns.period)
    return {
        "isolation_tested_s": total,
        "isolation_correct_s": correct,
        "isolation_accuracy": accuracy(correct, total),
        **_by_axis(columns, declared, faulty, counted),
        "confusion_by_kind_s": _by_kind(columns, declared, true.faulty, wrong, counted, events),
    }


def accuracy(correct: float | None, tested: float | None) -> float | None:
    """Return the isolation accuracy; None where it was not put to the test."""
    return number(correct / tested) if correct is not None and tested else None


def _by_axis(columns: Columns, declared: Mask, faulty: Mask, counted: Mask) -> dict[str, Matrix]:
    any_faulty = np.sum(faulty, axis=1)
    single: Matrix = {NO_AXIS: _line(columns, declared, counted & (any_faulty == 0))}
    every: Matrix = {}
    for axis, name in enumerate(AXES):
        single[name] = _line(columns, declared, faulty[:, axis] & (any_faulty == 1))
        every[name] = _line(columns, declared, faulty[:, axis])
    return {"confusion_single_s": single, "confusion_any_s": every}


def _line(columns: Columns, declared: Mask, rows: Mask) -> dict[str, float | None]:
    there = declared[rows]
    counts = {
        **{name: np.sum(there[:, axis]) for axis, name in enumerate(AXES)},
        NO_AXIS: np.sum(~np.any(there, axis=1)),
        TIME: len(there),
    }
    return {name: number(count * columns.period) for name, count in counts.items()}


def _by_kind(
    columns: Columns, declared: Mask, faulty: Mask, wrong: Mask, counted: Mask, events: Sequence[FaultEvent]
) -> Matrix:
    counts: dict[str, dict[str, int]] = {}
    for event in events:
        axis, rows = AXES.index(event.axis), columns.rows(event.start, event.stop)
        there = counted[rows] & faulty[rows, axis]
        own, other = declared[rows, axis] & there, wrong[rows] & there
        nothing = there & ~np.any(declared[rows], axis=1)
        line = counts.setdefault(event.kind, {"own": 0, "other": 0, NO_AXIS: 0, TIME: 0})
        for name, mask in zip(line, (own, other, nothing, there), strict=True):
            line[name] += int(np.sum(mask))
    return {
        kind: {name: number(count * columns.period) for name, count in line.items()}
        for kind, line in counts.items()
    }
