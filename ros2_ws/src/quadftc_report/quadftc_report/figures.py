"""The figures of a report, described without drawing them: what is in each panel, in the unit it is shown in.

| key | panels | figures of Wang, Huang and Zhang (2021) |
|---|---|---|
| fault-<axis> | fault and its estimates; errors of the estimates | 3 to 5 |
| state | state of the diagnosis, a panel for each axis | |
| tracking-<axis> | reference and angle of each run; tracking errors | 6 to 14 |
| disturbance | disturbance and its estimates, a panel for each axis | |
| sliding_variable | S and its boundary layer, a panel for each axis | |
| torque | torque command, a panel for each axis | |

Every sample is here, none decimated: the renderers choose what they draw. A figure without data is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_model.samples import AXES
from quadftc_report import captions
from quadftc_report.comparison import Comparison
from quadftc_report.description import Band, Figure, Panel
from quadftc_report.diagnosis_figures import fault_figure, state_figure
from quadftc_report.scene import UPPER, Scene, column_of, difference, known, worth

Floats = NDArray[np.float64]
FlightScene = Scene[RecordedRun]

PAPER_FIGURES = {
    ("paper_faults", "fault"): (3, 4, 5),
    ("paper_faults", "tracking"): (6, 7, 8),
    ("paper_constant_disturbance", "tracking"): (9, 10, 11),
    ("paper_varying_disturbance", "tracking"): (12, 13, 14),
}  # scenario and kind of figure -> numbers in the paper for roll, pitch, yaw
IN_VIEW = 0.5  # share of a limit that the torque has to come up to before the limit is drawn
NOTHING = 1e-9  # in any unit; what is smaller is zero


def figures(comparison: Comparison) -> list[Figure]:
    """Describe every figure for which there is data, in the order of the table above."""
    scene: FlightScene = Scene(comparison)
    axes = range(len(AXES))
    found = [
        *(_numbered(fault_figure(scene, axis), comparison, "fault", axis) for axis in axes),
        state_figure(scene),
        *(_numbered(_tracking(scene, axis), comparison, "tracking", axis) for axis in axes),
        _disturbance(scene),
        _sliding_variable(scene),
        _torque(scene),
    ]
    return [figure for figure in found if figure is not None]


def _numbered(figure: Figure | None, comparison: Comparison, kind: str, axis: int) -> Figure | None:
    """The figure with its number in the paper."""
    numbers = PAPER_FIGURES.get((comparison.scenario.name, kind), ())[axis : axis + 1]
    return figure and dataclasses.replace(figure, paper_figures=numbers)


def _tracking(scene: FlightScene, axis: int) -> Figure | None:
    """Reference and angle of each run, and the tracking errors."""
    name = AXES[axis]
    reference = scene.truth(scene.runs, "reference", axis, "reference")
    angles = [scene.trace(run, column_of(run, "angles", axis)) for run in scene.runs]
    errors = [difference(run, "angles", "reference", axis) for run in scene.runs]
    if not known(*errors):
        return None
    lines = [dataclasses.replace(line, y=error) for line, error in zip(angles, errors, strict=True)]
    panels = [
        scene.panel(axis, [*reference, *angles], f"{name} angle", "deg", height=UPPER),
        scene.panel(axis, lines, "error", "deg", title="error"),
    ]
    found = [(scene.label(run), error) for run, error in zip(scene.runs, errors, strict=True)]
    caption = captions.tracking(name, panels[0].shades, panels[0].marks, found)
    return scene.figure("tracking", f"{name.capitalize()} tracking", caption, panels, axis)


def _disturbance(scene: FlightScene) -> Figure | None:
    """The disturbance and its estimates, a panel for each axis."""
    runs = [
        run
        for run in scene.runs
        if run.scheme.disturbance_observer.kind != NO_OBSERVER and known(run.flight.disturbance_estimate)
    ]
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        truth = scene.truth(runs or scene.runs, "disturbance", axis, "disturbance d")
        estimates = scene.estimates(runs, "disturbance_estimate", axis, "estimate of d")
        panels.append(scene.panel(axis, [*truth, *estimates], f"{name} d", "rad/s²"))
    if not worth(*(trace.y for panel in panels for trace in panel.traces)):
        return None
    errors = [(scene.label(run), run.flight.disturbance_estimate - run.flight.disturbance) for run in runs]
    caption = captions.disturbance([mark for panel in panels for mark in panel.marks], errors)
    return scene.figure("disturbance", "Disturbance and its estimate", caption, panels)


def _sliding_variable(scene: FlightScene) -> Figure | None:
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


def _torque(scene: FlightScene) -> Figure | None:
    """Torque command of each run, a panel for each axis, with the limits where they are near."""
    runs = [run for run in scene.runs if known(run.flight.torque)]
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


def _boundary_layer(run: RecordedRun) -> tuple[float, ...] | None:
    """Phi of the run's controller on each axis [rad/s]; None if it has none."""
    phi: Any = getattr(run.scheme.controller.law, "phi", None)
    return None if phi is None else tuple(np.broadcast_to(np.asarray(phi, np.float64), len(AXES)).tolist())


def _share_inside(surface: Floats, layer: Sequence[float]) -> float:
    """Share of the samples in which S is within its layer on every axis."""
    known = surface[np.all(np.isfinite(surface), axis=1)]
    inside: NDArray[np.bool_] = np.all(np.abs(known) <= np.asarray(layer), axis=1)
    return float(np.mean(inside))
