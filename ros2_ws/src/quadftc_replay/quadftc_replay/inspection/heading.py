"""The heading of an attitude against the way that satellites say the vehicle is pushed.

Over windows as in `path`, as complex numbers with east as the real axis, attitude and accelerometer say that
the velocity changes by a, the receiver says b, both less their means. A heading that is off by psi turns a,

    a = exp(i psi) b

so psi is the phase of sum(a conj(b)). It may be off from some time on, or all along: the time is the one that
leaves least. No gyro or compass takes part, and a hover says nothing. A compass that is disturbed, mounted
wrong or not calibrated makes such an error; a vehicle that flies by it circles, and then flies away.
"""

from __future__ import annotations

import numpy as np

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.path import EXPLAINED, LEAST, LEVEL, STEP, WINDOW, pushes_of
from quadftc_replay.inspection.whitening import Floats

SMALLEST = 0.3  # rad; what PX4 expects of a compass (EKF2_HEAD_NOISE)


def heading_findings(flight: Flight, until: float) -> list[Found]:
    """Say whether the heading is off in flight before a time [s], from when on, and by how much."""
    log = flight.log
    attitude, force, velocity = (
        None if each is None else _before(each, until)
        for each in (log.attitude, next(iter(log.accelerometers.values()), None), log.gps_velocity)
    )
    pushes = pushes_of(attitude, force, velocity)
    if pushes is None or not flight.phases_known or not log.attitude_from_gyro:
        return []
    time, said, true = pushes
    rows = flight.is_calm(time) & np.isfinite(said + true).all(axis=1)
    if rows.sum() < LEAST:
        return []
    time, a, b = time[rows], *(each[rows, 0] + 1j * each[rows, 1] for each in (said, true))
    a, b = a - a.mean(), b - b.mean()  # less a tilt that is wrong
    # from each row on: the sum that tells psi, and what is left without and with it
    along = np.cumsum((a * b.conj())[::-1])[::-1]
    wrong = np.cumsum(np.abs(a - b)[::-1] ** 2)[::-1]
    power = np.cumsum((np.abs(a) ** 2 + np.abs(b) ** 2)[::-1])[::-1]
    left = power - 2.0 * np.abs(along)
    first = int(np.argmin((wrong[0] - wrong + left)[: len(a) - LEAST + 1]))
    angle, count = float(np.angle(along[first])), len(a) - first
    strength = float(np.sum(np.abs(b[first:]) ** 2)) * STEP / WINDOW  # windows overlap
    sigma = float(np.sqrt(max(left[first], 1e-12) / (2 * count) / max(strength, 1e-12)))
    if abs(angle) < max(SMALLEST, LEVEL * sigma) or left[first] > (1.0 - EXPLAINED) * wrong[first]:
        return []
    return [_found(flight, time, np.angle(a * b.conj()), first, angle, sigma)]


def _before(signal: Signal, until: float) -> Signal:
    rows = slice(int(np.searchsorted(signal.time, until)))
    return Signal(signal.time[rows], signal.value[rows])


def _found(flight: Flight, time: Floats, angles: Floats, first: int, angle: float, sigma: float) -> Found:
    said = (
        f"the satellites' velocity changes {abs(np.degrees(angle)):.0f} deg beside where attitude and"
        " accelerometer push it; a compass that is disturbed, mounted wrong or not calibrated does that"
    )
    onset = float(time[first]) - 0.5 * WINDOW if first else flight.intervals[0].start
    return make_found(
        *("attitude", "yaw", "offset", onset),
        size=angle,
        sigma=sigma,
        unit="rad",
        probability=confidence(abs(angle) / sigma, LEVEL),
        ambiguous_with=("magnetometer",),
        evidence=(said,),
        curve=Curve("heading by attitude less by satellites", "deg", time, {"heading": np.degrees(angles)}),
    )
