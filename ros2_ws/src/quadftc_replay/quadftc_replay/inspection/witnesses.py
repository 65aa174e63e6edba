"""Who is right, where sensors part: findings of pairs of IMUs, and of the path that satellites measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from quadftc_model.samples import STANDARD_GRAVITY
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import Agreement, compare
from quadftc_replay.inspection.attitude import LONG
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, component_name, confidence, make_found
from quadftc_replay.inspection.pairs import CLEAR, Parting, differ, jumps_more, partings
from quadftc_replay.inspection.path import (
    LEVEL,
    LONG_WINDOW,
    ONSET,
    SMALLEST,
    WINDOW,
    Cause,
    Path,
    causes_of,
    known_path,
    path_of,
)
from quadftc_replay.inspection.steps import LIMITS, SAME, Step, begins_within, change_at
from quadftc_replay.inspection.verdict import Finding
from quadftc_replay.inspection.whitening import Floats

NEAR = 0.5  # s; from a step that the path shows to the same in the readings


def pair_findings(
    flight: Flight, kind: str, sensors: Mapping[str, Signal], known: Sequence[Finding]
) -> list[Found]:
    """Name the wrong one of two or more sensors of a kind; ``known`` is what their readings alone say."""
    ignored = [
        (name, each.onset_s, np.inf if each.end_s is None else each.end_s)
        for each in known
        for name in sensors
        if each.component == component_name(kind, name)
    ]
    apart = list(partings(flight, kind, sensors, ignored))
    found: list[Found] = []
    for parting in sorted(apart, key=lambda each: each.onset):
        others = [each for each in apart if each is not parting and _at_once(each, parting)]
        common = [name for name in parting.names if any(name in each.names for each in others)]
        if len(common) == 1:  # it differs from two others
            if not any(_is_of(each.finding, kind, common[0], parting) for each in found):
                blame = 2.0 if common[0] == parting.names[0] else -2.0
                found.append(_pair_found(kind, sensors, parting, blame))
        else:
            found.append(_pair_found(kind, sensors, parting, _blame(flight, kind, sensors, parting)))
    return found


def _at_once(parting: Parting, other: Parting) -> bool:
    """Whether two partings are on one axis at one time."""
    ends = [np.inf if each.end is None else each.end for each in (parting, other)]
    return parting.axis == other.axis and parting.onset <= ends[1] and other.onset <= ends[0]


def _is_of(finding: Finding, kind: str, name: str, parting: Parting) -> bool:
    same = finding.component == component_name(kind, name) and finding.element == BODY_AXES[parting.axis]
    return same and abs(finding.onset_s - parting.onset) < NEAR


def _blame(flight: Flight, kind: str, sensors: Mapping[str, Signal], parting: Parting) -> float:
    """By how much the first of two is worse than the second: what three witnesses say, each -1 to 1."""
    first, second = (sensors[name] for name in parting.names)
    a, b, _ = differ(first, second)
    total = jumps_more(a, b, parting)
    end = flight.until if parting.end is None else min(parting.end, flight.until)
    if kind == "gyro":
        trust = 1.0 if flight.log.attitude_from_gyro is False else min((end - parting.onset) / LONG, 1.0)
        total += trust * _by_attitude(flight, (first, second), parting, end)
        total += _by_path_of_attitude(flight, (first, second), parting, end)
    else:
        total += _by_path(flight, (first, second), parting, end)
    return total


def _by_attitude(flight: Flight, gyros: tuple[Signal, Signal], parting: Parting, end: float) -> float:
    """Compare both gyros with the attitude's rate, over a stretch that ends at some time [s]."""
    if flight.log.attitude is None:
        return 0.0
    misses: list[float] = []
    for gyro in gyros:
        agreement = compare(flight.log.attitude, gyro)
        if agreement is None:
            return 0.0
        rows = slice(*np.searchsorted(agreement.time, (parting.onset, end)))
        seconds = float(np.sum(agreement.dt[rows]))
        misses.append(abs(float(np.sum(agreement.rest[rows, parting.axis]))) / max(seconds, 1e-9))
    return float(np.clip((misses[0] - misses[1]) / abs(parting.size), -1.0, 1.0))


def _by_path_of_attitude(flight: Flight, gyros: tuple[Signal, Signal], parting: Parting, end: float) -> float:
    """Ask the path whether the attitude tilts away: then the gyro that it follows at first is wrong."""
    path = path_of(flight.log.attitude, _main_force(flight), flight.log.gps_velocity)
    if path is None or parting.axis == 2 or end - parting.onset < 1.5 * WINDOW:
        return 0.0
    rows = slice(*np.searchsorted(path.time, (parting.onset, min(end, parting.onset + LONG))))
    size = np.linalg.norm(np.nan_to_num(path.rest[rows]), axis=1)
    if not len(size):
        return 0.0
    tilts = float(size.max()) > SMALLEST + LEVEL * path.sigma
    follows_first = -_by_attitude(flight, gyros, parting, parting.onset + WINDOW)
    return follows_first if tilts else -follows_first


def _by_path(flight: Flight, forces: tuple[Signal, Signal], parting: Parting, end: float) -> float:
    """Compare both accelerometers with the velocity that satellites measure."""
    misses: list[float] = []
    for force in forces:
        path = path_of(flight.log.attitude, force, flight.log.gps_velocity)
        if path is None:
            return 0.0
        rows = slice(*np.searchsorted(path.time, (parting.onset + NEAR, min(end, parting.onset + LONG))))
        along = path.rest[rows, parting.axis]
        if not np.isfinite(along).any():
            return 0.0
        misses.append(abs(float(np.nanmedian(along))))
    return float(np.clip((misses[0] - misses[1]) / abs(parting.size), -1.0, 1.0))


def _pair_found(kind: str, sensors: Mapping[str, Signal], parting: Parting, blame: float) -> Found:
    """The finding of two sensors that part; ``blame`` beyond 0: the first is wrong."""
    is_first, is_clear = blame >= 0.0, abs(blame) > CLEAR
    wrong, right = parting.names if is_first else parting.names[::-1]
    component, other = component_name(kind, wrong), component_name(kind, right)
    element, unit = BODY_AXES[parting.axis], LIMITS[kind].unit
    size = parting.size if is_first else -parting.size
    said = [f"it reads {size:+.3g} {unit.replace('^2', '²')} more than {other}, on the same vehicle"]
    if not is_clear:
        said.append("nothing tells which of the two is right")
    time = sensors[wrong].time
    lines: dict[str, Floats] = {
        component_name(kind, name): np.interp(time, each.time, each.value[:, parting.axis])
        for name, each in sensors.items()
        if name in parting.names
    }
    return make_found(
        *(component, element, "offset", parting.onset),
        end_s=parting.end,
        size=size,
        sigma=parting.sigma,
        unit=unit,
        probability=confidence(parting.score, 0.5) * (1.0 if is_clear else 0.5),
        ambiguous_with=() if is_clear else (f"{other}/{element}",),
        evidence=tuple(said),
        curve=Curve(f"{kind} {element}", unit.replace("^2", "²"), time, lines),
        is_direct=is_clear,
    )


def _main_force(flight: Flight) -> Signal | None:
    return next(iter(flight.log.accelerometers.values()), None)


def path_findings(flight: Flight, own: Agreement | None) -> tuple[list[Found], Path | None]:
    """Name what parts from the path by the velocity that is known; and return that path.

    ``own`` is what an attitude that is computed from the gyro and the gyro say of each other.
    """
    path = known_path(flight.log, _main_force(flight))
    if path is None:
        return [], None
    causes = [each for each in causes_of(flight, path) if each.component != "gps"]
    if own is not None:
        causes = [_turned_back(each, own) or each for each in causes]
    return [_path_found(flight, path, each) for each in causes if not _is_tilting(flight, each)], path


def _turned_back(cause: Cause, own: Agreement) -> Cause | None:
    """Return the gyro that tilts an attitude, in place of an accelerometer; None: it does not.

    An estimator turns its attitude by b / g, once, for an offset b of the accelerometer. It goes on to turn
    it back where the gyro makes it tilt.
    """
    axis = {"x": 1, "y": 0}.get(cause.element)
    if cause.component != "accelerometer" or axis is None:
        return None
    rate = -own.rest[:, axis] / own.dt
    usual = float(np.median(rate[own.time < cause.onset])) if own.time[0] < cause.onset else 0.0
    late = (own.time >= cause.onset) & (own.time < cause.onset + LONG_WINDOW)
    turned = float(np.sum((rate[late] - usual) * own.dt[late])) * (1.0 if axis == 1 else -1.0)
    if turned * np.sign(cause.size) < abs(cause.size) / STANDARD_GRAVITY / SAME:
        return None
    size = turned / float(np.sum(own.dt[late])) * (1.0 if axis == 1 else -1.0)
    spread = cause.sigma / abs(cause.size) * abs(size)
    return cause._replace(component="gyro", element=BODY_AXES[axis], size=size, sigma=spread)


def _is_tilting(flight: Flight, cause: Cause) -> bool:
    """Whether no accelerometer jumps by what the path books on the main one, and another feels it as well."""
    if cause.component != "accelerometer":
        return False
    (main, *others), axis = flight.log.accelerometers.values(), BODY_AXES.index(cause.element)
    change = change_at(main.time, main.value[:, axis], cause.onset, NEAR)
    if change is None or change / cause.size > CLEAR:
        return False
    for other in others:
        difference = differ(main, other)[2]
        rows = slice(*np.searchsorted(difference.time, (cause.onset, cause.onset + LONG)))
        along = difference.value[rows, axis]
        if len(along) and abs(float(np.mean(along))) < CLEAR * abs(cause.size):
            return True
    return False


def is_tilt(finding: Finding, path: Path, jumps: Sequence[Step]) -> bool:
    """Whether the attitude jumps by the tilt that makes an accelerometer's offset of the path.

    Turned by d, it moves the path by d x f: d_y g along x, -d_x g along y.
    """
    axis = {"x": 1, "y": 0}.get(finding.element)
    if finding.component != "accelerometer" or axis is None or finding.size is None:
        return False
    tilt = finding.size / STANDARD_GRAVITY * (1.0 if axis == 1 else -1.0)
    near = [each for each in jumps if abs(each.onset - finding.onset_s) < 0.5 * path.window]
    return any(each.axis == axis and abs(each.size - tilt) < SAME * abs(tilt) for each in near)


def _path_found(flight: Flight, path: Path, cause: Cause) -> Found:
    """The finding of a sensor that the path blames; its onset is that of the step in the readings."""
    is_gyro = cause.component == "gyro"
    sensor = flight.gyro[1] if is_gyro and flight.gyro is not None else _main_force(flight)
    axis = BODY_AXES.index(cause.element)
    onset = cause.onset
    if sensor is not None:
        near = ONSET * path.window
        span = (onset - 5.0 * near, onset + 5.0 * near)
        onset = begins_within(flight, sensor, LIMITS[cause.component], axis, cause.size, span, near)
    what = "the attitude tilts away from" if is_gyro else "the specific force parts from"
    unit = LIMITS[cause.component].unit
    known = "satellites measure" if path.window == WINDOW else "is possible"
    said = (
        f"{what} the path that {known} as with {cause.size:+.3g} {unit.replace('^2', '²')} here,"
        f" {cause.score:.0f} standard deviations",
    )
    lines = {name: path.rest[:, k] for k, name in enumerate(BODY_AXES)}
    return make_found(
        *(cause.component, cause.element, "offset", onset),
        size=cause.size,
        sigma=cause.sigma,
        unit=unit,
        probability=confidence(cause.score, LEVEL),
        evidence=said,
        curve=Curve("specific force less that of the known path", "m/s²", path.time, lines),
    )
