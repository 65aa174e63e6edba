"""What the position controller flies by, against what the vehicle's own estimator says.

Both are in one computer and follow one clock. A position that parts from the estimate was changed on the way
to the controller. ArduPilot logs the acceleration that follows from the lean, in earth axes: where it is
turned about the vertical, the heading was changed so. Later ones filter it, and lag behind a fast turn.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_model.rotations import euler_from_quaternion, to_earth
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.path import attitude_at
from quadftc_replay.inspection.whitening import Floats, runs_of, scale

LASTS = 0.5  # s; of what is no late message
FAR = 1.0  # m; by which two cores of an estimator may differ in healthy flight
SMALLEST = 0.01  # m, rad; standard deviation, at least
LEAN = 1.0  # m/s²; of a lean that has a direction
UPRIGHT = 0.2  # 1; cosine of the tilt up to which a lean is an acceleration
FEWEST = 20  # samples
SAME = 0.2  # 1; by which the sizes of two accelerations may differ
TURNED = 0.1  # rad; 6 deg of heading, which compasses reach without a fault
LEVEL = 6.0  # standard deviations


def flown_findings(flight: Flight) -> Iterator[Found]:
    """Name what the position controller takes for other than the estimator says."""
    yield from _positions(flight)
    yield from _headings(flight)


def _positions(flight: Flight) -> Iterator[Found]:
    flown, own = flight.log.flown_position, flight.log.position
    if flown is None or own is None or min(len(flown), len(own)) < 2:
        return
    time, apart = flown.time, np.nan_to_num(flown.value - own.at(flown.time))
    speed = np.linalg.norm(np.gradient(own.at(time), time, axis=0), axis=1)
    size = np.linalg.norm(apart, axis=1)
    limit = FAR + speed * (1.0 / max(own.rate, 1e-9) + 1.0 / max(flown.rate, 1e-9))
    for run in _lasting(time, (size > limit) & (time < flight.until)):
        middle = np.median(apart[run], axis=0)
        axis = int(np.argmax(np.abs(middle)))
        said = (
            f"the position controller flies by a position {np.linalg.norm(middle):.3g} m from the"
            f" estimator's, east {middle[0]:+.3g}, north {middle[1]:+.3g}, up {middle[2]:+.3g} m"
        )
        names = ("east", "north", "up")
        sigma = max(scale(apart[run, axis] - middle[axis]), SMALLEST)
        lines = {name: apart[:, k] for k, name in enumerate(names)}
        title = "position of the controller less that of the estimator"
        yield make_found(
            *("position", names[axis], "offset", float(time[run.start])),
            end_s=_end(flight, time, run),
            size=float(middle[axis]),
            sigma=sigma,
            unit="m",
            probability=confidence(float(np.median(size[run] / limit[run])), 1.0),
            ambiguous_with=("gps",),
            evidence=(said,),
            curve=Curve(title, "m", time, lines),
            is_direct=True,
        )
        return


def _headings(flight: Flight) -> Iterator[Found]:
    """Say by which angle the lean that the controller sees is turned about the vertical."""
    log, flown = flight.log, flight.log.flown_acceleration
    if flown is None or log.attitude is None or len(flown) < FEWEST or len(log.attitude) < FEWEST:
        return
    time, seen = flown
    up = to_earth(attitude_at(log.attitude, time), np.array([0.0, 0.0, 1.0]))
    lean = STANDARD_GRAVITY * up[:, :2] / np.maximum(up[:, 2:], UPRIGHT)
    size = np.linalg.norm(lean, axis=1)
    known = (size > LEAN) & (np.abs(np.linalg.norm(seen, axis=1) - size) < SAME * size)
    known &= flight.in_flight(time) & (_turns(log.attitude, time) < TURNED)
    if known.sum() < FEWEST:
        return
    cross = lean[:, 0] * seen[:, 1] - lean[:, 1] * seen[:, 0]  # of a turn that is counterclockwise
    angle = np.where(known, np.arctan2(cross, np.sum(seen * lean, axis=1)), np.nan)
    sigma = scale(angle[known] - np.median(angle[known])) + SMALLEST
    for run in _lasting(time, np.abs(np.nan_to_num(angle)) > TURNED + LEVEL * sigma):
        middle = float(np.median(angle[run]))
        said = f"the lean that the position controller sees is turned by {np.degrees(middle):+.0f} deg"
        title = "heading of the controller less that of the estimator"
        yield make_found(
            *("attitude", "yaw", "offset", float(time[run.start])),
            end_s=_end(flight, time, run),
            size=middle,
            sigma=sigma,
            unit="rad",
            probability=confidence(abs(middle), TURNED + LEVEL * sigma),
            ambiguous_with=("gyro/z",),
            evidence=(said + " about the vertical: its heading is not the estimator's",),
            curve=Curve(title, "rad", time, {"angle": angle}),
            is_direct=True,
        )
        return


def _turns(attitude: Signal, time: Floats) -> Floats:
    """By how much the heading has changed within `LASTS` (n,) [rad]."""
    late, early = (euler_from_quaternion(attitude_at(attitude, each))[:, 2] for each in (time, time - LASTS))
    return np.abs(np.angle(np.exp(1j * (late - early))))


def _lasting(time: Floats, mask: np.ndarray) -> list[slice]:
    return [run for run in runs_of(mask) if time[run.stop - 1] - time[run.start] >= LASTS]


def _end(flight: Flight, time: Floats, run: slice) -> float | None:
    """Return when a run ends [s]; None: it lasts to the end of the log."""
    last = float(time[run.stop - 1])
    return None if flight.log.end - last < LASTS else last
