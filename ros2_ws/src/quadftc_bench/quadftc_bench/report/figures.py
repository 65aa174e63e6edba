"""The figures of a report, described without drawing them: what is in each panel, in the unit it is shown in.

| key | panels | figures of Wang, Huang and Zhang (2021) |
|---|---|---|
| fault-<axis> | fault and its estimates; errors of the estimates | 3 to 5 |
| tracking-<axis> | reference and angle of each run; tracking errors | 6 to 14 |
| disturbance | disturbance and its estimates, a panel for each axis | |
| sliding_variable | S and its boundary layer, a panel for each axis | |
| torque | torque command, a panel for each axis | |

Every sample is here, none decimated: the renderers choose what they draw. A figure without data is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_bench.flight import AXES
from quadftc_bench.recorded_run import RecordedRun
from quadftc_bench.report import captions
from quadftc_bench.report.comparison import NO_OBSERVER, Comparison, has_observer
from quadftc_bench.report.description import Band, Envelope, Figure, Panel, Trace
from quadftc_bench.report.timeline import marks, shades
from quadftc_bench.report.wording import plain
from quadftc_model.rotations import wrap

Floats = NDArray[np.float64]

PAPER_FIGURES = {
    ("paper_faults", "fault"): (3, 4, 5),
    ("paper_faults", "tracking"): (6, 7, 8),
    ("paper_constant_disturbance", "tracking"): (9, 10, 11),
    ("paper_varying_disturbance", "tracking"): (12, 13, 14),
}  # scenario and kind of figure -> numbers in the paper for roll, pitch, yaw
ANGLES = ("angles", "reference", "fault", "fault_estimate", "fault_std_dev")  # columns shown in degrees
SIGMAS = 2.0  # standard deviations either side that are shown of an estimate
AGREEMENT = 0.99  # share of samples in which the truth of two runs has to be the same to be drawn once
UPPER = 1.5  # height of a panel with a panel of errors below
NOTHING = 1e-9  # in any unit; what is smaller is zero
IN_VIEW = 0.5  # share of a limit that the torque has to come up to before the limit is drawn


def figures(comparison: Comparison) -> list[Figure]:
    """Describe every figure for which there is data, in the order of the table above."""
    scene = _Scene(comparison)
    axes = range(len(AXES))
    found = [
        *(_fault(scene, axis) for axis in axes),
        *(_tracking(scene, axis) for axis in axes),
        _disturbance(scene),
        _sliding_variable(scene),
        _torque(scene),
    ]
    return [figure for figure in found if figure is not None]


class _Scene:
    """What the figures of a comparison share."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        self.runs = comparison.runs
        self.label = comparison.label
        self.end = max(run.duration for run in self.runs)  # [s]
        self._ranks = {id(run): rank for rank, run in enumerate(comparison.compared)}

    def trace(self, run: RecordedRun, y: Floats, name: str = "") -> Trace:
        """A line of a run; named by the run if no name is given."""
        role, rank = self.look(run)
        return Trace(name or self.label(run), role, run.flight.time, y, rank)

    def look(self, run: RecordedRun) -> tuple[str, int]:
        """Role and rank of a run."""
        rank = self._ranks.get(id(run))
        return ("proposed", 0) if rank is None else ("compared", rank)

    def truth(self, runs: Sequence[RecordedRun], column: str, axis: int, name: str) -> list[Trace]:
        """What is true: one line if it is the same in all runs, else (a frozen sensor, say) one for each."""
        first, *rest = sorted(runs, key=lambda run: -np.sum(np.isfinite(_column(run, column, axis))))
        others = [run for run in rest if not _agree(run, first, column, axis)]
        role = "reference" if column == "reference" else "truth"
        return [
            Trace(
                f"{name} ({self.label(run)})" if others else name,
                role,
                run.flight.time,
                _column(run, column, axis),
                rank,
            )
            for rank, run in enumerate([first, *others])
        ]

    def estimates(self, runs: Sequence[RecordedRun], column: str, axis: int, name: str) -> list[Trace]:
        """An estimate of each run; with the run's name if there are several."""
        names = [name if len(runs) == 1 else f"{name} ({self.label(run)})" for run in runs]
        return [
            self.trace(run, _column(run, column, axis), name) for run, name in zip(runs, names, strict=True)
        ]

    def panel(self, axis: int, traces: Sequence[Trace], y_label: str, unit: str, **others: Any) -> Panel:
        """A panel of an axis, with its fault windows and the onsets of its disturbances."""
        scenario = self.comparison.scenario
        return Panel(
            title=others.pop("title", AXES[axis]),
            y_label=y_label,
            unit=unit,
            traces=tuple(_unwound(trace, unit) for trace in traces if _known(trace.y)),
            shades=shades(scenario, axis, self.end),
            marks=marks(scenario, axis, self.end),
            **others,
        )

    def figure(
        self, kind: str, title: str, caption: str, panels: Sequence[Panel], axis: int | None = None
    ) -> Figure:
        """A figure, of one axis or of all."""
        key = f"{self.comparison.key}-{kind}"
        numbers: tuple[int, ...] = ()
        if axis is not None:
            key += f"-{AXES[axis]}"
            numbers = PAPER_FIGURES.get((self.comparison.scenario.name, kind), ())[axis : axis + 1]
        cut = [f"{self.label(run)} ends at {plain(run.duration)} s" for run in self.runs if not run.is_whole]
        caption = "; ".join([caption.removesuffix("."), *cut]) + "."
        return Figure(key, title, caption, tuple(panels), (0.0, self.end), numbers)


def _fault(scene: _Scene, axis: int) -> Figure | None:
    """The fault of an axis, its estimates, and their errors."""
    name = AXES[axis]
    runs = [run for run in scene.runs if has_observer(run) and _known(run.flight.fault_estimate)]
    truth = scene.truth(runs or scene.runs, "fault", axis, "true fault")
    estimates = scene.estimates(runs, "fault_estimate", axis, "estimate")
    if not _worth([*truth, *estimates]):
        return None
    errors = [_difference(run, "fault_estimate", "fault", axis) for run in runs]
    lines = [dataclasses.replace(line, y=error) for line, error in zip(estimates, errors, strict=True)]
    deviations = [_column(run, "fault_std_dev", axis) for run in runs]
    spreads = [pair for pair in zip(estimates, deviations, strict=True) if np.any(pair[1] >= 0.0)]
    around = tuple(_spread(line, line.y, deviation) for line, deviation in spreads)
    around_zero = tuple(_spread(line, 0.0, deviation) for line, deviation in spreads)
    upper = {"title": "fault", "envelopes": around, "height": UPPER}
    lower = {"title": "error", "envelopes": around_zero}
    panels = [scene.panel(axis, [*truth, *estimates], f"{name} fault", "deg", **upper)]
    if _known(*errors):
        panels.append(scene.panel(axis, lines, "error", "deg", **lower))
    found = [(scene.label(run), error) for run, error in zip(runs, errors, strict=True)]
    caption = captions.fault(name, panels[0].shades, panels[0].marks, found)
    return scene.figure("fault", f"{name.capitalize()} fault and its estimate", caption, panels, axis)


def _tracking(scene: _Scene, axis: int) -> Figure | None:
    """Reference and angle of each run, and the tracking errors."""
    name = AXES[axis]
    reference = scene.truth(scene.runs, "reference", axis, "reference")
    angles = [scene.trace(run, _column(run, "angles", axis)) for run in scene.runs]
    errors = [_difference(run, "angles", "reference", axis) for run in scene.runs]
    if not _known(*errors):
        return None
    lines = [dataclasses.replace(line, y=error) for line, error in zip(angles, errors, strict=True)]
    panels = [
        scene.panel(axis, [*reference, *angles], f"{name} angle", "deg", height=UPPER),
        scene.panel(axis, lines, "error", "deg", title="error"),
    ]
    found = [(scene.label(run), error) for run, error in zip(scene.runs, errors, strict=True)]
    caption = captions.tracking(name, panels[0].shades, panels[0].marks, found)
    return scene.figure("tracking", f"{name.capitalize()} tracking", caption, panels, axis)


def _disturbance(scene: _Scene) -> Figure | None:
    """The disturbance and its estimates, a panel for each axis."""
    runs = [
        run
        for run in scene.runs
        if run.scheme.disturbance_observer.kind != NO_OBSERVER and _known(run.flight.disturbance_estimate)
    ]
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        truth = scene.truth(runs or scene.runs, "disturbance", axis, "disturbance d")
        estimates = scene.estimates(runs, "disturbance_estimate", axis, "estimate of d")
        panels.append(scene.panel(axis, [*truth, *estimates], f"{name} d", "rad/s²"))
    if not _worth([trace for panel in panels for trace in panel.traces]):
        return None
    errors = [(scene.label(run), run.flight.disturbance_estimate - run.flight.disturbance) for run in runs]
    caption = captions.disturbance([mark for panel in panels for mark in panel.marks], errors)
    return scene.figure("disturbance", "Disturbance and its estimate", caption, panels)


def _sliding_variable(scene: _Scene) -> Figure | None:
    """S of each run that has one, with its boundary layer, a panel for each axis."""
    runs = [run for run in scene.runs if np.any(np.abs(run.flight.sliding_variable) > NOTHING)]
    if not runs:
        return None
    layers = [(run, layer) for run in runs if (layer := _boundary_layer(run)) is not None]
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        lines = [scene.trace(run, run.flight.sliding_variable[:, axis]) for run in runs]
        bands = tuple(
            Band(-layer[axis], layer[axis], f"±Φ ({scene.label(run)})", *scene.look(run))
            for run, layer in layers
        )
        panels.append(scene.panel(axis, lines, f"{name} S", "rad/s", bands=bands))
    inside = [(scene.label(run), _share_inside(run.flight.sliding_variable, layer)) for run, layer in layers]
    caption = captions.sliding_variable(inside)
    return scene.figure("sliding_variable", "Sliding variable and its boundary layer", caption, panels)


def _torque(scene: _Scene) -> Figure | None:
    """Torque command of each run, a panel for each axis, with the limits where they are near."""
    runs = [run for run in scene.runs if _known(run.flight.torque)]
    if not runs:
        return None
    authority: Floats = runs[0].scheme.controller.law.vehicle.authority
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        limit = float(authority[axis])
        near = max(float(np.nanmax(np.abs(run.flight.torque[:, axis]))) for run in runs) > IN_VIEW * limit
        bands = (Band(-limit, limit, "limits of the rotors", "limit"),) if near else ()
        lines = [scene.trace(run, run.flight.torque[:, axis]) for run in runs]
        panels.append(scene.panel(axis, lines, f"{name} torque", "N m", bands=bands))
    caption = captions.torque([(scene.label(run), run.flight.torque) for run in runs], authority)
    return scene.figure("torque", "Torque command", caption, panels)


def _column(run: RecordedRun, column: str, axis: int) -> Floats:
    """A column of a flight; angles in degrees."""
    values: Floats = getattr(run.flight, column)[:, axis]
    return np.degrees(values) if column in ANGLES else values


def _difference(run: RecordedRun, column: str, other: str, axis: int) -> Floats:
    """The difference of two angles, wrapped [deg]."""
    flight = run.flight
    difference: Floats = getattr(flight, column)[:, axis] - getattr(flight, other)[:, axis]
    return np.degrees(wrap(difference))


def _agree(run: RecordedRun, other: RecordedRun, column: str, axis: int) -> bool:
    """Whether a truth is the same in a run and in a longer one, but for a few samples (steps, jitter)."""
    values, others = _column(run, column, axis), _column(other, column, axis)
    nearest = np.searchsorted(other.flight.time, run.flight.time).clip(0, len(others) - 1)
    difference = np.abs(values - others[nearest])
    same = (difference <= 1e-3 * _range(others)) | ~np.isfinite(difference)
    return float(np.mean(same)) >= AGREEMENT


def _range(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def _spread(line: Trace, center: Floats | float, deviation: Floats) -> Envelope:
    """Two standard deviations either side of a line; a gap where the observer gives none."""
    half = np.where(deviation >= 0.0, SIGMAS * deviation, np.nan)
    low, high = center - half, center + half
    return Envelope(f"{line.name} ±{SIGMAS:g}σ", line.role, line.t, low, high, line.rank)


def _unwound(trace: Trace, unit: str) -> Trace:
    """An angle [deg] with a gap, not a stroke, where it goes through half a turn; others as they are."""
    jumps = np.flatnonzero(np.abs(np.diff(trace.y)) > 180.0) + 1
    if unit != "deg" or len(jumps) == 0:
        return trace
    return dataclasses.replace(
        trace, t=np.insert(trace.t, jumps, trace.t[jumps]), y=np.insert(trace.y, jumps, np.nan)
    )


def _boundary_layer(run: RecordedRun) -> tuple[float, ...] | None:
    """Phi of the run's controller on each axis [rad/s]; None if it has none."""
    phi: Any = getattr(run.scheme.controller.law, "phi", None)
    return None if phi is None else tuple(np.broadcast_to(np.asarray(phi, np.float64), len(AXES)).tolist())


def _share_inside(surface: Floats, layer: Sequence[float]) -> float:
    """Share of the samples in which S is within its layer on every axis."""
    known = surface[np.all(np.isfinite(surface), axis=1)]
    inside: NDArray[np.bool_] = np.all(np.abs(known) <= np.asarray(layer), axis=1)
    return float(np.mean(inside))


def _known(*columns: Floats) -> bool:
    """Whether there is a number in any of them."""
    return any(bool(np.any(np.isfinite(column))) for column in columns)


def _worth(traces: Iterable[Trace]) -> bool:
    """Whether a line has anything to show: a number other than zero, but for rounding."""
    return any(bool(np.any(np.abs(trace.y) > NOTHING)) for trace in traces)
