"""What all figures of a comparison share: the look of each run, fault windows, onsets, truth drawn once.

Every sample is here, none decimated: the renderers choose the samples that they draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.fault_schedule import attitude_events
from quadftc_flight.flight import NO_STATE
from quadftc_flight.live_run import LiveRun
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import Recorded
from quadftc_report.comparison import Comparison, Run_co
from quadftc_report.description import Envelope, Figure, Mark, Panel, Shade, Trace
from quadftc_report.wording import plain
from quadftc_sim.disturbance import Disturbance
from quadftc_sim.rotor_fault import ROTOR

Floats = NDArray[np.float64]

FAULT_WINDOW = "fault window"  # of the attitude; windows on other channels are named by channel and kind
_ANGLES = ("angles", "reference", "fault", "fault_estimate", "fault_std_dev")  # columns shown in degrees
_SIGMAS = 2.0  # standard deviations either side of an estimate
_AGREEMENT = 0.99  # share of equal samples from which on the truth of two runs is drawn once
_NOTHING = 1e-9  # in any unit; a smaller number is zero
_INSTANTS = 200  # at which a disturbance is evaluated to see whether it acts on an axis


class Scene(Generic[Run_co]):
    """The runs of a comparison with their looks, and the windows and moments of each axis."""

    def __init__(self, comparison: Comparison[Run_co]) -> None:
        self.key = comparison.key
        self.runs = comparison.runs
        self.longest = comparison.longest
        self.label = comparison.label
        self.end = max(run.duration for run in self.runs)  # [s]
        compared = [run for run in self.runs if run is not comparison.proposed]
        self._ranks = {id(run): rank for rank, run in enumerate(compared)}

    def look(self, run: Recorded) -> tuple[str, int]:
        """Role and rank of a run."""
        rank = self._ranks.get(id(run))
        return ("proposed", 0) if rank is None else ("compared", rank)

    def trace(self, run: Recorded, y: Floats, name: str = "") -> Trace:
        """A line of a run, by default under the run's name."""
        role, rank = self.look(run)
        return Trace(name or self.label(run), role, run.flight.time, y, rank)

    def lines(
        self, runs: Sequence[Recorded], column: str, axis: int, name: str = "", less: str = ""
    ) -> list[Trace]:
        """A column of each run, less another one; under its ``name`` alone if there is one run."""
        names = {id(run): f"{name} ({self.label(run)})" if len(runs) > 1 and name else name for run in runs}
        return [self.trace(run, column_of(run, column, axis, less), names[id(run)]) for run in runs]

    def truth(self, runs: Sequence[Recorded], column: str, axis: int, name: str) -> list[Trace]:
        """The true values: one line if they are the same in all runs, else (a frozen sensor, say) several."""
        first, *rest = sorted(runs, key=lambda run: -np.sum(np.isfinite(column_of(run, column, axis))))
        others = [run for run in rest if not _agree(run, first, column, axis)]
        role = "reference" if column == "reference" else "truth"
        shown = self.lines([first, *others], column, axis, name)
        return [dataclasses.replace(line, role=role, rank=rank) for rank, line in enumerate(shown)]

    def panel(self, axis: int, traces: Iterable[Trace], quantity: str, unit: str, **others: Any) -> Panel:
        """A panel of a quantity of an axis, with its fault windows and the onsets of its disturbances."""
        first = self.runs[0]  # faults and disturbances are the same in all
        shown = tuple(_split_at_half_turns(trace, unit) for trace in traces if known(trace.y))
        mine: dict[str, Any] = {
            "title": AXES[axis],
            "y_label": f"{AXES[axis]} {quantity}".strip(),
            "shades": fault_shades(first, axis, self.end),
            "marks": disturbance_marks(first, axis, self.end),
        }
        return Panel(traces=shown, unit=unit, **{**mine, **others})

    def figure(self, kind: str, title: str, caption: str, panels: Iterable[Panel]) -> Figure:
        """A figure of those panels that show anything; its caption names the runs that end early."""
        cut = [f"{self.label(run)} ends at {plain(run.duration)} s" for run in self.runs if not run.is_whole]
        shown = tuple(panel for panel in panels if panel.traces)
        return Figure(f"{self.key}-{kind}", title, f"{'; '.join([caption, *cut])}.", shown, (0.0, self.end))


def column_of(run: Recorded, column: str, axis: int, less: str = "") -> Floats:
    """Return a column (n,) of a flight, less another one; angles in degrees, their differences wrapped."""
    values: Floats = getattr(run.flight, column)[:, axis]
    if column.endswith("_state"):
        return np.where(values == NO_STATE, np.nan, values)
    if less:
        values = np.asarray(wrap(values - getattr(run.flight, less)[:, axis]))
    return np.degrees(values) if column in _ANGLES else values


def known(*columns: Floats) -> bool:
    """Whether any number is finite."""
    return any(bool(np.any(np.isfinite(column))) for column in columns)


def worth(*columns: Floats) -> bool:
    """Whether any number differs from zero by more than rounding."""
    return any(bool(np.any(np.abs(column) > _NOTHING)) for column in columns)


def envelopes(
    lines: Sequence[Trace], runs: Sequence[Recorded], column: str, axis: int, about_zero: bool = False
) -> tuple[Envelope, ...]:
    """Return two standard deviations, a ``column`` of each run, either side of its line or of zero.

    There is a gap where the observer gives none, and no envelope where it never does.
    """
    found: list[Envelope] = []
    for line, run in zip(lines, runs, strict=True):
        deviation = column_of(run, column, axis)
        half = np.where(deviation >= 0.0, _SIGMAS * deviation, np.nan)
        if known(half):
            center = np.zeros_like(line.y) if about_zero else line.y
            name = f"{line.name} ±{_SIGMAS:g}σ"
            found.append(Envelope(name, line.role, line.t, center - half, center + half, line.rank))
    return tuple(found)


def fault_shades(run: Recorded, axis: int, end: float) -> tuple[Shade, ...]:
    """Return the fault windows of an axis up to ``end`` [s], those of the attitude first.

    A fault of a rotor moves the vehicle about all axes. Windows of one kind that touch become one.
    """
    others = [each.injection for each in run.faults if each.injection.channel != "attitude"]
    named = [(f"{each.channel} {each.kind}", each) for each in others]
    kinds = [FAULT_WINDOW, *sorted({name for name, _ in named})]
    events = attitude_events(run.fault_events)
    periods = [(0, each.start, each.stop) for each in events if each.axis == AXES[axis]]
    periods += [
        (kinds.index(name), each.start, each.stop)
        for name, each in named
        if each.channel == ROTOR or each.mask[axis]
    ]
    if isinstance(run, LiveRun):
        periods += [(0, each.start, each.stop) for each in run.rotor_events]
    return _merged(periods, kinds, end)


def rotor_shades(run: Recorded, rotor: int, end: float) -> tuple[Shade, ...]:
    """Return the fault windows of a rotor, counted from 0, up to ``end`` [s]."""
    faults = [each.injection for each in run.faults if each.injection.channel == ROTOR]
    kinds = [FAULT_WINDOW, *sorted({f"{ROTOR} {each.kind}" for each in faults})]
    acting = [each for each in faults if each.mask[rotor]]
    periods = [(kinds.index(f"{ROTOR} {each.kind}"), each.start, each.stop) for each in acting]
    if isinstance(run, LiveRun):
        periods += [(0, each.start, each.stop) for each in run.rotor_events if each.axis == str(rotor + 1)]
    return _merged(periods, kinds, end)


def _merged(periods: list[tuple[int, float, float]], kinds: Sequence[str], end: float) -> tuple[Shade, ...]:
    """Return windows of time by their kinds, cut at ``end`` [s]; those of one kind that touch become one."""
    shades: list[Shade] = []
    for rank, start, stop in sorted(periods):
        last = shades[-1] if shades else None
        if last is not None and last.rank == rank and start <= last.stop:
            shades[-1] = last._replace(stop=max(last.stop, min(stop, end)))
        elif start < end:
            shades.append(Shade(start, min(stop, end), kinds[rank], rank))
    return tuple(shades)


def disturbance_marks(run: Recorded, axis: int, end: float) -> tuple[Mark, ...]:
    """Return the onsets of the disturbances of an axis before ``end`` [s], and their ends before it."""
    laws = [part.law for part in run.disturbances if part.law.start < end]
    label = "disturbance on, off" if any(law.stop < end for law in laws) else "disturbance onset"
    acting = [law for law in laws if _acts(law, axis, min(law.stop, end))]
    times = {law.start for law in acting} | {law.stop for law in acting if law.stop < end}
    return tuple(Mark(time, label) for time in sorted(times))


def _acts(law: Disturbance, axis: int, stop: float) -> bool:
    """Whether a disturbance gives a torque about an axis between its start and ``stop`` [s]."""
    times = law.start + np.arange(_INSTANTS) / _INSTANTS * (stop - law.start)
    return any(float(law.at(time)[axis]) != 0.0 for time in times)


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
