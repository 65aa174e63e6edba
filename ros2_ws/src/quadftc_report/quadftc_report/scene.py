"""What all figures of a comparison share: the look of each run, fault windows, onsets, truth drawn once.

Every sample is here, none decimated: the renderers choose the samples that they draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison
from quadftc_report.description import Envelope, Figure, Mark, Panel, Shade, Trace
from quadftc_report.wording import plain

Floats = NDArray[np.float64]
Run = TypeVar("Run", bound=Recorded)

FAULT_WINDOW = "fault window"  # of the attitude; windows on other channels are named by channel and kind
UPPER = 1.5  # height of a panel with a panel of errors below
_ANGLES = ("angles", "reference", "fault", "fault_estimate", "fault_std_dev")  # columns shown in degrees
_SIGMAS = 2.0  # standard deviations either side of an estimate
_AGREEMENT = 0.99  # share of equal samples from which on the truth of two runs is drawn once
_NOTHING = 1e-9  # in any unit; a smaller number is zero
_INSTANTS = 200  # at which a disturbance is evaluated to see whether it acts on an axis


class Scene(Generic[Run]):
    """The runs of a comparison with their looks, and the windows and moments of each axis."""

    def __init__(self, comparison: Comparison[Run]) -> None:
        self.comparison = comparison
        self.runs = comparison.runs
        self.label = comparison.label
        self.end = max(run.duration for run in self.runs)  # [s]
        self._ranks = {id(run): rank for rank, run in enumerate(comparison.compared)}

    def look(self, run: Recorded) -> tuple[str, int]:
        """Role and rank of a run."""
        rank = self._ranks.get(id(run))
        return ("proposed", 0) if rank is None else ("compared", rank)

    def trace(self, run: Recorded, y: Floats, name: str = "") -> Trace:
        """A line of a run, by default under the run's name."""
        role, rank = self.look(run)
        return Trace(name or self.label(run), role, run.flight.time, y, rank)

    def truth(self, runs: Sequence[Run], column: str, axis: int, name: str) -> list[Trace]:
        """The true values: one line if they are the same in all runs, else (a frozen sensor, say) several."""
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

    def estimates(self, runs: Sequence[Run], column: str, axis: int, name: str) -> list[Trace]:
        """An estimate of each run, with the run's name if there are several."""
        names = [name if len(runs) == 1 else f"{name} ({self.label(run)})" for run in runs]
        columns = [column_of(run, column, axis) for run in runs]
        return [self.trace(*each) for each in zip(runs, columns, names, strict=True)]

    def panel(self, axis: int, traces: Iterable[Trace], y_label: str, unit: str, **others: Any) -> Panel:
        """A panel of an axis, with its fault windows and the onsets of its disturbances."""
        first = self.runs[0]  # faults and disturbances are the same in all
        return Panel(
            title=others.pop("title", AXES[axis]),
            y_label=y_label,
            unit=unit,
            traces=tuple(_split_at_half_turns(trace, unit) for trace in traces if known(trace.y)),
            shades=fault_shades(first, axis, self.end),
            marks=disturbance_marks(first, axis, self.end),
            **others,
        )

    def with_errors(
        self,
        kind: str,
        axis: int,
        texts: tuple[str, str],
        upper: Panel,
        errors: Sequence[Trace],
        **others: Any,
    ) -> Figure:
        """A figure of one axis, with a panel of errors [deg] below if any error is known."""
        lower = self.panel(axis, errors, "error", "deg", title="error", **others)
        panels = [upper, lower] if known(*(trace.y for trace in errors)) else [upper]
        return self.figure(f"{kind}-{AXES[axis]}", *texts, panels)

    def figure(self, kind: str, title: str, caption: str, panels: Sequence[Panel]) -> Figure:
        """A figure; its caption names the runs that end early."""
        cut = [f"{self.label(run)} ends at {plain(run.duration)} s" for run in self.runs if not run.is_whole]
        caption = f"{'; '.join([caption, *cut])}."
        return Figure(f"{self.comparison.key}-{kind}", title, caption, tuple(panels), (0.0, self.end))


def column_of(run: Recorded, column: str, axis: int) -> Floats:
    """Return a column of a flight; angles in degrees."""
    values: Floats = getattr(run.flight, column)[:, axis]
    return np.degrees(values) if column in _ANGLES else values


def difference(run: Recorded, column: str, other: str, axis: int) -> Floats:
    """Return the difference of two angles, wrapped [deg]."""
    found: Floats = getattr(run.flight, column)[:, axis] - getattr(run.flight, other)[:, axis]
    return np.degrees(wrap(found))


def known(*columns: Floats) -> bool:
    """Whether any number is finite."""
    return any(bool(np.any(np.isfinite(column))) for column in columns)


def worth(*columns: Floats) -> bool:
    """Whether any number differs from zero by more than rounding."""
    return any(bool(np.any(np.abs(column) > _NOTHING)) for column in columns)


def envelope(line: Trace, center: Floats | float, deviation: Floats) -> Envelope:
    """Return two standard deviations either side of a line; a gap where the observer gives none."""
    half = np.where(deviation >= 0.0, _SIGMAS * deviation, np.nan)
    return Envelope(f"{line.name} ±{_SIGMAS:g}σ", line.role, line.t, center - half, center + half, line.rank)


def fault_shades(run: Recorded, axis: int, end: float) -> tuple[Shade, ...]:
    """Return the fault windows of an axis up to ``end`` [s], those of the attitude first.

    Windows of one kind that touch become one.
    """
    periods = [
        (FAULT_WINDOW, event.start, event.stop) for event in run.fault_events if event.axis == AXES[axis]
    ]
    names = [f"{fault.injection.channel} {fault.injection.kind}" for fault in run.faults]
    for name, fault in zip(names, run.faults, strict=True):
        injection = fault.injection
        if injection.channel != "attitude" and injection.mask[axis]:
            periods.append((name, injection.start, injection.stop))
    kinds = [FAULT_WINDOW, *sorted({name for name in names if not name.startswith("attitude ")})]
    shades: list[Shade] = []
    for kind, start, stop in sorted(periods, key=lambda period: (kinds.index(period[0]), period[1])):
        last = shades[-1] if shades else None
        if start >= end:
            continue
        if last is not None and last.label == kind and start <= last.stop:
            shades[-1] = last._replace(stop=max(last.stop, min(stop, end)))
        else:
            shades.append(Shade(start, min(stop, end), kind, kinds.index(kind)))
    return tuple(shades)


def disturbance_marks(run: Recorded, axis: int, end: float) -> tuple[Mark, ...]:
    """Return the onsets of the disturbances of an axis before ``end`` [s], and their ends before it."""
    laws = [part.law for part in run.disturbances if part.law.start < end]
    label = "disturbance on, off" if any(law.stop < end for law in laws) else "disturbance onset"
    acting = [law for law in laws if _acts(law, axis, min(law.stop, end))]
    times = {law.start for law in acting} | {law.stop for law in acting if law.stop < end}
    return tuple(Mark(time, label) for time in sorted(times))


def _acts(law: Any, axis: int, stop: float) -> bool:
    """Whether a disturbance gives a torque about an axis between its start and ``stop`` [s]."""
    times = law.start + np.arange(_INSTANTS) / _INSTANTS * (stop - law.start)
    return any(float(law.torque(time)[axis]) != 0.0 for time in times)


def _agree(run: Recorded, other: Recorded, column: str, axis: int) -> bool:
    """Whether a truth is the same in a run and in a longer one, but for a few samples (steps, jitter)."""
    values, others = column_of(run, column, axis), column_of(other, column, axis)
    nearest = np.searchsorted(other.flight.time, run.flight.time).clip(0, len(others) - 1)
    off = np.abs(values - others[nearest])
    there = others[np.isfinite(others)]
    extent = float(np.ptp(there)) if len(there) else 0.0
    return float(np.mean((off <= 1e-3 * extent) | ~np.isfinite(off))) >= _AGREEMENT


def _split_at_half_turns(trace: Trace, unit: str) -> Trace:
    """Put a gap, not a stroke, where an angle [deg] goes through half a turn."""
    jumps = np.flatnonzero(np.abs(np.diff(trace.y)) > 180.0) + 1
    if unit != "deg" or len(jumps) == 0:
        return trace
    t, y = np.insert(trace.t, jumps, trace.t[jumps]), np.insert(trace.y, jumps, np.nan)
    return dataclasses.replace(trace, t=t, y=y)
