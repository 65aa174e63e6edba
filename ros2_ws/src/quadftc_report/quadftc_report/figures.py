"""The figures of flights and replays, described without drawing them.

| key | panels | of | figures of Wang, Huang and Zhang (2021) |
|---|---|---|---|
| attitude-<axis> | measured and corrected angle, and without the faults; their errors | replays | |
| fault-<axis> | fault and its estimates; errors of the estimates | both | 3 to 5 |
| state, state-gyro, state-accelerometer | state of the diagnosis, a panel for each axis | both | |
| tracking-<axis> | reference and angle of each run; tracking errors | flights | 6 to 14 |
| disturbance | disturbance and its estimates, a panel for each axis | flights | |
| sliding_variable | S and its boundary layer, a panel for each axis | flights | |
| torque | torque command, a panel for each axis | flights | |
| rotors, state-rotor | effectiveness, true and estimated; state; a panel for each rotor | free flights | |
| position, top_view, position_error | reference and position; paths from above; distances | free flights | |
| gyro, gyro_correction | measured body rate, and what is added to it, a panel for each axis | replays | |

A figure without data is left out. The angle without the faults is the measured one less the true fault.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from quadftc_fdi.diagnosis import BODY_AXES
from quadftc_flight.flight import NO_STATE, ImuReadings
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.summary import NO_OBSERVER
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.description import Band, Figure, Panel, Trace
from quadftc_report.free_flight_figures import position_figures, rotor_figures
from quadftc_report.scene import Scene, envelopes, known, worth

Floats = NDArray[np.float64]

PAPER_FIGURES = {
    ("paper_faults", "fault"): 3,
    ("paper_faults", "tracking"): 6,
    ("paper_constant_disturbance", "tracking"): 9,
    ("paper_varying_disturbance", "tracking"): 12,
}  # scenario and kind of figure -> number in the paper for roll; pitch and yaw follow
# of each sensor: key of its figure, column of a flight, names of its axes
STATES = {
    "sensor": ("state", "fault_state", AXES),
    "gyro": ("state-gyro", "gyro_state", BODY_AXES),
    "accelerometer": ("state-accelerometer", "accelerometer_state", BODY_AXES),
}
UPPER = 1.5  # height of a panel with a panel of errors below
ERROR = {"title": "error", "y_label": "error"}  # of the panel below
IN_VIEW = 0.5  # share of a limit that the torque has to come up to before the limit is drawn


def flight_figures(comparison: Comparison[RecordedRun]) -> list[Figure]:
    """Describe every figure of flights for which there is data."""
    scene, name = Scene(comparison), comparison.runs[0].scenario.name
    kinds = (
        _faults,
        _state,
        rotor_figures,
        position_figures,
        _tracking,
        _disturbance,
        _sliding_variable,
        _torque,
    )
    return [_with_paper_number(figure, name) for describe in kinds for figure in describe(scene)]


def replay_figures(comparison: Comparison[RecordedReplay]) -> list[Figure]:
    """Describe every figure of replays for which there is data."""
    scene = Scene(comparison)
    return [figure for describe in (_attitude, _faults, _state, _gyro) for figure in describe(scene)]


def _with_paper_number(figure: Figure, scenario: str) -> Figure:
    kind, axis = figure.key.split("-")[-2:]
    first = PAPER_FIGURES.get((scenario, kind))
    return figure if first is None else dataclasses.replace(figure, paper_figures=(first + AXES.index(axis),))


def _faults(scene: Scene[Recorded]) -> Iterator[Figure]:
    runs = [run for run in scene.runs if has_observer(run) and known(run.flight.fault_estimate)]
    for axis, name in enumerate(AXES):
        truth = scene.truth(runs or scene.runs, "fault", axis, "true fault")
        estimates = scene.lines(runs, "fault_estimate", axis, "estimate")
        if not worth(*(trace.y for trace in (*truth, *estimates))):
            continue
        errors = scene.lines(runs, "fault_estimate", axis, "estimate", less="fault")
        around = envelopes(estimates, runs, "fault_std_dev", axis)
        around_zero = envelopes(estimates, runs, "fault_std_dev", axis, about_zero=True)
        look = {"title": "fault", "envelopes": around, "height": UPPER}
        upper = scene.panel(axis, [*truth, *estimates], "fault", "deg", **look)
        lower = scene.panel(axis, errors, "", "deg", **ERROR, envelopes=around_zero)
        title = f"{name.capitalize()} fault and its estimate"
        caption = f"Fault of the {name} reading, its estimate, and the error of the estimate"
        yield scene.figure(f"fault-{name}", title, caption, [upper, lower])


def _state(scene: Scene[Recorded]) -> Iterator[Figure]:
    """The state of each axis of a sensor over time, where an observer ever doubts it."""
    ticks = tuple((float(state), word) for state, word in enumerate(FAULT_STATE_NAMES))
    for sensor, (key, column, axes) in STATES.items():
        states = ((run, getattr(run.flight, column)) for run in scene.runs if has_observer(run))
        given = [(run, state) for run, state in states if not np.all(state == NO_STATE)]
        if not any(np.isin(state, (SUSPECT, FAULTY, RECOVERING)).any() for _, state in given):
            continue
        runs = [run for run, _ in given]
        panels = [
            scene.panel(k, scene.lines(runs, column, k), "", "", ticks=ticks, title=name, y_label=name)
            for k, name in enumerate(axes)
        ]
        caption = f"State that the fault observer gives each axis of its {sensor}"
        title = "State of the diagnosis" + (f": {sensor}" if sensor != "sensor" else "")
        yield scene.figure(key, title, caption, panels)


def _tracking(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    for axis, name in enumerate(AXES):
        reference = scene.truth(scene.runs, "reference", axis, "reference")
        angles = scene.lines(scene.runs, "angles", axis)
        errors = scene.lines(scene.runs, "angles", axis, less="reference")
        if known(*(trace.y for trace in errors)):
            upper = scene.panel(axis, [*reference, *angles], "angle", "deg", height=UPPER)
            lower = scene.panel(axis, errors, "", "deg", **ERROR)
            caption = f"True {name} angle, its reference, and the tracking error"
            yield scene.figure(f"tracking-{name}", f"{name.capitalize()} tracking", caption, [upper, lower])


def _disturbance(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    observing = [run for run in scene.runs if run.disturbance_observer != NO_OBSERVER]
    runs = [run for run in observing if known(run.flight.disturbance_estimate)]
    lines = [
        scene.truth(runs or scene.runs, "disturbance", axis, "disturbance d")
        + scene.lines(runs, "disturbance_estimate", axis, "estimate of d")
        for axis in range(3)
    ]
    if worth(*(trace.y for traces in lines for trace in traces)):
        panels = [scene.panel(axis, traces, "d", "rad/s²") for axis, traces in enumerate(lines)]
        caption = "Disturbance d as an angular acceleration, and its estimate"
        yield scene.figure("disturbance", "Disturbance and its estimate", caption, panels)


def _sliding_variable(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    runs = [run for run in scene.runs if worth(run.flight.sliding_variable)]
    layers = [(run, getattr(run.scheme.controller.law, "phi", None)) for run in runs]
    sizes = [(run, np.broadcast_to(phi, len(AXES)).tolist()) for run, phi in layers if phi is not None]
    panels = [
        scene.panel(
            axis,
            scene.lines(runs, "sliding_variable", axis),
            "S",
            "rad/s",
            bands=tuple(
                Band(-size[axis], size[axis], f"±Φ ({scene.label(run)})", *scene.look(run))
                for run, size in sizes
            ),
        )
        for axis in range(3)
    ]
    if runs:
        title = "Sliding variable and its boundary layer"
        yield scene.figure("sliding_variable", title, "Sliding variable S with its boundary layer ±Φ", panels)


def _torque(scene: Scene[RecordedRun]) -> Iterator[Figure]:
    """Torque command of each run, with the limits of the rotors where it comes near them."""
    runs = [run for run in scene.runs if known(run.flight.torque)]
    if not runs:
        return
    authority: list[float] = runs[0].scheme.controller.law.vehicle.authority.tolist()
    panels: list[Panel] = []
    for axis, limit in enumerate(authority):
        lines = scene.lines(runs, "torque", axis)
        largest = max(float(np.nanmax(np.abs(line.y))) for line in lines)
        bands = (Band(-limit, limit, "limits of the rotors", "limit"),) if largest > IN_VIEW * limit else ()
        panels.append(scene.panel(axis, lines, "torque", "N m", bands=bands))
    bounds = ", ".join(f"{limit:.3g}" for limit in authority)
    caption = f"Torque command; the rotors can give {bounds} N m in roll, pitch, yaw"
    yield scene.figure("torque", "Torque command", caption, panels)


def _attitude(scene: Scene[RecordedReplay]) -> Iterator[Figure]:
    """The measured angle, the angle without the fault, and what the observers pass on."""
    longest = scene.longest
    for axis, name in enumerate(AXES):
        measured = longest.measured.angles[:, axis]
        if not known(measured):
            continue
        time, faultless = longest.flight.time, list[Trace]()
        if worth(longest.flight.fault[:, axis]):
            angle = np.degrees(wrap(measured - longest.flight.fault[:, axis]))
            faultless.append(Trace("without the fault", "truth", time, angle))
        shown = Trace("measured", "truth", time, np.degrees(measured), rank=len(faultless))
        given = [run for run in scene.runs if known(run.corrected.angles[:, axis])]
        lines = [scene.trace(run, np.degrees(run.corrected.angles[:, axis])) for run in given]
        errors = [scene.trace(run, _error(run, run.corrected, axis)) for run in given]
        if faultless:
            errors.insert(0, dataclasses.replace(shown, y=_error(longest, longest.measured, axis)))
        upper = scene.panel(axis, [*faultless, shown, *lines], "angle", "deg", height=UPPER)
        lower = scene.panel(axis, errors, "", "deg", **ERROR)
        title = f"{name.capitalize()} as measured and corrected"
        caption = f"{name.capitalize()} angle before and after the observers, and its error without the fault"
        yield scene.figure(f"attitude-{name}", title, caption, [upper, lower])


def _error(run: RecordedReplay, reading: ImuReadings, axis: int) -> Floats:
    """An angle less the measured one without the fault [deg] (n,), wrapped."""
    faultless = run.measured.angles[:, axis] - run.flight.fault[:, axis]
    return np.degrees(wrap(reading.angles[:, axis] - faultless))


def _gyro(scene: Scene[RecordedReplay]) -> Iterator[Figure]:
    """The measured body rate, and what the observers add to it, where one of them does."""
    time, rates = scene.longest.flight.time, np.degrees(scene.longest.measured.body_rate)
    changes = [(run, np.degrees(run.corrected.body_rate - run.measured.body_rate)) for run in scene.runs]
    changes = [(run, change) for run, change in changes if worth(change)]
    if known(rates):
        measured = (Trace("measured", "truth", time, rate) for rate in rates.T)
        panels = [scene.panel(axis, [trace], "", "deg/s") for axis, trace in enumerate(measured)]
        yield scene.figure("gyro", "Gyro as measured", "Body rate as the observers saw it", panels)
    if changes:
        added = ([scene.trace(run, change[:, axis]) for run, change in changes] for axis in range(3))
        panels = [scene.panel(axis, traces, "", "deg/s") for axis, traces in enumerate(added)]
        title, caption = "Correction of the gyro", "Corrected less measured body rate"
        yield scene.figure("gyro_correction", title, caption, panels)
