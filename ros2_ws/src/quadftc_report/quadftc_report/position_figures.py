"""The figures of flights through space, described without drawing them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_flight.run_directory import RecordedRun
from quadftc_report.description import Figure, Panel, Trace
from quadftc_report.scene import Scene, fault_shades, known

EARTH = ("east", "north", "up")


def position_figures(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    """Describe where the vehicles are in free flight, and where they shall be."""
    runs = [run for run in scene.runs if known(run.flight.position)]
    if not runs:
        return
    shades = {shade for axis in range(3) for shade in fault_shades(scene.runs[0], axis, scene.end)}
    every = {"shades": tuple(sorted(shades)), "marks": ()}  # a fault of any axis moves the vehicle
    panels: list[Panel] = []
    for axis, name in enumerate(EARTH):
        traces = [*_reference(scene, runs, axis), *scene.lines(runs, "position", axis)]
        panels.append(scene.panel(axis, traces, "", "m", title=name, y_label=name, **every))
    caption = "True position and its reference, in earth axes"
    yield scene.figure("position", "Position", caption, panels)
    yield _top_view(scene, runs)
    shown = (
        ("off course", "position", "position_reference", "distance from the reference"),
        ("estimate off", "position_estimate", "position", "distance of the estimate from the truth"),
    )
    panels = [
        scene.panel(0, _distances(scene, runs, column, other), "", "m", title=title, y_label=label, **every)
        for label, column, other, title in shown
    ]
    caption = "Distance from the reference, and of the estimated position from the true one"
    yield scene.figure("position_error", "Position error", caption, panels)


def _reference(scene: Scene[RecordedRun], runs: Sequence[RecordedRun], axis: int) -> list[Trace]:
    return scene.truth(runs, "position_reference", axis, "reference")


def _distances(
    scene: Scene[RecordedRun], runs: Sequence[RecordedRun], column: str, other: str
) -> list[Trace]:
    pairs = ((run, getattr(run.flight, column) - getattr(run.flight, other)) for run in runs)
    return [scene.trace(run, np.linalg.norm(off, axis=1)) for run, off in pairs]


def _top_view(scene: Scene[RecordedRun], runs: Sequence[RecordedRun]) -> Figure:
    """The paths from above: reference, and of each run the true one."""
    east, north = (
        [*_reference(scene, runs, axis), *scene.lines(runs, "position", axis)] for axis in range(2)
    )
    traces = tuple(dataclasses.replace(y, t=x.y) for x, y in zip(east, north, strict=True))
    span = [float(limit(np.concatenate([trace.t for trace in traces]))) for limit in (np.nanmin, np.nanmax)]
    panel = Panel(title="north", y_label="north", unit="m", traces=traces, height=3.0)
    figure = scene.figure("top_view", "Path from above", "True path and its reference, from above", [panel])
    room = 0.05 * (span[1] - span[0])
    return dataclasses.replace(figure, span=(span[0] - room, span[1] + room), x_label="east [m]", is_map=True)
