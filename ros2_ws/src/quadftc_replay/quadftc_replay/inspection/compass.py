"""Magnetometers against the attitude, and against each other.

The field of the earth is constant, so a magnetometer on a body with the attitude R reads

    m = R' h + u c + b

with the field h, what the currents of the motors add (u: the level of the rotors), and hard iron b. From
sample to sample b drops out: a robust fit of the changes gives h and c, whatever offset begins in between.
What is left, d = m - R' h - u c, jumps when an offset begins. If all magnetometers jump so, either the
attitude has jumped, which the gyro does not follow, or the field itself is another one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quadftc_model.rotations import to_body
from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import HUBER, ROUNDS, Agreement
from quadftc_replay.inspection.attitude import Creep, Owner
from quadftc_replay.inspection.flight import Flight, Interval, rotor_level
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, component_name, confidence, make_found
from quadftc_replay.inspection.jumps import JUMP, find_jumps
from quadftc_replay.inspection.path import attitude_at
from quadftc_replay.inspection.readings import noise_findings
from quadftc_replay.inspection.steps import Step
from quadftc_replay.inspection.verdict import show
from quadftc_replay.inspection.whitening import Floats, scale

COMPONENT = "magnetometer"
FEWEST = 40  # samples
SMALLEST = 0.3  # 1; of the field: what ArduPilot and PX4 let pass, 3 sigma of 50 mG, over 500 mG of the earth
TURNED = 0.1  # rad; 6 deg of heading, which compasses reach without a fault
QUIET = 0.005  # 1; of the field: what every sensor may have as noise, 2.5 mG (HMC5883L: 2 mG)
STRONG = 0.6  # 1; of the field: what currents may add before ArduPilot's compassmot calls it bad
SAME = 0.5  # 1; by which jumps differ that have one cause


class Field(NamedTuple):
    """What a magnetometer reads beside the field that the attitude expects."""

    rest: Signal  # d (n, 3)
    size: float  # of the field
    currents: Floats  # (3,) c: what the usual range of the rotors' level adds
    sigma: Floats  # (3,) its standard deviation
    expected: Floats  # R' h + u c (n, 3)

    def turns(self, interval: Interval) -> bool:
        """Whether the expected reading moves in a stretch of time as if the vehicle turned by `TURNED`."""
        rows = slice(*np.searchsorted(self.rest.time, interval))
        part = self.expected[rows]
        return len(part) > 1 and float(np.ptp(part, axis=0).max()) > TURNED * self.size


def fields_of(flight: Flight, until: float = np.inf) -> dict[str, Field]:
    """Fit every magnetometer that there is enough of; beyond ``until`` [s] the attitude may be wrong."""
    fields = {name: _field_of(flight, sensor, until) for name, sensor in flight.log.magnetometers.items()}
    return {name: each for name, each in fields.items() if each is not None}


def _field_of(flight: Flight, sensor: Signal, until: float) -> Field | None:
    """Fit the field of the earth to a magnetometer; None without an attitude, or with too few samples."""
    attitude = flight.log.attitude
    if attitude is None or len(attitude) < FEWEST:
        return None
    inside = (sensor.time >= attitude.time[0]) & (sensor.time <= attitude.time[-1])
    time, value = sensor.time[inside], sensor.value[inside]
    if np.isfinite(value).all(axis=1).sum() < FEWEST:
        return None
    q = attitude_at(attitude, time)
    turned = np.stack([to_body(q, np.broadcast_to(axis, (len(time), 3))) for axis in np.eye(3)], axis=-1)
    level = _level(flight, time)
    currents = level[:, None, None] * np.eye(3)
    columns = np.concatenate([turned, currents], axis=2)  # (n, 3, 6)
    moved = np.any(np.diff(value, axis=0) != 0.0, axis=1)  # what repeats its reading says nothing
    if np.count_nonzero(moved & (time[1:] < until)) > FEWEST:
        moved &= time[1:] < until
    turns, changes = np.diff(columns, axis=0)[moved], np.diff(value, axis=0)[moved]
    known, sigma = robust_fit(turns.reshape(-1, 6), changes.ravel())
    expected = columns @ known
    size = float(np.nanmedian(np.linalg.norm(value, axis=1)))
    currents = _least(
        [robust_fit(turns[half].reshape(-1, 6), changes[half].ravel())[0][3:] for half in _halves(turns)]
    )
    return Field(Signal(time, value - expected), size, currents, sigma[3:], expected)


def _halves(rows: Floats) -> tuple[slice, slice]:
    middle = len(rows) // 2
    return slice(middle), slice(middle, None)


def _least(currents: Sequence[Floats]) -> Floats:
    """What currents add in each part of a flight (3,): a wrong attitude seems to add in one alone."""
    signs = np.sign(currents).sum(axis=0)
    return np.where(np.abs(signs) == len(currents), np.sign(signs) * np.min(np.abs(currents), axis=0), 0.0)


def _level(flight: Flight, time: Floats) -> Floats:
    """Level of the rotors at some times, as a share of its usual range (n,)."""
    level = rotor_level(flight.log)
    if level is None:
        return np.zeros(len(time))
    there = np.interp(time, level.time, np.nan_to_num(level.value[:, 0]))
    low, high = np.quantile(there, (0.05, 0.95))
    return there / (high - low) if high > low else np.zeros(len(time))


def robust_fit(columns: Floats, changes: Floats) -> tuple[Floats, Floats]:
    """Fit robustly; return what multiplies each column (k,), and its standard deviation."""
    good = np.isfinite(changes) & np.isfinite(columns).all(axis=1)
    columns, changes = columns[good], changes[good]
    weight: Floats = np.ones(len(changes))
    found: Floats = np.zeros(len(columns.T))
    sigma = 0.0
    for _ in range(ROUNDS):
        scaled = columns * weight[:, None]
        found = np.array(np.linalg.lstsq(scaled, weight * changes, rcond=1e-6)[0], np.float64)
        left: Floats = np.abs(changes - columns @ found)
        sigma = scale(left) + 1e-12
        weight = np.sqrt(np.minimum(1.0, HUBER * sigma / np.maximum(left, 1e-15)))
    variance: Floats = np.diag(np.array(np.linalg.pinv(columns.T @ columns, rcond=1e-9), np.float64))
    return found, sigma * np.sqrt(np.maximum(variance, 0.0))


def compass_findings(
    flight: Flight, agreement: Agreement | None, fields: Mapping[str, Field]
) -> Iterator[Found]:
    """Name magnetometers that part from the attitude."""
    jumps: dict[str, list[Step]] = {}
    for name, each in fields.items():
        smallest = np.full(len(each.rest), SMALLEST * each.size)
        jumps[name] = find_jumps(each.rest, flight.is_calm(each.rest.time), smallest)[0]
    for name in jumps:
        yield from _findings(flight, agreement, fields, jumps, name)


def _findings(
    flight: Flight,
    agreement: Agreement | None,
    fields: Mapping[str, Field],
    jumps: Mapping[str, list[Step]],
    name: str,
) -> Iterator[Found]:
    field, unit = fields[name], flight.log.field_unit
    component = component_name(COMPONENT, name)
    yield from noise_findings(flight, component, field.rest, BODY_AXES, unit, QUIET * field.size, alone=False)
    for step in jumps[name]:
        sharing = [other for other in jumps if other != name and any(_alike(step, s) for s in jumps[other])]
        is_common = len(sharing) == len(fields) - 1
        if is_common and _attitude_jumps(agreement, step, field.size):
            continue
        if is_common and sharing and name != next(iter(fields)):
            continue  # told of the first
        said = [f"it jumps by {show(step.size, unit)} against the field that the attitude expects"]
        may_be_attitude = is_common and bool(sharing)
        if may_be_attitude:
            said.append("all magnetometers do: the field around the vehicle is another one, or the attitude")
        elif len(fields) > 1:
            said.append("another magnetometer on the same vehicle does not")
        yield make_found(
            *(component, BODY_AXES[step.axis], "offset", step.onset),
            end_s=step.end,
            size=step.size,
            sigma=step.sigma,
            unit=unit,
            probability=confidence(step.score, 1.0) * (0.6 if may_be_attitude else 1.0),
            ambiguous_with=("attitude",) if may_be_attitude else (),
            evidence=tuple(said),
            curve=_curve(field, name, unit),
        )
    strongest = int(np.argmax(np.abs(field.currents)))
    added, sigma = float(field.currents[strongest]), float(field.sigma[strongest])
    if abs(added) > max(STRONG * field.size, 8.0 * sigma):
        start = flight.intervals[0].start
        others = (abs(each.currents[strongest]) for each in fields.values())
        all_do = len(fields) > 1 and min(others) > SAME * abs(added)
        said = (
            f"it follows the level of the rotors: their usual range adds {show(added, unit)}"
            f" to a field of {show(field.size, unit)}",
        )
        yield make_found(
            *(component, BODY_AXES[strongest], "interference", start),
            size=added,
            sigma=sigma,
            unit=unit,
            probability=confidence(abs(added), STRONG * field.size) * (0.6 if all_do else 1.0),
            ambiguous_with=("attitude",) if all_do else (),
            evidence=said,
            curve=_curve(field, name, unit),
            is_direct=True,
        )


def owner_by_field(creep: Creep, fields: Iterable[Field]) -> Owner | None:
    """Say whose creep it is by magnetometers: gyro or attitude; None: they cannot tell.

    An attitude that is turned by phi about the body axis e adds phi e x m to what is left of a reading m.
    """
    shares = [share for share in (_share_of_turn(creep, field) for field in fields) if share is not None]
    if not shares or min(shares) < SAME < max(shares):
        return None
    return Owner("attitude" if shares[0] > SAME else "gyro", "the field of the earth")


def _share_of_turn(creep: Creep, field: Field) -> float | None:
    """Return how much of a creep the attitude shows in the field (1: all); None: it would hardly show."""
    rest = field.rest
    end = min(creep.span.end, creep.span.start + 1.0 / abs(creep.size))  # before it has turned by a radian
    rows = slice(*np.searchsorted(rest.time, (creep.span.start, end)))
    if rows.stop - rows.start < FEWEST // 4:
        return None
    angle = -creep.size * (rest.time[rows] - creep.span.start)
    turned = angle[:, None] * np.cross(np.eye(3)[creep.axis], field.expected[rows])
    if float(np.linalg.norm(turned, axis=1).max()) < TURNED / SAME * field.size:
        return None
    seen, turned = (each - each.mean(axis=0) for each in (rest.value[rows], turned))
    return float(np.nansum(seen * turned) / np.sum(turned**2))


def _alike(step: Step, other: Step) -> bool:
    near = abs(step.onset - other.onset) < JUMP and step.axis == other.axis
    return near and abs(step.size - other.size) < SAME * abs(step.size)


def _attitude_jumps(agreement: Agreement | None, step: Step, field: float) -> bool:
    """Whether the attitude turns without the gyro, as far as such a jump takes."""
    if agreement is None:
        return False
    rows = slice(*np.searchsorted(agreement.time, (step.onset - JUMP, step.onset + JUMP)))
    angle = float(np.linalg.norm(agreement.rest[rows].sum(axis=0)))
    return angle * field > SAME * abs(step.size)


def _curve(field: Field, name: str, unit: str) -> Curve:
    lines = {axis: field.rest.value[:, k] for k, axis in enumerate(BODY_AXES)}
    title = f"{component_name(COMPONENT, name)} less the field that the attitude expects"
    return Curve(title, unit, field.rest.time, lines)
