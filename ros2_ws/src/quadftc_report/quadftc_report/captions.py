"""Captions of figures: one sentence each, with numbers from all samples of what is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from quadftc_report.description import Mark, Shade
from quadftc_report.wording import NO_VALUE, listing, plain, short

Floats = NDArray[np.float64]
Named = Sequence[tuple[str, Floats]]  # label of each run, and what it gives

LISTED = 3  # windows of one kind that are listed one by one
NOT_ESTIMATED = "no run estimates it."


def fault(axis: str, shades: Sequence[Shade], marks: Sequence[Mark], errors: Named) -> str:
    """Caption of a fault and its estimates, from their errors [deg] (n,)."""
    what, events = f"{axis.capitalize()} fault", _events(shades, marks, "" if shades else "there is none")
    if not errors:
        return f"{what}{events}; {NOT_ESTIMATED}"
    found = _of_each((label, f"{_rms(e)} deg RMS, {_peak(e)} deg at most") for label, e in errors)
    return f"{what} and its estimate{events}; error of the estimate {found}."


def tracking(axis: str, shades: Sequence[Shade], marks: Sequence[Mark], errors: Named) -> str:
    """Caption of the tracking of one angle, from the errors [deg] (n,) of the runs."""
    found = _of_each((label, f"{_rms(e)} deg") for label, e in errors)
    what = f"{axis.capitalize()} angle and its reference{_events(shades, marks)}"
    return f"{what}; RMS tracking error {found}."


def attitude(axis: str, shades: Sequence[Shade], errors: Named) -> str:
    """Caption of a measured and a corrected angle, from what they are off by [deg] (n,)."""
    what = f"{axis.capitalize()} angle as the observers saw it, and as they pass it on{_events(shades, ())}"
    if not errors:
        return f"{what}."
    found = _of_each((label, f"{_rms(e)} deg RMS, {_peak(e)} deg at most") for label, e in errors)
    return f"{what}; off the angle without the fault by {found}."


def states(declared: Named) -> str:
    """Caption of the states, from the time [s] (3,) for which each axis is declared faulty."""
    found = _of_each((label, f"{_listed(times)} s") for label, times in declared)
    return f"State of each axis; declared faulty (faulty or recovering) in roll, pitch, yaw for {found}."


def gyro(rate: Floats) -> str:
    """Caption of the body rate [deg/s] (n, 3)."""
    return f"Body rate of each axis as the observers saw it; at most {_per_axis(rate, _peak)} deg/s."


def gyro_correction(last: Named) -> str:
    """Caption of what is added to the gyro, from its last value [deg/s] (3,)."""
    found = _of_each((label, f"{_listed(value)} deg/s") for label, value in last)
    what = "Corrected less measured body rate of each axis"
    return f"{what}; at the end, in roll, pitch, yaw, {found}."


def disturbance(marks: Sequence[Mark], errors: Named) -> str:
    """Caption of the disturbance d and its estimates, from their errors [rad/s²] (n, 3)."""
    events = _events((), marks, "" if marks else "there is none")
    what = f"Disturbance d of each axis{events}, as an angular acceleration"
    if not errors:
        return f"{what}; {NOT_ESTIMATED}"
    found = _of_each((label, f"{_per_axis(e, _rms)} rad/s²") for label, e in errors)
    return f"{what}, and its estimate; RMS error in roll, pitch, yaw {found}."


def sliding_variable(inside: Sequence[tuple[str, float]]) -> str:
    """Caption of the sliding variable S, from the share of samples in which each run is in its layer."""
    what = "Sliding variable S of each axis"
    if not inside:
        return f"{what}."
    found = _of_each((label, f"{plain(100.0 * share)} % of the time") for label, share in inside)
    return f"{what}; within its boundary layer ±Φ {found}."


def torque(commands: Named, authority: Floats) -> str:
    """Caption of the torque commands [N m] (n, 3), from the largest that the rotors can give (3,)."""
    found = _of_each((label, f"{_per_axis(command, _peak)} N m") for label, command in commands)
    limits = ", ".join(plain(limit) for limit in authority)
    return (
        f"Torque command of each axis; at most, in roll, pitch, yaw, {found}, where the rotors can give"
        f" {limits} N m."
    )


def _events(shades: Sequence[Shade], marks: Sequence[Mark], remark: str = "") -> str:
    """Windows and moments, in brackets."""
    texts = [remark] if remark else []
    for label in dict.fromkeys(shade.label for shade in shades):
        windows = [(shade.start, shade.stop) for shade in shades if shade.label == label]
        name = label if len(windows) == 1 else f"{len(windows)} {label}s"
        if len(windows) > LISTED:
            windows = [(windows[0][0], windows[-1][1])]
        times = [f"{plain(start)} to {plain(stop)} s" for start, stop in windows]
        texts.append(f"{name}, {listing(times)}")
    for label in dict.fromkeys(mark.label for mark in marks):
        times = sorted({mark.time for mark in marks if mark.label == label})
        texts.append(f"{label} at {listing([plain(time) for time in times])} s")
    return f" ({'; '.join(texts)})" if texts else ""


def _of_each(texts: Iterable[tuple[str, str]]) -> str:
    """What each run gives; the run is named when there are several."""
    listed = list(texts)
    if len(listed) == 1:
        return listed[0][1]
    between = "; " if any("," in text for _, text in listed) else ", "
    return between.join(f"{text} ({label})" for label, text in listed)


def _per_axis(columns: Floats, measure: Callable[[Floats], str]) -> str:
    return ", ".join(measure(column) for column in columns.T)


def _listed(values: Floats) -> str:
    return ", ".join(short(value) for value in values.tolist())


def _rms(values: Floats) -> str:
    known = values[np.isfinite(values)]
    return short(float(np.sqrt(np.mean(known * known)))) if len(known) else NO_VALUE


def _peak(values: Floats) -> str:
    known = values[np.isfinite(values)]
    return short(float(np.max(np.abs(known)))) if len(known) else NO_VALUE
