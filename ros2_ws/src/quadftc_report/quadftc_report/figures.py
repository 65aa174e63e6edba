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
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import NO_STATE, Reading
from quadftc_flight.run_directory import NO_OBSERVER, RecordedRun
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES, FAULT_STATE_NAMES, FAULTY, RECOVERING, SUSPECT
from quadftc_replay.replay_directory import Recorded, RecordedReplay
from quadftc_report.comparison import Comparison, has_observer
from quadftc_report.description import Band, Figure, Trace
from quadftc_report.scene import UPPER, Scene, column_of, difference, envelope, known, worth

Floats = NDArray[np.float64]
Run = TypeVar("Run", bound=Recorded)
FlightScene = Scene[RecordedRun]
ReplayScene = Scene[RecordedReplay]

PAPER_FIGURES = {
    ("paper_faults", "fault"): (3, 4, 5),
    ("paper_faults", "tracking"): (6, 7, 8),
    ("paper_constant_disturbance", "tracking"): (9, 10, 11),
    ("paper_varying_disturbance", "tracking"): (12, 13, 14),
}  # scenario and kind of figure -> numbers in the paper for roll, pitch, yaw
IN_VIEW = 0.5  # share of a limit that the torque has to come up to before the limit is drawn


def flight_figures(comparison: Comparison[RecordedRun]) -> list[Figure]:
    """Describe every figure of flights for which there is data."""
    scene: FlightScene = Scene(comparison)
    axes = range(len(AXES))
    found = [
        *(_number(_fault(scene, axis), scene, "fault", axis) for axis in axes),
        _state(scene),
        *(_number(_tracking(scene, axis), scene, "tracking", axis) for axis in axes),
        _disturbance(scene),
        _sliding_variable(scene),
        _torque(scene),
    ]
    return [figure for figure in found if figure is not None]


def replay_figures(comparison: Comparison[RecordedReplay]) -> list[Figure]:
    """Describe every figure of replays for which there is data."""
    scene: ReplayScene = Scene(comparison)
    axes = range(len(AXES))
    found = [
        *(_attitude(scene, comparison.longest, axis) for axis in axes),
        *(_fault(scene, axis) for axis in axes),
        _state(scene),
        _gyro(scene, comparison.longest),
        _gyro_correction(scene),
    ]
    return [figure for figure in found if figure is not None]


def _number(figure: Figure | None, scene: FlightScene, kind: str, axis: int) -> Figure | None:
    """Give a figure its number in the paper."""
    numbers = PAPER_FIGURES.get((scene.runs[0].scenario.name, kind), ())[axis : axis + 1]
    return figure and dataclasses.replace(figure, paper_figures=numbers)


def _per_axis(
    scene: Scene[Run],
    texts: tuple[str, str, str],
    label: tuple[str, str],
    traces: Callable[[int], Iterable[Trace]],
    **others: Callable[[int], Any],
) -> Figure:
    """A figure with a panel for each axis; ``texts``: key, title, caption; ``label``: quantity, unit."""
    quantity, unit = label
    panels = [
        scene.panel(
            axis,
            traces(axis),
            f"{name} {quantity}".rstrip(),
            unit,
            **{key: make(axis) for key, make in others.items()},
        )
        for axis, name in enumerate(AXES)
    ]
    return scene.figure(*texts, panels)


def _fault(scene: Scene[Run], axis: int) -> Figure | None:
    name = AXES[axis]
    runs = [run for run in scene.runs if has_observer(run) and known(run.flight.fault_estimate)]
    truth = scene.truth(runs or scene.runs, "fault", axis, "true fault")
    estimates = scene.estimates(runs, "fault_estimate", axis, "estimate")
    if not worth(*(trace.y for trace in (*truth, *estimates))):
        return None
    errors = [
        dataclasses.replace(line, y=difference(run, "fault_estimate", "fault", axis))
        for run, line in zip(runs, estimates, strict=True)
    ]
    deviations = [column_of(run, "fault_std_dev", axis) for run in runs]
    given = [pair for pair in zip(estimates, deviations, strict=True) if np.any(pair[1] >= 0.0)]
    around = tuple(envelope(line, line.y, deviation) for line, deviation in given)
    around_zero = tuple(envelope(line, 0.0, deviation) for line, deviation in given)
    look = {"title": "fault", "envelopes": around, "height": UPPER}
    upper = scene.panel(axis, [*truth, *estimates], f"{name} fault", "deg", **look)
    caption = f"Fault of the {name} reading" + (
        "; no run estimates it" if not runs else ", its estimate, and the error of the estimate"
    )
    texts = f"{name.capitalize()} fault and its estimate", caption
    return scene.with_errors("fault", axis, texts, upper, errors, envelopes=around_zero)


def _state(scene: Scene[Run]) -> Figure | None:
    """The state of each axis over time, where an observer ever doubts its sensor."""
    runs = [run for run in scene.runs if has_observer(run)]
    if not any(np.isin(run.flight.fault_state, (SUSPECT, FAULTY, RECOVERING)).any() for run in runs):
        return None

    def lines(axis: int) -> Iterable[Trace]:
        for run in runs:
            state = run.flight.fault_state[:, axis]
            yield scene.trace(run, np.where(state == NO_STATE, np.nan, state.astype(np.float64)))

    words = tuple((float(state), word) for state, word in enumerate(FAULT_STATE_NAMES))
    texts = "state", "State of the diagnosis", "State that the fault observer gives each axis of its sensor"
    return _per_axis(scene, texts, ("", ""), lines, ticks=lambda _: words)


def _tracking(scene: FlightScene, axis: int) -> Figure | None:
    name = AXES[axis]
    reference = scene.truth(scene.runs, "reference", axis, "reference")
    angles = [scene.trace(run, column_of(run, "angles", axis)) for run in scene.runs]
    errors = [scene.trace(run, difference(run, "angles", "reference", axis)) for run in scene.runs]
    if not known(*(trace.y for trace in errors)):
        return None
    upper = scene.panel(axis, [*reference, *angles], f"{name} angle", "deg", height=UPPER)
    texts = f"{name.capitalize()} tracking", f"True {name} angle, its reference, and the tracking error"
    return scene.with_errors("tracking", axis, texts, upper, errors)


def _disturbance(scene: FlightScene) -> Figure | None:
    runs = [
        run
        for run in scene.runs
        if run.disturbance_observer != NO_OBSERVER and known(run.flight.disturbance_estimate)
    ]

    def lines(axis: int) -> list[Trace]:
        truth = scene.truth(runs or scene.runs, "disturbance", axis, "disturbance d")
        return [*truth, *scene.estimates(runs, "disturbance_estimate", axis, "estimate of d")]

    caption = f"Disturbance d as an angular acceleration{' and its estimate' if runs else ''}"
    texts = "disturbance", "Disturbance and its estimate", caption
    figure = _per_axis(scene, texts, ("d", "rad/s²"), lines)
    return figure if worth(*(trace.y for panel in figure.panels for trace in panel.traces)) else None


def _sliding_variable(scene: FlightScene) -> Figure | None:
    runs = [run for run in scene.runs if worth(run.flight.sliding_variable)]
    if not runs:
        return None

    def layers(axis: int) -> tuple[Band, ...]:
        layers = [(run, getattr(run.scheme.controller.law, "phi", None)) for run in runs]
        sizes = [(run, np.broadcast_to(phi, len(AXES))[axis]) for run, phi in layers if phi is not None]
        return tuple(
            Band(-float(phi), float(phi), f"±Φ ({scene.label(run)})", *scene.look(run)) for run, phi in sizes
        )

    def lines(axis: int) -> list[Trace]:
        return [scene.trace(run, run.flight.sliding_variable[:, axis]) for run in runs]

    title = "Sliding variable and its boundary layer"
    texts = "sliding_variable", title, "Sliding variable S with its boundary layer ±Φ"
    return _per_axis(scene, texts, ("S", "rad/s"), lines, bands=layers)


def _torque(scene: FlightScene) -> Figure | None:
    """Torque command of each run, with the limits of the rotors where it comes near them."""
    runs = [run for run in scene.runs if known(run.flight.torque)]
    if not runs:
        return None
    authority: Floats = runs[0].scheme.controller.law.vehicle.authority

    def limits(axis: int) -> tuple[Band, ...]:
        limit = float(authority[axis])
        largest = max(float(np.nanmax(np.abs(run.flight.torque[:, axis]))) for run in runs)
        return (Band(-limit, limit, "limits of the rotors", "limit"),) if largest > IN_VIEW * limit else ()

    def lines(axis: int) -> list[Trace]:
        return [scene.trace(run, run.flight.torque[:, axis]) for run in runs]

    bounds = ", ".join(f"{limit:.3g}" for limit in authority)
    caption = f"Torque command; the rotors can give {bounds} N m in roll, pitch, yaw"
    return _per_axis(scene, ("torque", "Torque command", caption), ("torque", "N m"), lines, bands=limits)


def _attitude(scene: ReplayScene, longest: RecordedReplay, axis: int) -> Figure | None:
    """The measured angle, the angle without the fault, and what the observers pass on."""
    name, time = AXES[axis], longest.flight.time
    if not known(longest.measured.angles[:, axis]):
        return None
    faultless: list[Trace] = []
    if worth(longest.flight.fault[:, axis]):
        angle = np.degrees(wrap(longest.measured.angles[:, axis] - longest.flight.fault[:, axis]))
        faultless.append(Trace("without the fault", "truth", time, angle))
    measured = np.degrees(longest.measured.angles[:, axis])
    shown = Trace("measured", "truth", time, measured, rank=len(faultless))
    runs = [run for run in scene.runs if known(run.corrected.angles[:, axis])]
    lines = [scene.trace(run, np.degrees(run.corrected.angles[:, axis])) for run in runs]
    errors = [scene.trace(run, _error(run, run.corrected, axis)) for run in runs]
    if faultless:
        errors.insert(0, dataclasses.replace(shown, y=_error(longest, longest.measured, axis)))
    upper = scene.panel(axis, [*faultless, shown, *lines], f"{name} angle", "deg", height=UPPER)
    caption = f"{name.capitalize()} angle before and after the observers, and its error without the fault"
    texts = f"{name.capitalize()} as measured and corrected", caption
    return scene.with_errors("attitude", axis, texts, upper, errors)


def _error(run: RecordedReplay, reading: Reading, axis: int) -> Floats:
    """An angle less the measured one without the fault [deg] (n,), wrapped."""
    faultless = run.measured.angles[:, axis] - run.flight.fault[:, axis]
    return np.degrees(wrap(reading.angles[:, axis] - faultless))


def _gyro(scene: ReplayScene, longest: RecordedReplay) -> Figure | None:
    rate, time = np.degrees(longest.measured.body_rate), longest.flight.time
    if not known(rate):
        return None
    texts = "gyro", "Gyro as measured", "Body rate as the observers saw it"
    return _per_axis(
        scene, texts, ("", "deg/s"), lambda axis: [Trace("measured", "truth", time, rate[:, axis])]
    )


def _gyro_correction(scene: ReplayScene) -> Figure | None:
    """What the observers add to the body rate, where one of them does."""
    changes = [(run, np.degrees(run.corrected.body_rate - run.measured.body_rate)) for run in scene.runs]
    changes = [(run, change) for run, change in changes if worth(change)]
    if not changes:
        return None
    texts = "gyro_correction", "Correction of the gyro", "Corrected less measured body rate"
    return _per_axis(
        scene,
        texts,
        ("", "deg/s"),
        lambda axis: [scene.trace(run, change[:, axis]) for run, change in changes],
    )
