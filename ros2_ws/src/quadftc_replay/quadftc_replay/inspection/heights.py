"""Positions of satellites and heights of barometers against the integral of a measured velocity.

    d(t) = p(t) - integral of v dt

A receiver takes velocity from the Doppler shift and position from times of flight: two measurements, so
that d drifts slowly. It jumps with a position that jumps, and with a height by pressure that does. What jumps
in both is the velocity, which they share. A velocity is compared so with the specific force in earth axes,
after the delay that leaves least.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from quadftc_model.rotations import to_earth
from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import Curve, Found, component_name, confidence, make_found
from quadftc_replay.inspection.jumps import DRIFT, FEWEST, JUMP, find_jumps
from quadftc_replay.inspection.path import DELAYS, attitude_at
from quadftc_replay.inspection.readings import noise_findings, pauses_of
from quadftc_replay.inspection.steps import Step
from quadftc_replay.inspection.verdict import show
from quadftc_replay.inspection.whitening import Floats

BAROMETER, RECEIVER = "barometer", "gps"
KINDS = ("offset", "drift")  # jumps, drifts
KNOWS = "of which the measured velocity knows nothing"
# of a receiver's positions: element (latitude, longitude, height), towards which, away from which
TOWARDS: Mapping[int, tuple[str, str, str]] = {
    1: ("x", "north", "south"),
    0: ("y", "east", "west"),
    2: ("z", "up", "down"),
}
_ELEMENTS = tuple(TOWARDS[axis][0] for axis in range(3))
GATE = 5.0  # standard deviations that the estimators of ArduPilot and PX4 let pass
CLAIMED = 0.5  # m; a receiver's least standard deviation (ArduPilot EK3_POSNE_M_NSE, PX4 EKF2_GPS_P_NOISE)
SPEED = 0.3  # m/s; the same of its velocity (ArduPilot EK3_VELNE_M_NSE, PX4 EKF2_GPS_V_NOISE)
ROUGH = 0.3  # m; the noise of a barometer that is none (ArduPilot EK3_ALT_M_NSE: 2 m)
GROUND_EFFECT = 4.0  # m; that the wash of the rotors near the ground adds (PX4 EKF2_GND_EFF_DZ)
PAUSE = 1.0  # s; of a velocity, over which its integral is not known
SAME = 0.5  # 1; by which jumps differ that have one cause


def receiver_findings(flight: Flight) -> tuple[list[Found], bool]:
    """Name receivers whose position jumps or drifts; and whether any was judged."""
    found, residuals = list[Found](), _receivers(flight)
    for name, residual in residuals.items():
        found += _noise(flight, component_name(RECEIVER, name), residual, _ELEMENTS, CLAIMED)
        for kind, steps in zip(KINDS, _receiver_jumps(flight, name, residual), strict=True):
            for step in steps:
                element, way = _way(step.axis, step.size)
                said = f"its position {_does(kind, abs(step.size))} {way}, {KNOWS}"
                component = component_name(RECEIVER, name)
                known_by = CLAIMED if kind == "offset" else CLAIMED / DRIFT
                sure = step._replace(sigma=max(step.sigma, known_by))
                found.append(_found(component, element, kind, sure, said, residual))
    return found, bool(residuals)


def velocity_findings(flight: Flight) -> Iterator[Found]:
    """Name receivers whose velocity jumps, from one sample to the next."""
    attitude, force = flight.log.attitude, next(iter(flight.log.accelerometers.values()), None)
    if attitude is None or force is None or len(attitude) < 2:
        return
    time, value = force.whole()
    if len(time) < 2:
        return
    acceleration = to_earth(attitude_at(attitude, time), value) - [0.0, 0.0, STANDARD_GRAVITY]
    for name, velocity in flight.log.gps_velocities.items():
        late = (Signal(time + delay, acceleration) for delay in DELAYS.tolist())
        residual = min((_less_integral(velocity, each) for each in late), key=_unrest)
        smallest = np.full(len(residual), GATE * SPEED)
        for step in find_jumps(residual, flight.is_calm(residual.time), smallest, _breaks(flight))[0]:
            if not _is_sharp(residual, step) or step.sigma > SPEED:
                continue  # a wrong heading or force takes its time; force sampled too slowly says little
            element, way = _way(step.axis, step.size)
            said = f"its velocity jumps by {show(abs(step.size), 'm/s')} {way}, against the specific force"
            yield _found(component_name(RECEIVER, name), element, "offset", step, said, residual, "m/s")


def barometer_findings(flight: Flight) -> tuple[list[Found], bool]:
    """Name barometers whose height jumps or drifts; and whether any was judged."""
    log = flight.log
    velocity = log.gps_velocity or log.velocity
    if velocity is None or len(velocity) < 2:
        return [], False
    up = Signal(velocity.time, velocity.value[:, 2:])
    speed: Floats = np.linalg.norm(np.nan_to_num(velocity.value), axis=1)
    residuals = {name: _less_integral(each, up) for name, each in log.barometers.items() if len(each) > 1}
    found, jumps = list[Found](), dict[str, tuple[list[Step], list[Step]]]()
    for name, residual in residuals.items():
        # wind of the vehicle's own speed adds up to its dynamic pressure
        dynamic: Floats = np.interp(residual.time, velocity.time, speed) ** 2 / (2.0 * STANDARD_GRAVITY)
        calm = flight.is_calm(residual.time)
        jumps[name] = find_jumps(residual, calm, GROUND_EFFECT + dynamic, _breaks(flight))
        found += _noise(flight, component_name(BAROMETER, name), residual, ("",), ROUGH)
    receivers = [_receiver_jumps(flight, name, each) for name, each in _receivers(flight).items()]
    for which, kind in enumerate(KINDS):
        velocities = [step for each in receivers for step in each[which] if step.axis == 2]
        told: list[Step] = []
        for name, residual in residuals.items():
            for step in jumps[name][which]:
                if _has(velocities, step) or _has(told, step):
                    continue
                told.append(step)
                others = [each for each in jumps if each != name and _has(jumps[each][which], step)]
                said = f"its height {_does(kind, step.size)}, {KNOWS}"
                said += "".join(f"; {component_name(BAROMETER, each)} does the same" for each in others)
                found.append(_found(component_name(BAROMETER, name), "", kind, step, said, residual))
    return found, bool(residuals)


def _noise(
    flight: Flight, component: str, residual: Signal, names: tuple[str, ...], least: float
) -> Iterator[Found]:
    """Say when what is left of a sensor gets noisy."""
    return noise_findings(flight, component, residual.whole(), names, "m", least, alone=False)


def _receivers(flight: Flight) -> dict[str, Signal]:
    """What the positions of each receiver leave of the integral of its velocity."""
    log = flight.log
    return {
        name: _less_integral(position, log.gps_velocities[name])
        for name, position in log.gps_positions.items()
        if name in log.gps_velocities and len(position) > 1
    }


def _less_integral(position: Signal, velocity: Signal) -> Signal:
    """Positions (n, k) less the integral of a velocity; NaN beyond it, and within its pauses."""
    steps = np.diff(velocity.time)
    integral = velocity.integral().at(position.time)
    dark = (position.time < velocity.time[0]) | (position.time > velocity.time[-1])
    for row in np.flatnonzero(steps > PAUSE).tolist():
        dark |= (position.time > velocity.time[row]) & (position.time < velocity.time[row + 1])
    integral[:, np.isnan(velocity.value).all(axis=0)] = np.nan
    return Signal(position.time, np.where(dark[:, None], np.nan, position.value - integral))


def _is_sharp(residual: Signal, step: Step) -> bool:
    """Whether a jump is the change from one sample to the next, beside those around it."""
    known = np.isfinite(residual.value[:, step.axis])
    changes = np.diff(residual.value[known, step.axis])
    row = int(np.searchsorted(residual.time[known], step.onset)) - 1
    usual = float(np.median(changes[max(row - FEWEST, 0) : row + FEWEST + 1]))
    return abs(float(changes[row]) - usual - step.size) < SAME * abs(step.size)


def _unrest(residual: Signal) -> float:
    """Return the usual change of a residual from sample to sample."""
    changes = np.linalg.norm(np.diff(residual.value, axis=0), axis=1)
    return float(np.median(changes[np.isfinite(changes)])) if np.isfinite(changes).any() else np.inf


def _receiver_jumps(flight: Flight, name: str, residual: Signal) -> tuple[list[Step], list[Step]]:
    """Jumps and drifts of a receiver's position, beyond what it claims to know it by."""
    status = flight.log.gps_status.get(name)
    claimed = np.full(len(residual), CLAIMED)
    if status is not None:
        claimed = np.fmax(claimed, np.interp(residual.time, status.time, status.value[:, 2]))
    return find_jumps(residual, flight.is_calm(residual.time), GATE * claimed, _breaks(flight))


def _breaks(flight: Flight) -> Floats:
    """Times at which an integral starts anew, as the log pauses or its clock jumps (m,)."""
    return np.array([each.end for each in pauses_of(flight.log)])


def _has(steps: Sequence[Step], step: Step) -> bool:
    """Whether what one instrument does is among what others do."""
    return any(
        abs(each.onset - step.onset) < JUMP and abs(each.size - step.size) < SAME * abs(step.size)
        for each in steps
    )


def _way(axis: int, size: float) -> tuple[str, str]:
    """Return the element of a receiver, and the direction in words."""
    element, *ways = TOWARDS[axis]
    return element, ways[0 if size > 0.0 else 1]


def _does(kind: str, size: float) -> str:
    return f"jumps by {show(size, 'm')}" if kind == "offset" else f"drifts by {show(size, 'm/s')}"


def _found(
    component: str, element: str, kind: str, step: Step, said: str, residual: Signal, unit: str = "m"
) -> Found:
    """The finding of a jump or a drift of a quantity with some unit."""
    lines = {"difference": residual.value[:, step.axis]}
    title = f"{component} {element}".strip() + " less the integral of what it follows from"
    return make_found(
        *(component, element, kind, step.onset),
        end_s=step.end,
        size=step.size,
        sigma=step.sigma,
        unit=unit if kind == "offset" else f"{unit}/s",
        probability=confidence(step.score, 1.0),
        evidence=(said,),
        curve=Curve(title, unit, residual.time, lines),
    )
