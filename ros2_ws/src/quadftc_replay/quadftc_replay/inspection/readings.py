"""Tests of a sensor by its readings alone: stuck, saturated, absent, noisy."""

from __future__ import annotations

from collections.abc import Iterator
from math import comb

import numpy as np
from scipy import ndimage

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight, Interval
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.verdict import show
from quadftc_replay.inspection.whitening import TO_SIGMA, Floats, runs_of

STUCK = 0.1  # s; the least time
CHANCE = 1e-9  # probability, in the whole log, of a run of equal readings that is no fault
LONGER = 5.0  # 1; times the longest usual run
USUAL = 0.999  # share of the runs that count as usual
LIMIT_RUN = 3  # equal readings at the largest magnitude that are a limit
LIMIT_RUNS = 2  # how many such runs
SAME = 1e-6  # 1; by which readings at a limit differ: a quiet sensor at rest is that near to its largest, too
LEVELS = 100  # different readings that a sensor has below a limit
ABSENT = 0.2  # s
OTHERS_GO_ON = 0.6  # 1; share of the samples that the other sensors have meanwhile
FEWEST = 100  # samples in flight
SLOWEST = 50.0  # Hz; between slower samples motion looks like noise, unless it is white
WHITE = 0.63  # 1; what third differences show, by first ones, of a motion at a quarter of the rate
WINDOW = 0.25  # s; of the noise
SAMPLES = 8  # of it, at least
CALM = 0.3  # 1; quantile of the noise in flight that is the usual one
NOISY = 6.0  # times the usual noise
NOISE_LASTS = 0.5  # s
HANDLED = 3.0  # times as much and as long, where nobody knows what moves the vehicle, or vibration is aliased
OTHERS = 2.0  # times: what other axes may rise by meanwhile


def reading_findings(
    flight: Flight, component: str, sensor: Signal, names: tuple[str, ...], unit: str
) -> Iterator[Found]:
    """Test the readings of a sensor (n, k), axis by axis."""
    if len(sensor) < 50:
        return
    for axis, name in enumerate(names):
        values = sensor.value[:, axis]
        stuck = stuck_intervals(flight, sensor.time, values)
        limits = limit_intervals(sensor.time, values) if unit != "1" else []  # an attitude has none
        stuck = [each for each in stuck if not _overlaps(each, limits)]
        for kind, intervals in (("stuck", stuck), ("saturation", limits)):
            if intervals:
                yield _reading_found(component, name, kind, sensor.time, values, intervals, unit)


def _reading_found(
    component: str, name: str, kind: str, time: Floats, values: Floats, intervals: list[Interval], unit: str
) -> Found:
    first, last = intervals[0], intervals[-1]
    rows = np.searchsorted(time, first)
    reading = float(values[rows[0]])
    seconds = sum(each.end - each.start for each in intervals)
    several = f" in {len(intervals)} stretches" if len(intervals) > 1 else ""
    words = "repeats its reading" if kind == "stuck" else "stays at its limit"
    said = f"it {words}, {show(reading, unit)}, for {seconds:.3g} s{several}"
    end = None if last.end >= float(time[-1]) else last.end
    curve = Curve(f"{component} {name}", unit, time, {"reading": values})
    is_direct = kind == "stuck"
    return make_found(
        *(component, name, kind, first.start), curve=curve, is_direct=is_direct, end_s=end, evidence=(said,)
    )


def stuck_intervals(flight: Flight, time: Floats, values: Floats) -> list[Interval]:
    """Stretches in flight in which a reading is repeated far longer than it is by chance."""
    rows = np.flatnonzero(flight.in_flight(time) & np.isfinite(values))
    if len(rows) < 50:
        return []
    times, readings = time[rows], values[rows]
    edges = np.flatnonzero(np.diff(readings) != 0.0) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(readings)]])
    lengths = ends - starts
    if len(lengths) < 20:  # hardly ever another reading: the signal is coarse, or never moved
        is_still = len(lengths) == 1 and len(readings) >= 100
        return [Interval(float(times[0]), float(times[-1]))] if is_still else []
    usual = lengths[lengths <= np.quantile(lengths, USUAL)]
    repeats = max(1.0 - len(usual) / max(float(usual.sum()), 1.0), 0.0)  # probability of a repeated reading
    by_chance = np.log(CHANCE / len(readings)) / np.log(repeats) if repeats > 0.0 else 1.0
    least = max(by_chance, LONGER * float(usual.max()))
    found: list[Interval] = []
    for k in np.flatnonzero(lengths > least):
        begin, end = int(rows[starts[k]]), int(rows[ends[k] - 1])
        if time[end] - time[begin] >= STUCK:  # it may have begun before take-off, and last beyond the landing
            other = np.flatnonzero(values[:begin] != values[begin])
            found.append(Interval(float(time[other[-1] + 1 if len(other) else 0]), float(time[end])))
    return found


def limit_intervals(time: Floats, values: Floats) -> list[Interval]:
    """Stretches in which a reading stays at the largest magnitude it ever has."""
    magnitude = np.abs(np.where(np.isfinite(values), values, 0.0))
    top = float(magnitude.max(initial=0.0))
    if top <= 0.0:
        return []
    at_limit = magnitude >= top * (1.0 - SAME)
    runs = [run for run in runs_of(at_limit) if run.stop - run.start >= LIMIT_RUN]
    # a coarse sensor at rest repeats its largest reading, too
    if len(runs) < LIMIT_RUNS or len(np.unique(magnitude[~at_limit])) < LEVELS:
        return []
    return [Interval(float(time[run.start]), float(time[run.stop - 1])) for run in runs]


def absent_intervals(flight: Flight, sensor: Signal, others: Signal | None) -> list[Interval]:
    """Stretches in flight without usable readings, while another sensor goes on."""
    times = sensor.whole().time
    if len(times) < 2:
        return []
    begin = flight.intervals[0].start if flight.phases_known else float(sensor.time[0])
    end = flight.intervals[-1].end
    edges = np.concatenate([times[:1], times, [max(end, float(times[-1]))]])
    longest = max(ABSENT, max(10.0, _lost_by_chance(times)) * float(np.median(np.diff(times))))
    found: list[Interval] = []
    for k in np.flatnonzero(np.diff(edges) > longest):
        gap = Interval(float(edges[k]), float(edges[k + 1]))
        inside = (sensor.time > gap.start) & (sensor.time < gap.end)
        if gap.end <= begin or gap.start >= end:
            continue
        if inside.any() or _goes_on(others, gap):
            found.append(gap)
    return found


def pauses_of(log: FlightLog) -> list[Interval]:
    """Stretches without a sample of anything fast: how the vehicle moved, and how long, nobody knows."""
    named = log.attitude, log.body_rate, log.rotor_commands
    fast = [*log.gyros.values(), *log.accelerometers.values(), *(each for each in named if each is not None)]
    fast = [each for each in fast if len(each) > 1]
    if not fast:
        return []
    times = np.unique(np.concatenate([each.time for each in fast]))
    gaps = np.flatnonzero(np.diff(times) > max(ABSENT, LONGER / max(each.rate for each in fast)))
    return [Interval(float(times[row]), float(times[row + 1])) for row in gaps]


def _lost_by_chance(times: Floats) -> float:
    """Return how many samples in a row a log may lack by chance, as it loses them; the longest gap aside."""
    steps = np.sort(np.diff(times) / float(np.median(np.diff(times))))[:-1]
    lost = 1.0 - len(steps) / max(float(steps.sum()), 1.0)
    return float(np.log(CHANCE / len(times)) / np.log(lost)) if 0.0 < lost < 1.0 else 1.0


def _goes_on(other: Signal | None, gap: Interval) -> bool:
    """Whether another sensor has most of its samples in a gap."""
    if other is None or len(other) < 2:
        return False
    count = np.searchsorted(other.time, gap.end) - np.searchsorted(other.time, gap.start)
    return bool(count > OTHERS_GO_ON * other.rate * (gap.end - gap.start))


def absent_findings(
    flight: Flight, component: str, sensor: Signal, others: Signal | None, to_the_end: bool = True
) -> Iterator[Found]:
    """Say when a sensor gives nothing; not ``to_the_end``: it may stop before the others do."""
    intervals = absent_intervals(flight, sensor, others)
    if not to_the_end:
        intervals = [each for each in intervals if each.end < flight.intervals[-1].end]
    if intervals:
        seconds = sum(each.end - each.start for each in intervals)
        said = f"no usable reading for {seconds:.3g} s in {len(intervals)} stretches, while others went on"
        end = None if intervals[-1].end >= flight.intervals[-1].end else intervals[-1].end
        yield make_found(component, "", "absent", intervals[0].start, end_s=end, evidence=(said,))


def noise_findings(
    flight: Flight,
    component: str,
    sensor: Signal,
    names: tuple[str, ...],
    unit: str,
    least: float,
    alone: bool = True,
) -> Iterator[Found]:
    """Say when an axis gets noisy.

    ``least`` is what every such sensor may have. ``alone``: motion is still in the signal, so that the other
    axes have to stay calm. Below `SLOWEST` the noise has to be white, as no motion is.
    """
    is_slow = sensor.rate < SLOWEST
    times = 1.0 if flight.phases_known and not (alone and is_slow) else HANDLED
    level, lasts = times * NOISY, times * NOISE_LASTS
    flying = flight.is_calm(sensor.time)
    if flying.sum() < FEWEST:
        return
    noise = moving_noise(sensor)
    white = noise / np.maximum(moving_noise(sensor, 1), 1e-12) if is_slow else np.ones_like(noise)
    floor = np.maximum(np.quantile(noise[flying], CALM if flight.phases_known else 0.5, axis=0), least)
    ratio = noise / floor
    for axis, name in enumerate(names):
        loud = flying & (ratio[:, axis] > level)
        if alone:
            loud &= ratio[:, axis] > OTHERS * np.delete(ratio, axis, axis=1).max(axis=1)
        shortest = max(lasts, SAMPLES / sensor.rate)
        runs = [run for run in runs_of(loud) if sensor.time[run.stop - 1] - sensor.time[run.start] > shortest]
        runs = [run for run in runs if np.median(white[run, axis]) > WHITE]
        if not runs:
            continue
        start, end = float(sensor.time[runs[0].start]), float(sensor.time[runs[-1].stop - 1])
        # the window is centred: it sees a begin half a window early, where the level is crossed late
        size = float(np.median(noise[runs[0], axis]))
        factor = size / float(floor[axis])
        said = f"noise of {show(size, unit)}, {factor:.0f} times the usual"
        lines = {"reading": sensor.value[:, axis]}
        yield make_found(
            *(component, name, "noise", start),
            end_s=None if end > sensor.time[flying][-1] - WINDOW else end,
            size=size,
            sigma=None,
            unit=unit,
            probability=confidence(factor, level),
            evidence=(said + ", while the other axes stay calm" if alone else said,),
            curve=Curve(f"{component} {name}", unit, sensor.time, lines),
        )


def quiet_intervals(flight: Flight, sensor: Signal) -> list[Interval]:
    """Stretches in flight in which a reading (n, 1) changes, but has next to none of the noise before."""
    flying = flight.is_calm(sensor.time)
    if flying.sum() < FEWEST:
        return []
    noise = moving_noise(sensor)[:, 0]
    loud = float(np.quantile(noise[flying], 1.0 - CALM))
    lasts = HANDLED * max(NOISE_LASTS, SAMPLES / sensor.rate)
    found: list[Interval] = []
    for run in runs_of(flying & (noise > 0.0) & (noise < loud / NOISY)):
        first = int(np.searchsorted(sensor.time, found[0].start)) if found else run.start
        before, span = noise[:first][flying[:first]], sensor.time[[run.start, run.stop - 1]]
        if min(len(before) / sensor.rate, float(np.ptp(span))) < lasts:
            continue
        if float(np.median(noise[run])) < float(np.quantile(before, CALM)) / NOISY:
            found.append(Interval(*span.tolist()))
    return found


def moving_noise(sensor: Signal, order: int = 3) -> Floats:
    """Standard deviation of what is fast in a signal, over `WINDOW` (n, k): by differences of an order."""
    values = np.nan_to_num(sensor.value)
    fast = np.zeros_like(values)
    fast[order:] = np.abs(np.diff(values, order, axis=0)) / np.sqrt(comb(2 * order, order))
    length = max(SAMPLES, round(WINDOW * sensor.rate))
    # the median over the window is not moved by single spikes
    stride = max(1, length // 8)
    rows = np.arange(0, len(values), stride)
    padded = np.pad(fast, ((0, len(rows) * stride - len(fast)), (0, 0)), mode="edge")
    medians = np.median(padded.reshape(len(rows), stride, -1), axis=1)
    coarse = Signal(rows.astype(np.float64) + stride / 2.0, ndimage.median_filter(medians, size=(9, 1)))
    return TO_SIGMA * coarse.at(np.arange(len(values), dtype=np.float64))


def _overlaps(interval: Interval, others: list[Interval]) -> bool:
    return any(interval.start <= each.end and each.start <= interval.end for each in others)
