"""The figures of flights and replays, described without drawing them.

| key | panels | of | figures of Wang, Huang and Zhang (2021) |
|---|---|---|---|
| attitude-<axis> | measured and corrected angle, and without the faults; their errors | replays | |
| fault-<axis> | fault and its estimates; errors of the estimates | both | 3 to 5 |
| state | state of the diagnosis, a panel for each axis | both | |
| tracking-<axis> | reference and angle of each run; tracking errors | flights | 6 to 14 |
| disturbance | disturbance and its estimates, a panel for each axis | flights | |
| sliding_variable | S and its boundary layer, a panel for each axis | flights | |
| torque | torque command, a panel for each axis | flights | |
| gyro, gyro_correction | measured body rate, and what is added to it, a panel for each axis | replays | |

A figure without data is left out. The angle without the faults is the measured one less the true fault.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import Reading
from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_replay.replay_directory import RecordedReplay
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.description import Band, Figure, Panel, Trace
from quadftc_report.scene import Scene, column_of, envelope, known, worth

Floats = NDArray[np.float64]

PAPER_FIGURES = {
    ("paper_faults", "fault"): 3,
    ("paper_faults", "tracking"): 6,
    ("paper_constant_disturbance", "tracking"): 9,
    ("paper_varying_disturbance", "tracking"): 12,
}  # scenario and kind of figure -> number in the paper for roll; pitch and yaw follow
UPPER = 1.5  # height of a panel with a panel of errors below
IN_VIEW = 0.5  # share of a limit that the torque has to come up to before the limit is drawn


def flight_figures(comparison: Comparison[RecordedRun]) -> list[Figure]:
    """Describe every figure of flights for which there is data."""
    scene, runs = Scene(comparison), comparison.runs
    figures = [
        *_faults(scene),
        *_state(scene),
        *_tracking(scene),
        *_disturbance(scene),
        *_sliding_variable(scene, runs),
        *_torque(scene, runs),
    ]
    return [_with_paper_number(figure, runs[0].scenario.name) for figure in figures]


def replay_figures(comparison: Comparison[RecordedReplay]) -> list[Figure]:
    """Describe every figure of replays for which there is data."""
    scene, longest = Scene(comparison), comparison.longest
    return [
        *_attitude(scene, comparison.runs, longest),
        *_faults(scene),
        *_state(scene),
        *_gyro(scene, comparison.runs, longest),
    ]


def _with_paper_number(figure: Figure, scenario: str) -> Figure:
    kind, axis = figure.key.split("-")[-2:]
    first = PAPER_FIGURES.get((scenario, kind))
    return figure if first is None else dataclasses.replace(figure, paper_figures=(first + AXES.index(axis),))


def _faults(scene: Scene) -> Iterator[Figure]:
    runs = [run for run in scene.runs if has_observer(run) and known(run.flight.fault_estimate)]
    for axis, name in enumerate(AXES):
        truth = scene.truth(runs or scene.runs, "fault", axis, "true fault")
        estimates = scene.lines(runs, "fault_estimate", axis, "estimate")
        if not worth(*(trace.y for trace in (*truth, *estimates))):
            continue
        errors = scene.lines(runs, "fault_estimate", axis, "estimate", less="fault")
        deviations = [column_of(run, "fault_std_dev", axis) for run in runs]
        given = [
            (line, each) for line, each in zip(estimates, deviations, strict=True) if np.any(each >= 0.0)
        ]
        around = tuple(envelope(line, line.y, each) for line, each in given)
        around_zero = tuple(envelope(line, 0.0, each) for line, each in given)
        look = {"title": "fault", "envelopes": around, "height": UPPER}
        upper = scene.panel(axis, [*truth, *estimates], f"{name} fault", "deg", **look)
        lower = scene.panel(axis, errors, "error", "deg", title="error", envelopes=around_zero)
        title = f"{name.capitalize()} fault and its estimate"
        caption = f"Fault of the {name} reading, its estimate, and the error of the estimate"
        yield scene.figure(f"fault-{name}", title, caption, [upper, lower])


def _state(scene: Scene) -> Iterator[Figure]:
    """The state of each axis over time, where an observer ever doubts its sensor."""
    runs = [run for run in scene.runs if has_observer(run)]
    if not any(np.isin(run.flight.fault_state, (SUSPECT, FAULTY, RECOVERING)).any() for run in runs):
        return
    ticks = tuple((float(state), word) for state, word in enumerate(FAULT_STATE_NAMES))
    panels = [
        scene.panel(axis, scene.lines(runs, "fault_state", axis), name, "", ticks=ticks)
        for axis, name in enumerate(AXES)
    ]
    caption = "State that the fault observer gives each axis of its sensor"
    yield scene.figure("state", "State of the diagnosis", caption, panels)


def _tracking(scene: Scene) -> Iterator[Figure]:
    for axis, name in enumerate(AXES):
        reference = scene.truth(scene.runs, "reference", axis, "reference")
        angles = scene.lines(scene.runs, "angles", axis)
        errors = scene.lines(scene.runs, "angles", axis, less="reference")
        if not known(*(trace.y for trace in errors)):
            continue
        upper = scene.panel(axis, [*reference, *angles], f"{name} angle", "deg", height=UPPER)
        lower = scene.panel(axis, errors, "error", "deg", title="error")
        caption = f"True {name} angle, its reference, and the tracking error"
        yield scene.figure(f"tracking-{name}", f"{name.capitalize()} tracking", caption, [upper, lower])


def _disturbance(scene: Scene) -> Iterator[Figure]:
    observing = [run for run in scene.runs if run.disturbance_observer != NO_OBSERVER]
    runs = [run for run in observing if known(run.flight.disturbance_estimate)]
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        truth = scene.truth(runs or scene.runs, "disturbance", axis, "disturbance d")
        estimates = scene.lines(runs, "disturbance_estimate", axis, "estimate of d")
        panels.append(scene.panel(axis, [*truth, *estimates], f"{name} d", "rad/s²"))
    if worth(*(trace.y for panel in panels for trace in panel.traces)):
        caption = "Disturbance d as an angular acceleration, and its estimate"
        yield scene.figure("disturbance", "Disturbance and its estimate", caption, panels)


def _sliding_variable(scene: Scene, runs: Sequence[RecordedRun]) -> Iterator[Figure]:
    runs = [run for run in runs if worth(run.flight.sliding_variable)]
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        bands: list[Band] = []
        for run in runs:
            phi = getattr(run.scheme.controller.law, "phi", None)
            if phi is not None:
                size = float(np.broadcast_to(phi, len(AXES))[axis])
                bands.append(Band(-size, size, f"±Φ ({scene.label(run)})", *scene.look(run)))
        lines = scene.lines(runs, "sliding_variable", axis)
        panels.append(scene.panel(axis, lines, f"{name} S", "rad/s", bands=tuple(bands)))
    if runs:
        title = "Sliding variable and its boundary layer"
        yield scene.figure("sliding_variable", title, "Sliding variable S with its boundary layer ±Φ", panels)


def _torque(scene: Scene, runs: Sequence[RecordedRun]) -> Iterator[Figure]:
    """Torque command of each run, with the limits of the rotors where it comes near them."""
    runs = [run for run in runs if known(run.flight.torque)]
    if not runs:
        return
    authority: Floats = runs[0].scheme.controller.law.vehicle.authority
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        limit, lines = float(authority[axis]), scene.lines(runs, "torque", axis)
        largest = max(float(np.nanmax(np.abs(line.y))) for line in lines)
        bands = (Band(-limit, limit, "limits of the rotors", "limit"),) if largest > IN_VIEW * limit else ()
        panels.append(scene.panel(axis, lines, f"{name} torque", "N m", bands=bands))
    bounds = ", ".join(f"{limit:.3g}" for limit in authority)
    caption = f"Torque command; the rotors can give {bounds} N m in roll, pitch, yaw"
    yield scene.figure("torque", "Torque command", caption, panels)


def _attitude(scene: Scene, runs: Sequence[RecordedReplay], longest: RecordedReplay) -> Iterator[Figure]:
    """The measured angle, the angle without the fault, and what the observers pass on."""
    for axis, name in enumerate(AXES):
        measured = longest.measured.angles[:, axis]
        if not known(measured):
            continue
        time, faultless = longest.flight.time, list[Trace]()
        if worth(longest.flight.fault[:, axis]):
            angle = np.degrees(wrap(measured - longest.flight.fault[:, axis]))
            faultless.append(Trace("without the fault", "truth", time, angle))
        shown = Trace("measured", "truth", time, np.degrees(measured), rank=len(faultless))
        given = [run for run in runs if known(run.corrected.angles[:, axis])]
        lines = [scene.trace(run, np.degrees(run.corrected.angles[:, axis])) for run in given]
        errors = [scene.trace(run, _error(run, run.corrected, axis)) for run in given]
        if faultless:
            errors.insert(0, dataclasses.replace(shown, y=_error(longest, longest.measured, axis)))
        upper = scene.panel(axis, [*faultless, shown, *lines], f"{name} angle", "deg", height=UPPER)
        lower = scene.panel(axis, errors, "error", "deg", title="error")
        title = f"{name.capitalize()} as measured and corrected"
        caption = f"{name.capitalize()} angle before and after the observers, and its error without the fault"
        yield scene.figure(f"attitude-{name}", title, caption, [upper, lower])


def _error(run: RecordedReplay, reading: Reading, axis: int) -> Floats:
    """An angle less the measured one without the fault [deg] (n,), wrapped."""
    faultless = run.measured.angles[:, axis] - run.flight.fault[:, axis]
    return np.degrees(wrap(reading.angles[:, axis] - faultless))


def _gyro(scene: Scene, runs: Sequence[RecordedReplay], longest: RecordedReplay) -> Iterator[Figure]:
    """The measured body rate, and what the observers add to it, where one of them does."""
    time, rates = longest.flight.time, np.degrees(longest.measured.body_rate)
    changes = [(run, np.degrees(run.corrected.body_rate - run.measured.body_rate)) for run in runs]
    changes = [(run, change) for run, change in changes if worth(change)]
    measured = [
        scene.panel(axis, [Trace("measured", "truth", time, rates[:, axis])], name, "deg/s")
        for axis, name in enumerate(AXES)
    ]
    added = [
        scene.panel(axis, [scene.trace(run, change[:, axis]) for run, change in changes], name, "deg/s")
        for axis, name in enumerate(AXES)
    ]
    if known(rates):
        yield scene.figure("gyro", "Gyro as measured", "Body rate as the observers saw it", measured)
    if changes:
        title, caption = "Correction of the gyro", "Corrected less measured body rate"
        yield scene.figure("gyro_correction", title, caption, added)
