"""A log made ready for the tests: its main gyro, and when the vehicle flies.

Phases come from the rotors (speeds, else commands) or the thrust command: a vehicle flies while they are
above a share of their usual level, unless the ground holds it. Then they give less than its weight, and the
accelerometer feels all of it. An impact in the last seconds ends a flight. Where none of them is logged, or
the level tells nothing, phases are not known, and the whole log counts.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import MAIN, FlightLog, Signal
from quadftc_replay.inspection.whitening import Floats, Mask, runs_of

SMOOTH = 0.3  # s; mean of the rotors' level
FLYING = 0.6  # 1; share of the usual level
SPINNING = 0.3  # 1; share of the largest level, of rotors that turn at all
BRIDGED = 0.5  # s; shorter pauses belong to the flight
SHORTEST = 2.0  # s; of a flight
TAKE_OFF, LANDING = 1.5, 0.5  # s; left out at the begin and at the end
IMPACT = 3.5 * STANDARD_GRAVITY  # m/s²; specific force of a collision or a hard landing
SHAKEN = 2.0  # 1; times what most seconds reach, where vibration alone exceeds that
CRASH = 3.0  # s; after an impact, at which the vehicle lies still
BEFORE_IMPACT = 0.3  # s
AFTER_IMPACT = 0.1  # s; around which nothing is judged
STILL = 0.05  # rad/s; scatter of a gyro of a vehicle that lies still
CLIMBS = 0.3  # m/s; over a second; a velocity's noise (ArduPilot EK3_VELNE_M_NSE, PX4 EKF2_GPS_V_NOISE)
HELD = 0.1  # 1; share of its weight that the ground holds
RESTS = 2.0  # s; of a stretch at rest


class Interval(NamedTuple):
    """A stretch of time [s]."""

    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Flight:
    """A log with its phases."""

    log: FlightLog
    intervals: tuple[Interval, ...]  # in flight
    phases_known: bool
    impacts: Floats  # times [s]
    rate_is_estimated: bool  # no gyro is logged: `gyro` is the vehicle's own estimate
    crash: float | None  # time of the impact that ends the flight [s]
    lifts_off: bool  # whether it flies at all, as far as anybody knows

    @functools.cached_property
    def gyro(self) -> tuple[str, Signal] | None:
        """Name and samples of the main gyro: the one without a name, else the one with the most samples."""
        gyros: Mapping[str, Signal] = {name: each for name, each in self.log.gyros.items() if len(each) > 1}
        if MAIN in gyros:
            return MAIN, gyros[MAIN]
        if gyros:
            name = max(gyros, key=lambda each: len(gyros[each]))
            return name, gyros[name]
        return (MAIN, self.log.body_rate) if self.log.body_rate is not None else None

    @property
    def until(self) -> float:
        """Time until which the vehicle moves as rotors and air make it [s]."""
        return self.log.end if self.crash is None else self.crash - AFTER_IMPACT

    @functools.cached_property
    def duration(self) -> float:
        """Time in flight [s]."""
        return sum(each.end - each.start for each in self.intervals)

    def in_flight(self, time: Floats) -> Mask:
        """Whether the vehicle flies at each time (n,)."""
        inside = np.zeros(len(time), np.bool_)
        for start, end in self.intervals:
            inside |= (time >= start) & (time <= end)
        return inside

    def is_calm(self, time: Floats) -> Mask:
        """Whether the vehicle flies at each time (n,), and there is no impact around it."""
        return self.in_flight(time) & ~self.near_impact(time)

    def near_impact(self, time: Floats) -> Mask:
        """Whether there is an impact around each time (n,)."""
        return near_any(time, self.impacts, AFTER_IMPACT)


def near_any(time: Floats, moments: Floats, reach: float) -> Mask:
    """Whether any of the moments, in order, is within reach of each time (n,)."""
    return np.searchsorted(moments, time - reach) < np.searchsorted(moments, time + reach, side="right")


def prepare(log: FlightLog) -> Flight:
    """Find the phases of a log."""
    impacts = _find_impacts(log)
    level = rotor_level(log)
    turning = [] if level is None else _turning(level)
    intervals = () if level is None else _flown(level, log.end, _off_the_ground(log, level, turning))
    known = bool(intervals)
    if level is not None and not known:
        intervals = _flown(level, log.end, turning)
    crash = _crash(log, impacts, intervals[-1].start if intervals else 0.0)
    if crash is not None:
        cut = (Interval(start, min(end, crash - BEFORE_IMPACT)) for start, end in intervals)
        intervals = tuple(each for each in cut if each.end > each.start)
    whole = (Interval(0.0, log.end if crash is None else crash - BEFORE_IMPACT),)
    has_gyro = any(len(each) > 1 for each in log.gyros.values())
    is_estimated = not has_gyro and log.body_rate is not None
    return Flight(log, intervals or whole, known, impacts, is_estimated, crash, known or not intervals)


def _crash(log: FlightLog, impacts: Floats, start: float) -> float | None:
    """Return when an impact ends a flight [s]: soon after it the vehicle lies still, or the log ends."""
    gyro = next((each for each in log.gyros.values() if len(each) > 1), log.body_rate)
    if gyro is None:
        return None
    size = np.linalg.norm(np.nan_to_num(gyro.value), axis=1)
    for impact in impacts[impacts > start].tolist():
        first, last = np.searchsorted(gyro.time, (impact + CRASH, impact + 2.0 * CRASH))
        if first >= len(size) - 1 or float(np.median(size[first:last])) < STILL:
            return impact
    return None


def rotor_level(log: FlightLog) -> Signal | None:
    """Return what lifts the vehicle, (n, 1): the first of speeds, commands and thrust that is fast enough.

    None: none is logged. Where all are slow, it is the fastest.
    """
    speeds, commands, thrust = (
        None if each is None or len(each) < 2 else each
        for each in (log.rotor_speeds, log.rotor_commands, log.thrust_command)
    )
    levels = [
        *([] if speeds is None else [Signal(speeds.time, row_means(speeds.value**2))]),
        *([] if commands is None else [Signal(commands.time, row_means(commands.value))]),
        *([] if thrust is None else [thrust]),
    ]
    fast = (each for each in levels if each.rate * SMOOTH > 1.0)
    return next(fast, max(levels, key=lambda each: each.rate, default=None))


def row_means(values: Floats) -> Floats:
    """Mean of the finite values of each row (n, 1); NaN where there is none."""
    there = np.isfinite(values)
    count = there.sum(axis=1, keepdims=True)
    total = np.where(there, values, 0.0).sum(axis=1, keepdims=True)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _find_impacts(log: FlightLog) -> Floats:
    """Times at which the force is beyond what motion makes (m,); a sensor that shakes alone is none."""
    found = [np.zeros(0)]
    for each in log.accelerometers.values():
        if len(each):
            size = np.nan_to_num(np.linalg.norm(each.value, axis=1))
            limit, hard = _beyond(each.time, size, IMPACT)
            for run in hard:
                inside = (each.time >= run.start) & (each.time < run.end) & (size > limit)
                if run.end - run.start <= 2.0 * CRASH or _is_shaken(log, run):
                    found.append(each.time[inside])
    return np.unique(np.concatenate(found))


def _beyond(time: Floats, size: Floats, least: float) -> tuple[float, list[Interval]]:
    """Return a limit of a size (n,), by what most seconds reach, and the seconds on end beyond it."""
    starts = np.flatnonzero(np.diff(np.floor(time), prepend=-1.0))
    largest = np.maximum.reduceat(size, starts)
    limit = max(least, SHAKEN * float(np.median(largest)))
    seconds: Floats = np.floor(time[starts])
    runs = runs_of(largest > limit)
    return limit, [Interval(float(seconds[run.start]), float(seconds[run.stop - 1]) + 1.0) for run in runs]


def _is_shaken(log: FlightLog, span: Interval) -> bool:
    """Whether the vehicle turns faster in a span than in most seconds."""
    gyro = next((each for each in log.gyros.values() if len(each) > 1), log.body_rate)
    if gyro is None:
        return True
    size = np.linalg.norm(np.nan_to_num(gyro.value), axis=1)
    inside = size[slice(*np.searchsorted(gyro.time, span))]
    limit, _ = _beyond(gyro.time, size, 0.0)
    return bool(len(inside) and np.quantile(inside, 0.9) > limit)


def _turning(level: Signal) -> list[Interval]:
    """Stretches, long enough for a flight, in which the rotors are above a share of their usual level."""
    time, mean = level.time, smooth(level)[:, 0]
    turning = mean[mean > SPINNING * mean.max()] if mean.max() > 0.0 else mean[:0]
    if not len(turning):
        return []
    found: list[Interval] = []
    for run in runs_of(mean > FLYING * float(np.median(turning))):
        first, last = float(time[run.start]), float(time[run.stop - 1])
        if found and first - found[-1].end < BRIDGED:
            found[-1] = Interval(found[-1].start, last)
        else:
            found.append(Interval(first, last))
    return [each for each in found if each.end - each.start >= SHORTEST]


def _flown(level: Signal, end: float, flights: Iterable[Interval]) -> tuple[Interval, ...]:
    """Flights without take-off and landing; those that are long enough."""
    first, last = float(level.time[0]), min(end, float(level.time[-1]))
    trimmed = (_trim(each, first, last) for each in flights)
    return tuple(each for each in trimmed if each.end - each.start >= SHORTEST)


def smooth(signal: Signal) -> Floats:
    """Means of a signal (n, k) over `SMOOTH` (n, k)."""
    count = max(1, round(SMOOTH * signal.rate))
    return np.asarray(ndimage.uniform_filter1d(np.nan_to_num(signal.value), count, axis=0), np.float64)


def _off_the_ground(log: FlightLog, level: Signal, flights: Sequence[Interval]) -> Iterator[Interval]:
    """Leave out where the ground holds a vehicle whose rotors turn fast, before take-off and after landing.

    It lies still and feels its weight, and the rotors' level (n, 1) is too low for that. The level that
    carries it is that of the moments next to it in which it moves.
    """
    force = next((each for each in log.accelerometers.values() if len(each) > 1), None)
    if force is None:
        yield from flights
        return
    time, shares = level.time, smooth(level)[:, 0]
    weight = np.linalg.norm(Signal(force.time, smooth(force)).at(time), axis=1) / STANDARD_GRAVITY
    still = lies_still(log, time) & (np.abs(weight - 1.0) < HELD)
    count = max(1, round(CRASH * level.rate))
    for each in flights:
        inside = (time >= each.start) & (time <= each.end)
        moving = shares[inside & ~still]
        begins, ends = each.start - time[0] >= 1.0, time[-1] - each.end >= 1.0
        if (begins or ends) and not _climbs(log, each):
            continue
        if len(moving) < BRIDGED * level.rate:
            if not (begins or ends):  # all that is logged may be a hover in calm air
                yield each
            continue
        after = inside | ((time > each.end) & (time <= each.end + CRASH))
        first, last = (
            runs_of(part & ~(still & (shares < (weight - HELD) * float(np.median(near)))))
            for part, near in ((inside, moving[:count]), (after, moving[-count:]))
        )
        # it lifts off where it is first held no more, and touches down where it feels most before it is held
        lift = next((float(time[run.start]) for run in first if _lasts(time, run)), each.end)
        left = next((float(time[run.stop - 1]) for run in reversed(last) if _lasts(time, run)), lift)
        is_held = left < time[after][-1]
        end = min(_touches_down(force, left), each.end) if is_held else each.end
        yield Interval(lift if begins else each.start, end)


def lies_still(log: FlightLog, time: Floats) -> Mask:
    """Whether all gyros that are alive turn next to nothing about roll and pitch at each time (n,).

    Means count: rotors shake a vehicle that the ground holds.
    """
    gyros = [each for each in (*log.gyros.values(), log.body_rate) if each is not None and len(each) > 1]
    still = np.full(len(time), bool(gyros))
    for each in gyros:
        rates: Floats = np.nan_to_num(each.value[:, :2])  # zero on average, as yaw need not be
        slow = smooth(Signal(each.time, rates - np.median(rates, axis=0)))
        square = smooth(Signal(each.time, slow**2))
        scatter = np.sqrt(np.clip(Signal(each.time, square).at(time), 0.0, None)).max(axis=1)
        still &= (scatter > 0.0) & (scatter < STILL)
    return still


def _climbs(log: FlightLog, flight: Interval) -> bool:
    """Whether the vehicle ever goes up or down from shortly before a stretch on, as far as anybody knows."""
    velocity = log.velocity or log.gps_velocity
    if velocity is None or len(velocity) < 2 or not np.nanstd(velocity.value[:, 2]) > 0.0:
        return True
    mean = ndimage.uniform_filter1d(np.nan_to_num(velocity.value[:, 2]), max(1, round(velocity.rate)))
    around = slice(*np.searchsorted(velocity.time, (flight.start - CRASH, flight.end + CRASH)))
    return bool(np.any(np.abs(mean[around]) > CLIMBS))


def _touches_down(force: Signal, left: float) -> float:
    """Return when the specific force is farthest from gravity shortly before a time [s]."""
    near = slice(*np.searchsorted(force.time, (left - CRASH, left)))
    shock = np.abs(np.linalg.norm(np.nan_to_num(force.value[near]), axis=1) - STANDARD_GRAVITY)
    return float(force.time[near][np.argmax(shock)]) if len(shock) else left


def _lasts(time: Floats, run: slice) -> bool:
    return bool(time[run.stop - 1] - time[run.start] > BRIDGED)


def _trim(flight: Interval, first: float, last: float) -> Interval:
    """Leave out take-off and landing; a log may begin and end in flight."""
    start = flight.start if flight.start - first < 1.0 else flight.start + TAKE_OFF
    end = flight.end if last - flight.end < 1.0 else flight.end - LANDING
    return Interval(start, end)


class Rest(NamedTuple):
    """A stretch at rest."""

    start: float  # s
    end: float  # s
    mean: Floats  # (3,) what the sensor reads


def rests_of(flight: Flight, sensor: Signal, scatter: float) -> list[Rest]:
    """Find blocks of `RESTS` in which a sensor (n, 3) scatters by less, and the vehicle does not fly."""
    count = round(RESTS * sensor.rate)
    if count < 10 or len(sensor) < count:
        return []
    blocks = len(sensor) // count
    values = sensor.value[: blocks * count].reshape(blocks, count, -1)
    times = sensor.time[: blocks * count].reshape(blocks, count)
    quiet = (values.std(axis=1) < scatter).all(axis=1)
    if flight.phases_known:
        quiet &= ~flight.in_flight(times.ravel()).reshape(times.shape).any(axis=1)
    return [
        Rest(float(times[k, 0]), float(times[k, -1]), values[k].mean(axis=0)) for k in np.flatnonzero(quiet)
    ]
