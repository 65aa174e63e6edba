"""The path that attitude and accelerometer say against the velocity that is known.

    r(t) = R' (1/T) (integral of (R f - g) dt - delta v),    over a window T around t, in body axes

R is the logged attitude, f the specific force. r is next to zero, whatever vehicle and wind do. An offset b
of the accelerometer shows as r = b. An attitude that follows a gyro with an offset b of its rate
tilts away, so that r grows as g b t. A velocity that jumps shows for one window. The receiver's delay is the
one that leaves least.

Without satellites the window is longer: an estimated velocity finds back within it, and without one nothing
here changes its velocity by more than `GAIN` meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from quadftc_model.rotations import to_body, to_earth
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight, near_any
from quadftc_replay.inspection.whitening import Floats, runs_of

WINDOW, LONG_WINDOW = 1.0, 10.0  # s; T, with and without satellites
GAIN = 15.0  # m/s
STEP = 0.1  # s; between two windows
DELAYS = np.arange(0.0, 0.45, 0.05)  # s; of satellite receivers
LEAST = 20  # windows
CALM = 0.3  # 1; quantile of the changes that is the usual one; chi² of three components is 1.4 there
LEVEL = 6.0  # standard deviations
SMALLEST = 1.0  # m/s²; 6 deg of tilt, which estimators reach without a fault
TURN = 0.7  # rad; between two attitudes, beyond which the way between them is not known
USABLE = 0.5  # m/s²; sigma of a path that says anything
ONSET = 0.1  # 1; of the window: standard deviation of the begin that the path tells
# windows before and after, over which causes are compared: later, estimators have learned
AROUND = (2.0, 1.5)
EXPLAINED = 0.75  # 1; share of what parts that a sensor makes; aliased vibration comes on several axes


class Path(NamedTuple):
    """What specific force and velocity do not agree on."""

    time: Floats  # (n,) middle of the window [s]
    rest: Floats  # (n, 3) r [m/s²], body axes; NaN where it is not known
    sigma: float  # m/s²; of each component, in calm
    window: float  # s
    smallest: float  # m/s²; of what is a fault


class Cause(NamedTuple):
    """What explains a path that parts from the velocity."""

    component: str  # gyro, accelerometer or gps
    element: str
    onset: float  # s
    size: float  # rad/s, m/s² or m/s
    sigma: float
    score: float  # standard deviations
    second: str  # the next best cause


class Pushes(NamedTuple):
    """By how much the velocity changes over windows, over their time; earth axes [m/s²], NaN: not known."""

    time: Floats  # (n,) middle of the window [s]
    said: Floats  # (n, 3) by attitude and specific force
    true: Floats  # (n, 3) by the velocity, as much later as leaves least


def pushes_of(
    attitude: Signal | None, force: Signal | None, velocity: Signal | None, window: float = WINDOW
) -> Pushes | None:
    """Compare how the velocity changes; None where a signal is missing or they hardly overlap."""
    if attitude is None or force is None or velocity is None:
        return None
    if min(map(len, (attitude, force, velocity))) < LEAST:
        return None
    begin = max(float(each.time[0]) for each in (attitude, force, velocity)) + 0.5 * window
    end = min(float(each.time[-1]) for each in (attitude, force, velocity)) - 0.5 * window - DELAYS[-1]
    time = np.arange(begin, end, STEP)
    if len(time) < LEAST:
        return None
    q = attitude_at(attitude, force.time)
    earth = to_earth(q, np.nan_to_num(force.value)) - [0.0, 0.0, STANDARD_GRAVITY]
    said = _change(time, Signal(force.time, earth).integral(), window) / window
    delayed = [_change(time + delay, velocity, window) / window for delay in DELAYS.tolist()]
    true = min(delayed, key=lambda each: float(np.median(np.linalg.norm(said - each, axis=1))))
    known = _covered(time, velocity.time, DELAYS[-1], window) & _covered(time, force.time, 0.0, window)
    cosine = np.abs(np.sum(attitude.value[1:] * attitude.value[:-1], axis=1))
    tumbles = attitude.time[1:][2.0 * np.arccos(np.clip(cosine, 0.0, 1.0)) > TURN]
    known &= ~near_any(time, tumbles, 0.5 * window)
    if known.sum() < LEAST:
        return None
    return Pushes(time, np.where(known[:, None], said, np.nan), np.where(known[:, None], true, np.nan))


def path_of(
    attitude: Signal | None,
    force: Signal | None,
    velocity: Signal | None,
    window: float = WINDOW,
    smallest: float = SMALLEST,
) -> Path | None:
    """Compare the paths; None where a signal is missing or they hardly overlap."""
    pushes = pushes_of(attitude, force, velocity, window)
    if pushes is None or attitude is None:
        return None
    time, known = pushes.time, np.isfinite(pushes.said[:, 0])
    rest = to_body(attitude_at(attitude, time), pushes.said - pushes.true)
    apart = round(window / STEP)
    changes = np.linalg.norm(rest[apart:] - rest[:-apart], axis=1)[known[apart:] & known[:-apart]]
    if len(changes) < LEAST:
        return None
    usual = float(np.quantile(changes, CALM)) / np.sqrt(2.0 * 1.4)  # of two times, of three components
    return Path(time, rest, usual, window, smallest) if usual < USABLE else None


def known_path(log: FlightLog, force: Signal | None) -> Path | None:
    """Compare the path of an accelerometer with that of satellites, else the estimated one, else a bound."""
    if log.gps_velocity is not None:
        return path_of(log.attitude, force, log.gps_velocity)
    if log.velocity is not None:
        return path_of(log.attitude, force, log.velocity, LONG_WINDOW)
    still = None if force is None else Signal(force.time, np.zeros_like(force.value))
    return path_of(log.attitude, force, still, 2.0 * LONG_WINDOW, 0.5 * GAIN / LONG_WINDOW)


def attitude_at(attitude: Signal, time: Floats) -> Floats:
    """Attitudes (m, 4) at other times, straight between samples."""
    q = attitude.value.copy()
    flips = np.sum(q[1:] * q[:-1], axis=1) < 0.0
    q[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    found = Signal(attitude.time, q).at(time)
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9)


def _change(time: Floats, signal: Signal, window: float) -> Floats:
    return signal.at(time + 0.5 * window) - signal.at(time - 0.5 * window)


def _covered(time: Floats, at: Floats, delay: float, window: float) -> np.ndarray:
    """Whether no gap of a signal is in the window around each time (n,)."""
    gaps = np.flatnonzero(np.diff(at) > 0.5 * WINDOW)
    dark = np.zeros(len(time), np.bool_)
    for gap in gaps.tolist():
        dark |= (time > at[gap] - 0.5 * window - delay) & (time < at[gap + 1] + 0.5 * window)
    return ~dark


def causes_of(flight: Flight, path: Path) -> Iterator[Cause]:
    """Name the first cause of a path that parts from the velocity in flight."""
    size = np.nan_to_num(np.linalg.norm(path.rest, axis=1))
    apart = flight.is_calm(path.time) & (size > path.smallest + LEVEL * path.sigma)
    for run in runs_of(apart):
        if path.time[run.stop - 1] - path.time[run.start] >= 0.5 * path.window:
            before = np.flatnonzero(~(size[: run.start] > path.smallest))
            start = int(before[-1]) + 1 if len(before) else 0  # it may have begun before take-off
            yield from _best_cause(path, float(path.time[start]))
            return


def _best_cause(path: Path, moment: float) -> Iterator[Cause]:
    """Compare all causes around a moment [s], by what they leave; none counts that leaves much."""
    span = moment - AROUND[0] * path.window, moment + AROUND[1] * path.window
    rows = slice(*np.searchsorted(path.time, span))
    time, rest = path.time[rows], np.nan_to_num(path.rest[rows])
    found: list[tuple[float, Cause]] = []
    for onset in np.arange(moment - 1.5 * path.window, moment + 0.5 * path.window, 0.5 * STEP).tolist():
        for name, shape, axis, scale in _shapes(time - onset, path.window):
            along = rest[:, axis]
            power = float(shape @ shape)
            amount = float(shape @ along) / max(power, 1e-9)
            left = float(np.sum(rest**2)) - amount**2 * power
            sigma = max(path.sigma, np.sqrt(max(left, 0.0) / rest.size))
            score = abs(amount) * np.sqrt(power) / max(sigma, 1e-9)
            spread = abs(scale) * sigma / np.sqrt(max(power, 1e-9))
            found.append((left, Cause(*name, onset, amount * scale, float(spread), score, "")))
    found.sort(key=lambda each: each[0])
    left, best = found[0]
    other = next((each for _, each in found if each[:2] != best[:2]), best)
    if left < (1.0 - EXPLAINED) * float(np.sum(rest**2)):
        yield best._replace(second=f"{other.component}/{other.element}".rstrip("/"))


def _shapes(late: Floats, window: float) -> Iterator[tuple[tuple[str, str], Floats, int, float]]:
    """Each cause: its name, what it adds to r at times after its onset (n,), where, and its unit's scale."""
    half = 0.5 * window
    step = np.clip((late + half) / window, 0.0, 1.0)
    ramp = np.where(late > half, late, 0.5 * np.clip(late + half, 0.0, None) ** 2 / window)
    pulse = (np.abs(late) < half) / window
    for axis, element in enumerate("xyz"):
        yield ("accelerometer", element), step, axis, 1.0
        yield ("gps", ""), pulse, axis, 1.0
    yield ("gyro", "x"), ramp, 1, -1.0 / STANDARD_GRAVITY
    yield ("gyro", "y"), ramp, 0, 1.0 / STANDARD_GRAVITY
