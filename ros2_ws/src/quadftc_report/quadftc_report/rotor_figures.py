"""The figures of the rotors of free flights, described without drawing them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_flight.flight import NO_STATE
from quadftc_flight.run_directory import RecordedRun
from quadftc_model.samples import FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_report.comparison import has_observer
from quadftc_report.description import Figure, Panel
from quadftc_report.scene import Scene, envelopes, known, rotor_shades


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
