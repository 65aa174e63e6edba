"""The figures of replays, described without drawing them; as `report.figures` has them of flights.

| key | panels |
|---|---|
| attitude-<axis> | measured angle, without the faults, and corrected; what they are off by |
| fault-<axis> | fault and its estimates; errors of the estimates |
| state | state of the diagnosis, a panel for each axis |
| gyro | measured body rate, a panel for each axis |
| gyro_correction | corrected less measured body rate, a panel for each axis |

The angle without the faults is the measured one less the true fault: what the sensor would have said.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.flight import Reading
from quadftc_model.rotations import wrap
from quadftc_model.samples import AXES
from quadftc_replay.replay_directory import RecordedReplay
from quadftc_report import captions
from quadftc_report.comparison import ReplayComparison
from quadftc_report.description import Figure, Panel, Trace
from quadftc_report.diagnosis_figures import fault_figure, state_figure
from quadftc_report.scene import UPPER, Scene, known, worth

Floats = NDArray[np.float64]
ReplayScene = Scene[RecordedReplay]

MEASURED, FAULTLESS = "measured", "without the fault"


def replay_figures(comparison: ReplayComparison) -> list[Figure]:
    """Describe every figure for which there is data, in the order of the table above."""
    scene: ReplayScene = Scene(comparison)
    axes = range(len(AXES))
    found = [
        *(_attitude(scene, comparison.longest, axis) for axis in axes),
        *(fault_figure(scene, axis) for axis in axes),
        state_figure(scene),
        _gyro(scene, comparison.longest),
        _gyro_correction(scene),
    ]
    return [figure for figure in found if figure is not None]


def _attitude(scene: ReplayScene, longest: RecordedReplay, axis: int) -> Figure | None:
    """The measured angle of an axis, what it would be without the fault, and what the observers pass on."""
    name, time = AXES[axis], longest.flight.time
    if not known(longest.measured.angles[:, axis]):
        return None
    faulty = worth(longest.flight.fault[:, axis])
    faultless = [Trace(FAULTLESS, "truth", time, _faultless(longest, axis))] if faulty else []
    measured = Trace(MEASURED, "truth", time, _angle(longest.measured, axis), rank=len(faultless))
    off = dataclasses.replace(measured, y=_off(longest, longest.measured, axis))
    runs = [run for run in scene.runs if known(run.corrected.angles[:, axis])]
    lines = [scene.trace(run, _angle(run.corrected, axis)) for run in runs]
    errors = [*([off] if faulty else []), *(scene.trace(run, _off(run, run.corrected, axis)) for run in runs)]
    panels = [scene.panel(axis, [*faultless, measured, *lines], f"{name} angle", "deg", height=UPPER)]
    if known(*(trace.y for trace in errors)):
        panels.append(scene.panel(axis, errors, "error", "deg", title="error"))
    found = [(trace.name, trace.y) for trace in errors]
    caption = captions.attitude(name, panels[0].shades, found)
    return scene.figure("attitude", f"{name.capitalize()} as measured and corrected", caption, panels, axis)


def _gyro(scene: ReplayScene, longest: RecordedReplay) -> Figure | None:
    """The measured body rate."""
    rate = np.degrees(longest.measured.body_rate)
    if not known(rate):
        return None
    lines = [Trace(MEASURED, "truth", longest.flight.time, column) for column in rate.T]
    panels = [scene.panel(axis, [line], AXES[axis], "deg/s") for axis, line in enumerate(lines)]
    return scene.figure("gyro", "Gyro as measured", captions.gyro(rate), panels)


def _gyro_correction(scene: ReplayScene) -> Figure | None:
    """What the observers add to the body rate, where one of them does."""
    changes = [(run, np.degrees(run.corrected.body_rate - run.measured.body_rate)) for run in scene.runs]
    changes = [(run, change) for run, change in changes if worth(change)]
    if not changes:
        return None
    panels: list[Panel] = []
    for axis, name in enumerate(AXES):
        lines = [scene.trace(run, change[:, axis]) for run, change in changes]
        panels.append(scene.panel(axis, lines, name, "deg/s"))
    last = [(scene.label(run), change[np.isfinite(change).all(axis=1)][-1]) for run, change in changes]
    caption = captions.gyro_correction(last)
    return scene.figure("gyro_correction", "Correction of the gyro", caption, panels)


def _angle(reading: Reading, axis: int) -> Floats:
    """An angle [deg] (n,)."""
    return np.degrees(reading.angles[:, axis])


def _faultless(run: RecordedReplay, axis: int) -> Floats:
    """The measured angle without the true fault [deg] (n,)."""
    return np.degrees(wrap(run.measured.angles[:, axis] - run.flight.fault[:, axis]))


def _off(run: RecordedReplay, reading: Reading, axis: int) -> Floats:
    """An angle less the measured one without the fault [deg] (n,), wrapped."""
    faultless = run.measured.angles[:, axis] - run.flight.fault[:, axis]
    return np.degrees(wrap(reading.angles[:, axis] - faultless))
