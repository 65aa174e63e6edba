"""Tests of an attitude against the gyro: jumps, and a turning that the gyro does not see."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage, special

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.agreement import Agreement
from quadftc_replay.inspection.flight import Flight, Interval
from quadftc_replay.inspection.found import Curve, Found, confidence, make_found
from quadftc_replay.inspection.steps import Step, join_ends, steps_beyond
from quadftc_replay.inspection.whitening import Floats, Mask, find_steps

ANGLES = ("roll", "pitch", "yaw")
DEGREE = np.pi / 180.0  # rad
LEVEL = 10.0  # standard deviations of a jump
FLOOR = 0.05 * DEGREE  # rad; of its scatter
JUMP = 2.0 * DEGREE  # rad; optical markers that are mistaken make 1.1 deg in healthy recordings
OWN_JUMP = 5.0 * DEGREE  # rad; of an estimate made of the gyro, which is corrected now and then
UNKNOWN_JUMP = 3.0 * DEGREE  # rad; where nobody knows what the attitude is made of
PULSE = 0.1  # s; what goes back within it is an outlier
CREEP_WINDOWS = (0.5, 2.0, 8.0)  # s; over which the rates are compared
CREEP = (0.1, 0.05, 0.05)  # rad/s; least difference of the rates over each window
PER_RATE = (0.04, 0.02, 0.01)  # 1; of the body rate: what scale and alignment leave
CREEP_LEVEL = 8.0  # times the scatter of the means
LONG = 4.0  # s; after which an attitude has found its way back
GYRO_CREEP = 0.2  # rad/s; no attitude creeps that fast
KNOWN = 0.5  # 1; share of a window that makes a mean
HEALTHY = (0.1, 0.5, 0.9)  # 1; shares of the log, one of which is healthy
BETWEEN = 1.0  # s; stretches closer than that have one cause


class Creep(NamedTuple):
    """A stretch in which attitude and gyro turn at different rates."""

    axis: int
    span: Interval
    size: float  # rad/s; gyro less attitude
    sigma: float
    score: float  # 1: just enough to be one
    end: float | None  # s; None: it lasts


class Owner(NamedTuple):
    """Whose a creep is."""

    component: str  # gyro or attitude
    witness: str  # who says so


def find_jumps(agreement: Agreement, watched: Mask, smallest: float) -> list[Step]:
    """Find the jumps on each axis that last [rad]."""
    time, offset = agreement.time, np.cumsum(agreement.rest, axis=0)
    found: list[Step] = []
    for axis in range(3):
        steps = find_steps(time, offset[:, axis], np.ones(len(time), np.bool_), FLOOR)
        jumps = steps_beyond(time, steps, axis, watched, smallest, LEVEL)
        found += join_ends([each for each in jumps if not each.is_pulse], PULSE)
    return sorted(found, key=lambda jump: jump.onset)


def find_creeps(agreement: Agreement, watched: Mask, jumps: Sequence[Step]) -> list[Creep]:
    """Find stretches in which the rates differ for longer than any jump explains."""
    time, usual = agreement.time, float(np.median(agreement.dt))
    moments = sorted([each.onset for each in jumps] + [each.end for each in jumps if each.end is not None])
    near = np.zeros(len(time), np.bool_)
    for moment in moments:
        near |= np.abs(time - moment) < 2.5 * usual
    known = ~near & np.any(agreement.rest != 0.0, axis=1)
    rates = np.where(known[:, None], agreement.rest / agreement.dt[:, None], 0.0)
    turning = np.linalg.norm(agreement.turn, axis=1) / agreement.dt
    found: list[Creep] = []
    brief = ndimage.uniform_filter1d(rates, max(3, round(CREEP_WINDOWS[0] / usual)), axis=0)
    for window, least, share in zip(CREEP_WINDOWS, CREEP, PER_RATE, strict=True):
        count = max(3, round(window / usual))
        if len(time) < 4 * count:
            continue
        share_known = ndimage.uniform_filter1d(known.astype(float), count)
        there = np.flatnonzero(share_known > KNOWN)
        if len(there) < 2:
            continue
        means = ndimage.uniform_filter1d(rates, count, axis=0)[there] / share_known[there, None]
        means = Signal(time[there], means).at(time)  # straight over what is not known
        moving = ndimage.uniform_filter1d(np.nan_to_num(turning), count)
        swing = _swing(agreement, count)
        flown = ndimage.minimum_filter1d(watched.astype(np.int8), count) > 0  # all of the window
        for axis in range(3):
            level = min(np.quantile(means[:, axis], HEALTHY).tolist(), key=abs)
            mean = means[:, axis] - (level if abs(level) < least else 0.0)  # no healthy sensor is off by more
            mean /= 1.0 + agreement.scale[axis]
            changes = mean[count:] - mean[:-count]
            scatter = _scatter(changes, count) / np.sqrt(2.0) + 1e-9
            score = np.where(
                flown & (share_known > KNOWN),
                np.abs(mean)
                / (np.maximum(CREEP_LEVEL * scatter, least) + share * moving + usual * swing[:, axis]),
                0.0,
            )
            score[: count // 2] = score[len(score) - count // 2 :] = 0.0  # less than a window
            for run, best in stretches(mean, score, round(BETWEEN / usual)):
                # what is short and large is seen half a window too early
                size = float(np.median(mean[run]))
                begun = np.flatnonzero(brief[run, axis] * np.sign(size) > 0.5 * abs(size))
                start = run.start + int(begun[0]) if len(begun) else run.start
                span = Interval(float(time[start]), float(time[run.stop - 1]))
                lasts = run.stop > len(time) - round(BETWEEN / usual)
                end = None if lasts else span.end
                found.append(Creep(axis, span, -size, scatter, best, end))
    clearest = list[Creep]()
    for creep in sorted(found, key=lambda creep: -creep.score):
        if not any(_touch(creep, other) for other in clearest):
            clearest.append(creep)
    return sorted(clearest, key=lambda creep: creep.span.start)


def _scatter(changes: Floats, count: int) -> float:
    """Standard deviation of changes (n,) over ``count`` rows of means over as many, bar those of one step."""
    share = 0.5 * (1.0 - 2.0 * count / len(changes))
    return float(np.quantile(np.abs(changes), share) / special.ndtri(0.5 + 0.5 * share))


def _swing(agreement: Agreement, count: int) -> Floats:
    """By how much the body rate changes over ``count`` intervals around each, by their time (n, 3) [rad/s²].

    An attitude that is dated wrong by a time turns slower than the gyro by this, times that time.
    """
    rates = np.nan_to_num(agreement.turn / agreement.dt[:, None])
    rows = np.arange(len(rates))
    first, last = np.maximum(rows - count // 2, 0), np.minimum(rows + count // 2, len(rates) - 1)
    return np.abs(rates[last] - rates[first]) / (agreement.time[last] - agreement.time[first])[:, None]


def stretches(mean: Floats, score: Floats, apart: int) -> Iterator[tuple[slice, float]]:
    """Stretches with a score beyond 1, and their largest; each goes on while the mean is half as large."""
    left = score.copy()
    while len(left) and left.max() > 1.0:
        k = int(np.argmax(left))
        low = mean * np.sign(mean[k]) < 0.5 * abs(mean[k])
        before, after = np.flatnonzero(low[:k]), np.flatnonzero(low[k:])
        run = slice(int(before[-1]) + 1 if len(before) else 0, k + int(after[0]) if len(after) else len(mean))
        yield run, float(left[k])
        left[max(run.start - apart, 0) : run.stop + apart] = 0.0


def _touch(creep: Creep, other: Creep) -> bool:
    begin, end = creep.span.start - BETWEEN, creep.span.end + BETWEEN
    return creep.axis == other.axis and begin <= other.span.end and other.span.start <= end


def attitude_findings(
    agreement: Agreement,
    jumps: Sequence[Step],
    creeps: Sequence[Creep],
    is_own: bool,
    owner: Callable[[Creep], Owner | None] = lambda _: None,
) -> Iterator[Found]:
    """Say of jumps, and of creeps that no finding on the gyro explains.

    ``is_own``: the attitude is computed from the gyro. ``owner`` says whose a creep is, by another witness.
    """
    time, offset = agreement.time, np.cumsum(agreement.rest, axis=0) / DEGREE
    for jump in jumps:
        said = (
            f"it jumps by {jump.size / DEGREE:+.3g} deg within one sample while the gyro sees no turn,"
            f" {jump.score:.0f} standard deviations"
        )
        lines = {"attitude less integrated gyro": offset[:, jump.axis]}
        yield make_found(
            *("attitude", ANGLES[jump.axis], "offset", jump.onset),
            end_s=jump.end,
            size=jump.size,
            sigma=jump.sigma,
            unit="rad",
            probability=confidence(jump.score, LEVEL),
            evidence=(said,),
            curve=Curve(f"attitude {ANGLES[jump.axis]}", "deg", time, lines),
        )
    for creep, whose in ((each, owner(each)) for each in creeps):
        corrects = is_own and creep.axis == 2 and whose is not None and whose.component == "attitude"
        if not corrects:  # estimators correct their heading in flight, by compass or satellites
            yield _creep_found(creep, agreement, is_own, whose)


def disagreements(
    flight: Flight, agreement: Agreement, is_own: bool | None
) -> tuple[list[Step], list[Creep]]:
    """Find jumps and creeps; ``is_own``: the attitude is computed from the gyro, None: not known.

    Estimators reset their heading in flight, by compass or satellites: such jumps in yaw are left out.
    """
    watched = flight.is_calm(agreement.time)
    smallest = UNKNOWN_JUMP if is_own is None else (OWN_JUMP if is_own else JUMP)
    jumps = find_jumps(agreement, watched, smallest)
    creeps = find_creeps(agreement, watched, jumps)
    return [jump for jump in jumps if not is_own or jump.axis != 2], creeps


def _creep_found(creep: Creep, agreement: Agreement, is_own: bool, owner: Owner | None) -> Found:
    is_learned = is_own and creep.axis != 2 and creep.span.end - creep.span.start > LONG
    is_gyro = owner.component == "gyro" if owner else abs(creep.size) > GYRO_CREEP or is_learned
    names = ("gyro", "xyz"[creep.axis]), ("attitude", ANGLES[creep.axis])
    (component, element), other = names if is_gyro else names[::-1]
    said = [
        f"gyro less attitude turns by {creep.size:+.3g} rad/s between {creep.span.start:.2f} and"
        f" {creep.span.end:.2f} s, {creep.score:.1f} times what healthy sensors leave"
    ]
    if owner is None:
        far = "is put right for that long" if is_learned else "creeps that fast"
        said += [f"no attitude {far}"] if is_gyro else ["either of the two may drift"]
    else:
        said.append(f"{owner.witness} says that it is the {owner.component}")
    if is_own:
        said.append("the attitude is computed from this gyro, so that an error of both does not show")
    lines = {"attitude less integrated gyro": np.cumsum(agreement.rest[:, creep.axis]) / DEGREE}
    return make_found(
        *(component, element, "offset" if is_gyro or owner else "unknown", creep.span.start),
        end_s=creep.end,
        size=creep.size if is_gyro else -creep.size,
        sigma=creep.sigma,
        unit="rad/s",
        probability=(0.9 if is_gyro or owner else 0.5) * confidence(creep.score, 1.0),
        ambiguous_with=() if owner else ("/".join(other),),
        evidence=tuple(said),
        curve=Curve(f"{component} {element}", "deg", agreement.time, lines),
    )
