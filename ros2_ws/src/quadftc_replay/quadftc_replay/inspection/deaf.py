"""A gyro that stands still, but for noise, while the rotors turn the vehicle.

Behind an autopilot's filters a gyro that is stuck repeats no reading: noise is on it. Where the controller
asks for a torque on its axis, and goes on asking, the torque less what the motion takes of it (r of
`rotor_step`) leaves what it was. A lost rotor moves r on both axes, and the gyro as well.
"""

from __future__ import annotations

import numpy as np

from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, component_name, confidence, make_found
from quadftc_replay.inspection.readings import CALM, moving_noise
from quadftc_replay.inspection.rotor_step import (
    ASIDE,
    BEFORE,
    ENDED,
    FEWEST,
    FLOOR,
    LEAST_FLOWN,
    QUIET,
    WINDOWS,
    Torque,
    fit,
    scatter,
    steps,
    torque_of,
)
from quadftc_replay.inspection.whitening import Floats, runs_of

WINDOW = WINDOWS[1]  # s; over which the torque has to be asked for in vain


def deaf_findings(flight: Flight) -> list[Found]:
    """Name the first axis of the main gyro on which torques are not answered."""
    torque = torque_of(flight)
    if torque is None or flight.gyro is None:
        return []
    name, gyro = flight.gyro
    flying = flight.in_flight(gyro.time)
    if flying.sum() < LEAST_FLOWN:
        return []
    noise: Floats = np.quantile(moving_noise(gyro)[flying], CALM, axis=0)
    moments, scores = _unanswered(torque, torque)
    for axis in range(2):
        value = np.nan_to_num(gyro.value[:, axis])
        candidates: list[int] = np.flatnonzero(_is_alone(scores, axis)).tolist()
        for k in candidates:
            row = int(np.searchsorted(gyro.time, float(moments[k]) + WINDOW))
            near = value[slice(*np.searchsorted(gyro.time, (moments[k], moments[k] + WINDOW)))]
            if not len(near) or np.ptp(near) > 2.0 * QUIET * noise[axis]:
                continue
            still = np.abs(value - np.median(near)) < QUIET * noise[axis]
            run = next((each for each in runs_of(still) if each.start <= row < each.stop), None)
            if run is None:
                continue
            onset, end = float(gyro.time[run.start]), float(gyro.time[run.stop - 1])
            before = torque._replace(flying=torque.flying & (torque.time < onset))
            if before.flying.sum() < LEAST_FLOWN:
                continue
            at, sure = _unanswered(torque, before)
            inside = (at >= onset) & (at + WINDOW <= end)
            confirmed = _is_alone(sure, axis) & inside
            if not confirmed.any():
                continue
            score = float(sure[confirmed, axis].max())
            said = (
                f"it stays within {np.ptp(value[run]):.2g} rad/s for {end - onset:.2g} s,"
                f" while the rotors turn the vehicle about this axis, by {score:.0f} standard deviations",
            )
            found = make_found(
                *(component_name("gyro", name), BODY_AXES[axis], "stuck", onset),
                curve=Curve(f"gyro {BODY_AXES[axis]}", "rad/s", gyro.time, {"reading": value}),
                end_s=None if run.stop == len(gyro) else end,
                probability=confidence(score, 0.5 * ENDED),
                evidence=said,
            )
            return [found]
    return []


def _unanswered(torque: Torque, known: Torque) -> tuple[Floats, Floats]:
    """Steps of r in flight in standard deviations (m, 2), and their times (m,); ``known`` makes the model."""
    factors, _ = fit(known, np.zeros_like(torque.asked))
    part = torque.rows(np.flatnonzero(torque.flying))
    rest = part.asked - np.einsum("nak,ak->na", part.columns, factors)
    period = float(np.median(np.diff(part.time)))
    before, count = max(2 * FEWEST, round(BEFORE / period)), max(FEWEST, round(WINDOW / period))
    k = np.arange(FEWEST, len(rest) - count + 1)
    step = steps(rest, k, before, count)
    return part.time[k], np.abs(step) / np.hypot(FLOOR, scatter(step) if len(k) else 0.0)


def _is_alone(scores: Floats, axis: int) -> np.ndarray:
    """Whether r moves far on one axis and not on the other (m,)."""
    return (scores[:, axis] > ENDED) & (scores[:, 1 - axis] < ASIDE * scores[:, axis])
