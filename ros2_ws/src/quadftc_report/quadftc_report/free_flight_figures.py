"""The figures of free flights, of position and rotors, described without drawing them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from quadftc_flight.flight import NO_STATE
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_report.comparison import has_observer
from quadftc_report.description import Figure, Panel, Trace
from quadftc_report.scene import Scene, envelopes, fault_shades, known, rotor_shades

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


def rotor_figures(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    """Describe the effectiveness of the rotors and its estimates, and the state of the diagnosis."""
    flying = [run for run in scene.runs if run.flight.rotor_state.shape[1]]
    weak = any(bool(np.any(run.flight.rotor_effectiveness < 1.0)) for run in flying)
    runs = [run for run in flying if has_observer(run) and known(run.flight.rotor_estimate)]
    states = [run.flight.rotor_state for run in runs]
    doubted = any(bool(np.isin(state, (SUSPECT, FAULTY, RECOVERING)).any()) for state in states)
    if weak or doubted:
        yield _effectiveness(scene, flying, runs)
    if doubted:
        yield _state(scene, [run for run in runs if not np.all(run.flight.rotor_state == NO_STATE)])


def _effectiveness(scene: Scene[RecordedRun], flying: list[RecordedRun], runs: list[RecordedRun]) -> Figure:
    panels: list[Panel] = []
    for rotor in range(flying[0].flight.rotor_state.shape[1]):
        truth = scene.truth(runs or flying, "rotor_effectiveness", rotor, "true effectiveness")
        lines = scene.lines(runs, "rotor_estimate", rotor, "estimate")
        around = envelopes(lines, runs, "rotor_std_dev", rotor)
        look = _look(scene, flying[0], rotor)
        panels.append(scene.panel(0, [*truth, *lines], "", "", envelopes=around, **look))
    caption = "Thrust of each rotor over that of a healthy one at the same speed, and its estimate"
    return scene.figure("rotors", "Effectiveness of the rotors", caption, panels)


def _state(scene: Scene[RecordedRun], runs: list[RecordedRun]) -> Figure:
    ticks = tuple((float(state), word) for state, word in enumerate(FAULT_STATE_NAMES))
    panels = [
        scene.panel(
            0, scene.lines(runs, "rotor_state", rotor), "", "", ticks=ticks, **_look(scene, runs[0], rotor)
        )
        for rotor in range(runs[0].flight.rotor_state.shape[1])
    ]
    caption = "State that the fault observer gives each rotor"
    return scene.figure("state-rotor", "State of the diagnosis: rotors", caption, panels)


def _look(scene: Scene[RecordedRun], run: RecordedRun, rotor: int) -> dict[str, object]:
    name = f"rotor {rotor + 1}"
    shades = rotor_shades(run, rotor, scene.end)
    return {"title": name, "y_label": name, "shades": shades, "marks": ()}
