"""An attitude of our own, from gyro and accelerometer, and the gyro's offset that gravity shows.

VQF (Laidig and Seel, 2023; quadftc_fdi.attitude_estimator runs it on board) estimates the tilt and the offset
of the gyro. Gravity is a witness of its own: an offset that creeps in shows here, and an attitude that creeps
does not. Heading has no such witness. The filter may take any offset here, not only the 2 deg/s of a healthy
sensor.

A second run, with the creep taken off the gyro, tells whether gyro or attitude creeps. The difference of the
two offsets is what the filter shows of such a creep, in this motion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from vqf import VQF

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.agreement import Agreement
from quadftc_replay.inspection.attitude import ANGLES, LONG, Creep, Owner
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.identification import bin_means
from quadftc_replay.inspection.readings import pauses_of
from quadftc_replay.inspection.whitening import Floats

RATE = 250.0  # Hz; at most
SLOWEST = 40.0  # Hz
SHORTEST = 15.0  # s
CLIP, INITIAL = 30.0, 2.0  # deg/s; largest offset, and standard deviation of that at the start
SETTLED = 10.0  # s; until the offset at the start is known
CREEP = 0.05  # rad/s; healthy recordings reach 0.01
BEGUN = 0.15  # 1; share of the largest offset at which it has begun
# share of a creep that the offset shows: at least of the gyro's, at most of others
GYRO, ATTITUDE = 0.6, 0.3  # 1
SEEN = 0.15  # 1; share of a creep of the gyro that the filter has to show in this motion
NEAR = 5.0  # s; around the largest offset, over which an attitude is asked


class OwnEstimate(NamedTuple):
    """What the filter says."""

    offset: Signal  # (n, 3) of the gyro [rad/s]
    rates: Floats  # (n, 3) that it got [rad/s]
    forces: Floats  # (n, 3) [m/s²]


def _run(time: Floats, rates: Floats, forces: Floats) -> OwnEstimate:
    filter_ = VQF(float(np.median(np.diff(time))), biasClip=CLIP, biasSigmaInit=INITIAL)
    said = filter_.updateBatch(np.ascontiguousarray(rates), np.ascontiguousarray(forces))
    return OwnEstimate(Signal(time, np.asarray(said["bias"], np.float64)), rates, forces)


def estimate(log: FlightLog, gyro: Signal, accelerometer: Signal) -> OwnEstimate | None:
    """Run the filter over a gyro and an accelerometer of a log; None if they are too slow or too short.

    Of a log with pauses the longest stretch without one is used.
    """
    rate = min(gyro.rate, accelerometer.rate, RATE)
    if rate < SLOWEST:
        return None
    start, end = (pick(gyro.time[k], accelerometer.time[k]) for pick, k in ((max, 0), (min, -1)))
    pauses = pauses_of(log)
    begins, ends = [start, *(each.end for each in pauses)], [*(each.start for each in pauses), end]
    start, end = max(zip(begins, ends, strict=True), key=lambda each: each[1] - each[0])
    if end - start < SHORTEST:
        return None
    edges = np.arange(start, end, 1.0 / rate)
    rates, forces = (bin_means(edges, each, hold=False) for each in (gyro, accelerometer))
    if not (np.isfinite(rates).all() and np.isfinite(forces).all()):
        return None
    return _run(edges[1:], rates, forces)


def offset_finding(
    flight: Flight, component: str, own: OwnEstimate, agreement: Agreement | None
) -> Found | None:
    """Say where a gyro's offset creeps away from what it was, on the axis where it begins first.

    The other axes follow, as the tilt goes wrong. In flight, level, gravity tells nothing of z. A vehicle
    that banks in a long turn looks the same; an attitude, where there is one, has to agree.
    """
    time, offset = own.offset
    settled = (time > time[0] + SETTLED) & (time < flight.intervals[-1].end)
    if settled.sum() < 10:
        return None
    first = np.median(offset[settled][: max(10, settled.sum() // 20)], axis=0)
    away = np.where(settled[:, None], offset - first, 0.0)[:, : 2 if flight.phases_known else 3]
    sizes = away[np.argmax(np.abs(away), axis=0), np.arange(away.shape[1])]
    # it begins at a share of its largest size, and is a finding from `CREEP` on
    begun = np.abs(away) > np.maximum(BEGUN * np.abs(sizes), BEGUN * CREEP)
    axes = [axis for axis, size in enumerate(sizes) if abs(size) > CREEP]
    if not axes:
        return None
    axis = min(axes, key=lambda each: int(np.argmax(begun[:, each])))
    size, moments = float(sizes[axis]), time[begun[:, axis]]
    if agreement is not None and not _is_seen(agreement, axis, size, time[np.argmax(np.abs(away[:, axis]))]):
        return None
    lasts = abs(float(np.mean(away[settled][-10:, axis]))) > 0.5 * abs(size)
    element, onset, end = "xyz"[axis], float(moments[0]), None if lasts else float(moments[-1])
    said = f"against gravity, its offset creeps to {size:+.3g} rad/s; healthy gyros stay within 0.01 rad/s"
    lines = {"offset of the gyro, by gravity": offset[:, axis]}
    return make_found(
        *(component, element, "offset", onset),
        end_s=end,
        size=size,
        sigma=0.1 * abs(size),
        unit="rad/s",
        probability=(0.7 if agreement is None else 1.0) * confidence(abs(size), CREEP),
        ambiguous_with=("a long turn",) if agreement is None else (),
        evidence=(said,),
        curve=Curve(f"offset of {component} {element}", "rad/s", time, lines),
    )


def _is_seen(agreement: Agreement, axis: int, size: float, moment: float) -> bool:
    """Whether the attitude turns slower than the gyro by most of an offset, around a moment [s]."""
    near = np.abs(agreement.time - moment) < NEAR
    rate = np.sum(agreement.rest[near, axis]) / max(float(np.sum(agreement.dt[near])), 1e-9)
    return bool(-np.sign(size) * rate > GYRO * abs(size))


def owner_of(creep: Creep, own: OwnEstimate | None) -> Owner | None:
    """Say whose creep it is by gravity, gyro or attitude; None: it cannot tell."""
    if own is None or ANGLES[creep.axis] == "yaw" or creep.span.end - creep.span.start < LONG:
        return None
    time = own.offset.time
    inside = (time >= creep.span.start) & (time <= creep.span.end)
    rates = own.rates.copy()
    rates[inside, creep.axis] -= creep.size
    without = _run(time, rates, own.forces)
    rows = [np.searchsorted(time, creep.span.start - 0.5) - 1, np.searchsorted(time, creep.span.end)]
    before, after = (min(max(int(row), 0), len(time) - 1) for row in rows)
    offset, other = own.offset.value[:, creep.axis], without.offset.value[:, creep.axis]
    response = float(offset[after] - other[after])
    if abs(response) < SEEN * abs(creep.size):
        return None
    share = float(offset[after] - offset[before]) / response
    if ATTITUDE <= abs(share) <= GYRO or share < -GYRO:
        return None
    return Owner("gyro" if share > GYRO else "attitude", "gravity, felt by the accelerometer,")
