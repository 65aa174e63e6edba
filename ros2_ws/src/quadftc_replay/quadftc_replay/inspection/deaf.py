"""A gyro that stands still, but for noise, while the rotors turn the vehicle.

Behind an autopilot's filters a gyro that is stuck repeats no reading: noise is on it, of whatever size. Means
x over `BLOCK` follow each other where a gyro feels a motion, and do not where there is noise alone. So von
Neumann's ratio

    eta = sum (x_{k+1} - x_k)² / (2 sum (x_k - mean)²)

is next to 0 for a motion and next to 1 for white noise. A controller asks for a torque as the gyro sees a
motion. Where it asks for one that the gyro does not see, and goes on asking, the torque less what the motion
takes of it (r of `rotor_step`) leaves what it was. A lost rotor moves the gyro as well, and r on
several axes; the ground holds all axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from quadftc_replay.flight_log import Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.found import BODY_AXES, Curve, Found, component_name, confidence, make_found
from quadftc_replay.inspection.rotor_step import (
    ASIDE,
    BEFORE,
    ENDED,
    FEWEST,
    FLOOR,
    LEAST_FLOWN,
    QUIET,
    USUAL,
    WINDOWS,
    Torque,
    fit,
    scatter,
    steps,
    torque_of,
)
from quadftc_replay.inspection.whitening import Floats, runs_of, scale

BLOCK = 0.1  # s; a motion goes on for longer, and the noise of samples averages out
WHITE = 0.5  # 1; eta from which a stretch is noise: half way between motion and white noise
WINDOW = WINDOWS[1]  # s; over which the torque has to be asked for in vain


class Vain(NamedTuple):
    """A torque that is asked for in vain."""

    moment: float  # s; the first
    score: float  # standard deviations
    turn: float  # rad/s; by which it should turn the vehicle within `WINDOW`


def deaf_findings(flight: Flight) -> list[Found]:
    """Name the first axis of the main gyro on which torques are not answered."""
    if flight.gyro is None:
        return []
    blocks = _blocks(flight, flight.gyro[1])
    if len(blocks) < 2 * round(BEFORE / BLOCK):
        return []
    eta = _von_neumann(blocks)
    found = [each for axis in range(3) for each in _deaf(flight, blocks, eta, axis)]
    return sorted(found, key=lambda each: each.finding.onset_s)[:1]


def _blocks(flight: Flight, gyro: Signal) -> Signal:
    """Means over `BLOCK` of samples that follow each other in flight."""
    whole = flight.in_flight(gyro.time) & np.isfinite(gyro.value).all(axis=1)
    count = max(1, round(BLOCK * gyro.rate))
    rows = int(whole.sum()) // count * count
    time, value = (each[whole][:rows].reshape(-1, count, *each.shape[1:]) for each in gyro)
    return Signal(time.mean(axis=1), value.mean(axis=1))


def _von_neumann(blocks: Signal) -> Floats:
    """Return eta over `BEFORE` around each block (n, 3); 0 where a reading does not change."""
    count = round(BEFORE * blocks.rate)
    mean, square, change = (
        ndimage.uniform_filter1d(each, count, axis=0)
        for each in (
            blocks.value,
            blocks.value**2,
            np.diff(blocks.value, axis=0, prepend=blocks.value[:1]) ** 2,
        )
    )
    variance: Floats = square - mean**2
    return np.divide(0.5 * change, variance, out=np.zeros_like(change), where=variance > 1e-12 * square)


def _deaf(flight: Flight, blocks: Signal, eta: Floats, axis: int) -> Iterator[Found]:
    """Say since when one axis is deaf."""
    torque = torque_of(flight, (0, 1, 2))
    if torque is None or flight.gyro is None:
        return
    name, gyro = flight.gyro
    time, value = blocks.time, blocks.value[:, axis]
    half = round(0.5 * BEFORE * blocks.rate)
    for run in runs_of(eta[:, axis] > WHITE):
        # the noise of the run tells where it may have begun, that after the torque where it has
        near = slice(max(run.start - half, 0), run.stop + half)
        whole, _ = _stays(value, near, (run.start + run.stop) // 2)
        vain = _in_vain(torque, axis, time[max(whole.start, near.start) : whole.stop])
        if vain is None:
            continue
        row = int(np.searchsorted(time, vain.moment))
        whole, noise = _stays(value, slice(row, row + 2 * half), row)
        whole = slice(max(whole.start, near.start), whole.stop)
        vain = _in_vain(torque, axis, time[whole])
        if vain is None or vain.turn < QUIET * noise or np.median(eta[whole, axis]) < WHITE:
            continue
        # it felt motions before, but none as the torque began: a rotor that is lost makes one
        if np.median(eta[: whole.start, axis]) > WHITE or _moves(
            value, max(row - half, whole.start), row, half
        ):
            continue
        # the ground holds all axes
        until = slice(whole.start, int(np.searchsorted(time, vain.moment + WINDOW)))
        if np.median(np.delete(eta[until], axis, axis=1), axis=0).min() > WHITE:
            continue
        onset, end = float(time[whole.start]), float(time[whole.stop - 1])
        said = (
            f"for {end - onset:.2g} s it has noise of {noise:.2g} rad/s and follows no motion,"
            f" while the rotors turn the vehicle about this axis, by {vain.score:.0f} standard deviations",
        )
        yield make_found(
            *(component_name("gyro", name), BODY_AXES[axis], "stuck", onset),
            curve=Curve(f"gyro {BODY_AXES[axis]}", "rad/s", gyro.time, {"reading": gyro.value[:, axis]}),
            end_s=None if whole.stop >= len(value) - 1 else end,
            probability=confidence(vain.score, 0.5 * ENDED),
            evidence=said,
        )
        return


def _moves(value: Floats, first: int, row: int, count: int) -> bool:
    """Whether a reading (n,) moves within ``count`` rows by far more than from the first one to this row."""
    before = value[first:row]
    if not len(before):
        return True
    middle = float(np.median(before))
    return bool(np.any(np.abs(value[row : row + count] - middle) > 2.0 * QUIET * scale(before - middle)))


def _stays(value: Floats, part: slice, row: int) -> tuple[slice, float]:
    """Return the stretch around a row in which a reading (n,) stays where it is in a part, and its noise."""
    middle = float(np.median(value[part]))
    noise = scale(value[part] - middle)
    stays = ndimage.median_filter(np.abs(value - middle) < QUIET * noise, 3)  # bar single outliers
    runs = runs_of(np.asarray(stays, np.bool_))
    return next((each for each in runs if each.start <= row < each.stop), slice(row, row + 1)), noise


def _in_vain(torque: Torque, axis: int, span: Floats) -> Vain | None:
    """Return the torque that is asked for in vain within a span, by the model of what came before it.

    None as well where others begin with it, as where a rotor is lost.
    """
    if not len(span):
        return None
    onset, end = float(span[0]), float(span[-1])
    known = torque._replace(flying=torque.flying & (torque.time < onset))
    if known.flying.sum() < LEAST_FLOWN or end - onset < BEFORE:
        return None
    factors, _ = fit(known, np.zeros_like(torque.asked))
    part = torque.rows(np.flatnonzero(torque.flying))
    rest = part.asked - np.einsum("nak,ak->na", part.columns, factors)
    period = float(np.median(np.diff(part.time)))
    before, count = max(2 * FEWEST, round(BEFORE / period)), max(FEWEST, round(WINDOW / period))
    k = np.arange(FEWEST, len(rest) - count + 1)
    if not len(k):
        return None
    step = steps(rest, k, before, count)
    scores = np.abs(step) / np.hypot(FLOOR, [scatter(step[:, [each]]) for each in range(3)])
    at, score = part.time[k], scores[:, axis]
    inside = np.flatnonzero((at >= onset) & (at + WINDOW <= end) & (score > ENDED))
    if not len(inside):
        return None
    first = scores[np.abs(at - at[inside[0]]) <= WINDOW].max(axis=0)
    if np.delete(first, axis).max() > ASIDE * first[axis]:
        return None
    best = int(inside[np.argmax(score[inside])])
    turn = abs(float(step[best, axis])) * WINDOW / max(float(factors[axis, 0]), float(USUAL[0]))
    return Vain(float(at[inside[0]]), float(score[best]), turn)
