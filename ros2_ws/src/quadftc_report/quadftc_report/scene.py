"""What the figures of recordings side by side share: who looks how, windows and moments, truth drawn once.

Every sample is here, none decimated: the renderers choose what they draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import SideBySide
from quadftc_report.description import Envelope, Figure, Panel, Trace
from quadftc_report.timeline import marks, shades
from quadftc_report.wording import plain

Floats = NDArray[np.float64]
Item = TypeVar("Item", bound=Recorded)

ANGLES = ("angles", "reference", "fault", "fault_estimate", "fault_std_dev")  # columns shown in degrees
UPPER = 1.5  # height of a panel with a panel of errors below

_SIGMAS = 2.0  # standard deviations either side that are shown of an estimate
_AGREEMENT = 0.99  # share of samples in which the truth of two runs has to be the same to be drawn once
_NOTHING = 1e-9  # in any unit; what is smaller is zero


class Scene(Generic[Item]):
    """What the figures of a comparison share."""

    def __init__(self, comparison: SideBySide[Item]) -> None:
        self.comparison = comparison
        self.runs = comparison.runs
        self.label = comparison.label
        self.end = max(run.duration for run in self.runs)  # [s]
        self._ranks = {id(run): rank for rank, run in enumerate(comparison.compared)}

    def trace(self, run: Recorded, y: Floats, name: str = "") -> Trace:
        """A line of a run; named by the run if no name is given."""
        role, rank = self.look(run)
        return Trace(name or self.label(run), role, run.flight.time, y, rank)

    def look(self, run: Recorded) -> tuple[str, int]:
        """Role and rank of a run."""
        rank = self._ranks.get(id(run))
        return ("proposed", 0) if rank is None else ("compared", rank)

    def truth(self, runs: Sequence[Item], column: str, axis: int, name: str) -> list[Trace]:
        """What is true: one line if it is the same in all runs, else (a frozen sensor, say) one for each."""
        first, *rest = sorted(runs, key=lambda run: -np.sum(np.isfinite(column_of(run, column, axis))))
        others = [run for run in rest if not _agree(run, first, column, axis)]
        role = "reference" if column == "reference" else "truth"
        return [
            Trace(
                f"{name} ({self.label(run)})" if others else name,
                role,
                run.flight.time,
                column_of(run, column, axis),
                rank,
            )
            for rank, run in enumerate([first, *others])
        ]

    def estimates(self, runs: Sequence[Item], column: str, axis: int, name: str) -> list[Trace]:
        """An estimate of each run; with the run's name if there are several."""
        names = [name if len(runs) == 1 else f"{name} ({self.label(run)})" for run in runs]
        return [
            self.trace(run, column_of(run, column, axis), name) for run, name in zip(runs, names, strict=True)
        ]

    def panel(self, axis: int, traces: Sequence[Trace], y_label: str, unit: str, **others: Any) -> Panel:
        """A panel of an axis, with its fault windows and the onsets of its disturbances."""
        first = self.runs[0]  # what happened is the same in all
        return Panel(
            title=others.pop("title", AXES[axis]),
            y_label=y_label,
            unit=unit,
            traces=tuple(_unwound(trace, unit) for trace in traces if known(trace.y)),
            shades=shades(first.faults, first.fault_events, axis, self.end),
            marks=marks(first.disturbances, axis, self.end),
            **others,
        )

    def figure(
        self, kind: str, title: str, caption: str, panels: Sequence[Panel], axis: int | None = None
    ) -> Figure:
        """A figure, of one axis or of all."""
        key = f"{self.comparison.key}-{kind}" + (f"-{AXES[axis]}" if axis is not None else "")
        cut = [f"{self.label(run)} ends at {plain(run.duration)} s" for run in self.runs if not run.is_whole]
        caption = "; ".join([caption.removesuffix("."), *cut]) + "."
        return Figure(key, title, caption, tuple(panels), (0.0, self.end))


def column_of(run: Recorded, column: str, axis: int) -> Floats:
    """A column of a flight; angles in degrees."""
    values: Floats = getattr(run.flight, column)[:, axis]
    return np.degrees(values) if column in ANGLES else values


def difference(run: Recorded, column: str, other: str, axis: int) -> Floats:
    """The difference of two angles, wrapped [deg]."""
    flight = run.flight
    found: Floats = getattr(flight, column)[:, axis] - getattr(flight, other)[:, axis]
    return np.degrees(wrap(found))


def _agree(run: Recorded, other: Recorded, column: str, axis: int) -> bool:
    """Whether a truth is the same in a run and in a longer one, but for a few samples (steps, jitter)."""
    values, others = column_of(run, column, axis), column_of(other, column, axis)
    nearest = np.searchsorted(other.flight.time, run.flight.time).clip(0, len(others) - 1)
    difference = np.abs(values - others[nearest])
    same = (difference <= 1e-3 * _range(others)) | ~np.isfinite(difference)
    return float(np.mean(same)) >= _AGREEMENT


def _range(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def spread(line: Trace, center: Floats | float, deviation: Floats) -> Envelope:
    """Two standard deviations either side of a line; a gap where the observer gives none."""
    half = np.where(deviation >= 0.0, _SIGMAS * deviation, np.nan)
    low, high = center - half, center + half
    return Envelope(f"{line.name} ±{_SIGMAS:g}σ", line.role, line.t, low, high, line.rank)


def _unwound(trace: Trace, unit: str) -> Trace:
    """An angle [deg] with a gap, not a stroke, where it goes through half a turn; others as they are."""
    jumps = np.flatnonzero(np.abs(np.diff(trace.y)) > 180.0) + 1
    if unit != "deg" or len(jumps) == 0:
        return trace
    return dataclasses.replace(
        trace, t=np.insert(trace.t, jumps, trace.t[jumps]), y=np.insert(trace.y, jumps, np.nan)
    )


def known(*columns: Floats) -> bool:
    """Whether there is a number in any of them."""
    return any(bool(np.any(np.isfinite(column))) for column in columns)


def worth(*columns: Floats) -> bool:
    """Whether there is anything to show in any of them: a number other than zero, but for rounding."""
    return any(bool(np.any(np.abs(column) > _NOTHING)) for column in columns)
