"""Positions of satellites and heights of barometers against the integral of a measured velocity.

    d(t) = p(t) - integral of v dt

A receiver takes velocity from the Doppler shift and position from times of flight: two measurements, so
that d drifts slowly. It jumps with a position that jumps, and with a height by pressure that does. What jumps
in both is the velocity, which they share.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Floats, Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Found, confidence, curve_around, make_finding
from quadftc_replay.inspection.gyro import component_name
from quadftc_replay.inspection.jumps import WINDOW, find_jumps
from quadftc_replay.inspection.steps import Step
from quadftc_replay.inspection.verdict import show

BAROMETER, RECEIVER = "barometer", "gps"
# of a receiver's positions: element (latitude, longitude, height), towards which, away from which
TOWARDS = {1: ("x", "north", "south"), 0: ("y", "east", "west"), 2: ("z", "up", "down")}
GATE = 5.0  # standard deviations that the estimators of ArduPilot and PX4 let pass
CLAIMED = 0.5  # m; a receiver's least standard deviation (ArduPilot EK3_POSNE_M_NSE, PX4 EKF2_GPS_P_NOISE)
GROUND_EFFECT = 4.0  # m; that the wash of the rotors near the ground adds (PX4 EKF2_GND_EFF_DZ)
PAUSE = 1.0  # s; of a velocity, over which its integral is not known
SAME = 0.5  # 1; by which jumps differ that have one cause
AROUND = 3.0  # s


def receiver_findings(flight: Flight) -> tuple[list[Found], bool]:
    """Name receivers whose position jumps; and whether any was judged."""
    found, judged = list[Found](), False
    for name, position in flight.log.gps_positions.items():
        velocity = flight.log.gps_velocities.get(name)
        if velocity is None or len(position) < 2:
            continue
        judged = True
        residual = _less_integral(position, velocity)
        for step in _receiver_jumps(flight, name, residual):
            element, *ways = TOWARDS[step.axis]
            said = (
                f"its position jumps by {show(abs(step.size), 'm')} {ways[step.size < 0.0]},"
                " and its own velocity knows nothing of that"
            )
            found.append(_found(component_name(RECEIVER, name), element, step, said, residual, CLAIMED))
    return found, judged


def barometer_findings(flight: Flight) -> tuple[list[Found], bool]:
    """Name barometers whose height jumps; and whether any was judged."""
    log = flight.log
    velocity = log.gps_velocity or log.velocity
    if velocity is None or len(velocity) < 2:
        return [], False
    up = Signal(velocity.time, velocity.value[:, 2:])
    speed: Floats = np.linalg.norm(np.nan_to_num(velocity.value), axis=1)
    residuals = {name: _less_integral(each, up) for name, each in log.barometers.items() if len(each) > 1}
    jumps: dict[str, list[Step]] = {}
    for name, residual in residuals.items():
        # wind of the vehicle's own speed adds up to its dynamic pressure
        dynamic: Floats = np.interp(residual.time, velocity.time, speed) ** 2 / (2.0 * STANDARD_GRAVITY)
        jumps[name] = find_jumps(residual, _watched(flight, residual), GROUND_EFFECT + dynamic)
    right = [step for step in _heights_of_satellites(flight) if step.axis == 2]
    found = list[Found]()
    for number, name in enumerate(jumps):
        for step in jumps[name]:
            others = [other for other in jumps if other != name and _has(jumps[other], step)]
            if _has(right, step) or any(other in list(jumps)[:number] for other in others):
                continue
            said = f"its height jumps by {show(step.size, 'm')}, and the velocity knows nothing of that"
            said += "".join(f"; {component_name(BAROMETER, each)} does the same" for each in others)
            found.append(_found(component_name(BAROMETER, name), "", step, said, residuals[name]))
    return found, bool(residuals)


def _heights_of_satellites(flight: Flight) -> Iterator[Step]:
    log = flight.log
    for name, position in log.gps_positions.items():
        if (velocity := log.gps_velocities.get(name)) is not None:
            yield from _receiver_jumps(flight, name, _less_integral(position, velocity))


def _less_integral(position: Signal, velocity: Signal) -> Signal:
    """Positions (n, k) less the integral of a velocity; NaN beyond it, and within its pauses."""
    steps = np.diff(velocity.time)
    means = 0.5 * (velocity.value[1:] + velocity.value[:-1]) * steps[:, None]
    total = np.concatenate([np.zeros((1, means.shape[1])), np.nancumsum(means, axis=0)])
    integral = Signal(velocity.time, total).at(position.time)
    dark = (position.time < velocity.time[0]) | (position.time > velocity.time[-1])
    for row in np.flatnonzero(steps > PAUSE).tolist():
        dark |= (position.time > velocity.time[row]) & (position.time < velocity.time[row + 1])
    integral[:, np.isnan(velocity.value).all(axis=0)] = np.nan
    return Signal(position.time, np.where(dark[:, None], np.nan, position.value - integral))


def _receiver_jumps(flight: Flight, name: str, residual: Signal) -> list[Step]:
    """Jumps of a receiver's position, beyond what it claims to know it by."""
    status = flight.log.gps_status.get(name)
    claimed = np.full(len(residual), CLAIMED)
    if status is not None:
        claimed = np.fmax(claimed, np.interp(residual.time, status.time, status.value[:, 2]))
    return find_jumps(residual, _watched(flight, residual), GATE * claimed)


def _watched(flight: Flight, residual: Signal) -> np.ndarray:
    return flight.in_flight(residual.time) & ~flight.near_impact(residual.time)


def _has(jumps: list[Step], step: Step) -> bool:
    """Whether a jump is among others, of another instrument."""
    return any(
        abs(each.onset - step.onset) < WINDOW and abs(each.size - step.size) < SAME * abs(step.size)
        for each in jumps
    )


def _found(
    component: str, element: str, step: Step, said: str, residual: Signal, floor: float = 0.0
) -> Found:
    finding = make_finding(
        *(component, element, "offset", step.onset),
        end_s=step.end,
        size=step.size,
        sigma=max(step.sigma, floor),
        unit="m",
        probability=confidence(step.score, 1.0),
        evidence=(said,),
    )
    lines = {"difference": residual.value[:, step.axis]}
    span = (step.onset - AROUND, (step.end or step.onset) + AROUND)
    title = f"{component} {element}".strip() + " less the integral of the velocity"
    return Found(finding, curve_around(title, "m", residual.time, lines, span))
