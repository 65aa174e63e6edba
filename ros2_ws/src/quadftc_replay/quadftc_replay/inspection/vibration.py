"""Vibration as the autopilot measures it before its filters, and samples at the accelerometer's limit.

Loggers keep 10 to 50 samples a second, after filters: vibration hardly shows in them, or shows aliased. A
level that rises in flight to a multiple of what it was, and stays, means that something came loose or broke.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, confidence, make_found
from quadftc_replay.inspection.whitening import runs_of

FEWEST = 20  # samples in flight
LASTS = 2.0  # s
CALM = 0.3  # 1; quantile of the levels in flight that is the usual one
RISEN = 4.0  # 1; times the usual level
FELT = 5.0  # m/s²; half of gravity: Flight Review warns from here on
HARMFUL = 30.0  # m/s²; from here on ArduPilot expects its estimator to fail


def vibration_findings(flight: Flight) -> Iterator[Found]:
    """Say when the vibration rises in flight, or is harmful all along."""
    level = flight.log.vibration
    if level is None:
        return
    time, axes = level.time, np.nan_to_num(level.value)
    value = np.sqrt(np.mean(axes**2, axis=1))
    watched = flight.is_calm(time)
    if watched.sum() < FEWEST:
        return
    usual = float(np.quantile(value[watched], CALM))
    limit = min(max(RISEN * usual, FELT), HARMFUL)
    for run in runs_of(watched & (value > limit)):
        start, end = float(time[run.start]), float(time[run.stop - 1])
        risen = float(np.median(value[run]))
        if end - start < LASTS or (usual < HARMFUL and risen < 0.5 * RISEN * usual):
            continue  # what wanders about the harmful level all along has not risen
        lower = np.flatnonzero(watched[: run.start] & (value[: run.start] < usual + 0.25 * (risen - usual)))
        has_risen = len(lower) > LASTS * level.rate  # else nobody knows that it was lower
        if not has_risen and usual < HARMFUL:
            continue
        onset = float(time[lower[-1] + 1]) if has_risen else start
        low = RISEN * np.median(axes[watched & (value <= limit)], axis=0) if has_risen else HARMFUL
        grown = np.median(axes[run], axis=0) > low
        element = ",".join(BODY_AXES[k] for k in np.flatnonzero(grown)) if axes.shape[1] > 1 else ""
        other = f"by {usual:.3g} m/s² before" if has_risen else f"beyond {HARMFUL:.3g} m/s² all along"
        said = [f"the accelerometers vibrate by {risen:.3g} m/s² on each axis, {other}"]
        clips = flight.log.clips
        if clips is not None and (count := float(np.ptp(clips.at(np.array([start, end]))))) > 0:
            said.append(f"{count:.0f} samples are at the limit of the accelerometer meanwhile")
        yield make_found(
            *("vibration", element, "rise" if has_risen else "noise", onset),
            end_s=None if flight.log.end - end < LASTS else end,
            size=risen - usual if has_risen else risen,
            sigma=float(np.std(value[run])),
            unit="m/s^2",
            probability=confidence(risen, limit),
            evidence=tuple(said),
            curve=Curve("vibration", "m/s²", time, {"level": value}),
            is_direct=True,
        )
        return
