"""Loss of a rotor by what it takes to hold the vehicle, at any rate.

A controller answers a lost rotor: it asks the others for a torque, at once and for as long as the rotor is
lost. With the layout B (rows roll and pitch, each of length 1) and commands u, shares of the thrust,

    r = B u - J alpha - L d(B u)/dt - D omega,

the torque that is asked for less what inertia, the rotors' lag and damping take of it, is next to constant in
healthy flight. Rotor i that loses the share s moves r by s B_i u_i. J, L and D (roll, pitch) are fitted to
the flight before. A vehicle goes out of control in this direction, too: the controller asks for one turn and
gets the opposite.

Where nobody knows the layout, the model of `identification` tells it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_replay.flight_log import FlightLog, Signal
from quadftc_replay.inspection.flight import Flight
from quadftc_replay.inspection.identification import Identified, drive_of
from quadftc_replay.inspection.rotor_trim import effects, normalised
from quadftc_replay.inspection.whitening import TO_SIGMA, Floats, Mask

WINDOWS = (0.15, 0.3, 1.0)  # s; over which r has moved
BEFORE, KNOWN = 2.0, 1.0  # s; over which it was known, and at least
FASTEST = 100.0  # Hz; of commands that are used
FEWEST = 3  # commands in a window
FLOOR = 0.01  # 1; standard deviation of r, at least: that of Crazyflies from flight to flight
LEVEL = 4.0  # standard deviations; the largest in healthy logs, of a share of a fifth or more, is 2.9
SOONER = 0.3  # s; by which a loss may begin before it is seen
ENDED = 2.0 * LEVEL  # standard deviations; of both steps of a loss that ends
CANDIDATE = 3.0  # standard deviations; of a step that the model of all before it has to confirm
LEAST, MOST = 0.2, 2.0  # 1; share of the rotor's thrust
ASIDE = 0.5  # 1; of what r moves by, that may point elsewhere
CALM = 0.35  # 1; quantile of the steps of a flight that is their usual size
STAYS = 0.5  # 1; of the share, that is missing until the vehicle is down, or the rotor back
ROUNDS = 3  # of fit and judgement
PARTS = (0.35, 0.5, 0.75, 1.0)  # 1; of the flight, by which models are fitted
LEAST_FLOWN = 30  # commands in flight
MIXED = 0.98  # 1; R² of a mixer from which it is used
USUAL = np.array([0.01, 0.03, 0.0])  # J [s²], L [s] and D [s], before anything is fitted
PRIOR = np.array([0.01, 0.03, 0.01])  # their standard deviations
SIGNED = (0, 2)  # J and D, which are never negative: what they may hide or feign has a sign
GAINS = 0.35  # 1; by which they may be off whatever the fit says: closed loops hide them
TOGETHER = 5.0  # 1; samples that tell as much as one that is independent
NEARLY = 0.8  # 1; of the score of the first, from which a second rotor is named
QUIET = 4.0  # standard deviations of the rate, at which it has begun to turn


class RotorStep(NamedTuple):
    """A rotor that lost thrust."""

    rotor: int
    onset: float  # s
    share: float
    sigma: float
    score: float  # standard deviations
    second: int | None  # the rotor that explains it nearly as well
    time: Floats  # (n,) [s]
    rest: Floats  # (n, 2) r
    end: float | None = None  # s; None: it lasts
    spells: int = 1  # how often its thrust is gone


class Torque(NamedTuple):
    """What is asked for and what the vehicle does, at the commands' times."""

    time: Floats  # (n,) [s]
    commands: Floats  # (n, rotors)
    asked: Floats  # (n, 2) B u
    columns: Floats  # (n, 2, 3) alpha, d(B u)/dt, omega of each axis
    flying: Mask  # (n,)
    layout: Floats  # (2, rotors) B

    def rows(self, rows: NDArray[np.int_]) -> Torque:
        """Return some samples."""
        time, commands, asked, columns, flying, layout = self
        return Torque(time[rows], commands[rows], asked[rows], columns[rows], flying[rows], layout)


def fast_commands(log: FlightLog) -> Signal | None:
    """Return the commands of the rotors (n, rotors): by torque and thrust where these are logged faster.

    The mixer between the two is fitted to the log itself.
    """
    commands, torque, thrust = log.rotor_commands, log.torque_command, log.thrust_command
    if commands is None or torque is None or thrust is None or torque.rate < 1.5 * commands.rate:
        return commands
    ones = np.ones((len(torque), 1))
    asked = Signal(torque.time, np.hstack([torque.value, thrust.at(torque.time)[:, :1], ones]))
    at = asked.at(commands.time)
    inside = (commands.value > 0.02).all(axis=1) & (commands.value < 0.98).all(axis=1)
    inside &= (commands.time >= torque.time[0]) & (commands.time <= torque.time[-1])
    inside &= np.isfinite(at).all(axis=1)
    if inside.sum() < 20:
        return commands
    mixer = np.linalg.lstsq(at[inside], commands.value[inside], rcond=None)[0]
    left = commands.value[inside] - at[inside] @ mixer
    explained = 1.0 - left.var() / max(float(commands.value[inside].var()), 1e-12)
    mixed = np.clip(asked.value @ mixer, 0.0, 1.0)
    return Signal(torque.time, mixed) if explained > MIXED else commands


def torque_of(flight: Flight, axes: tuple[int, ...] = (0, 1)) -> Torque | None:
    """Put commands and gyro together for some axes; None where one of them, or the layout, is missing."""
    commands, layout = fast_commands(flight.log), effects(flight.log)
    if commands is None or layout is None or commands.value.shape[1] != layout.shape[1]:
        return None
    return _put_together(flight, commands, layout[list(axes)], axes)


def torque_by_model(flight: Flight, model: Identified) -> Torque | None:
    """Put what drives the rotors and the gyro together, by the layout of a model; None: it has none."""
    drive = drive_of(flight.log)
    if drive is None or model.source == "torque_command" or not model.usable[:2].all():
        return None
    return _put_together(flight, drive[1], normalised(model.gain[:, :2].T), (0, 1))


def _put_together(flight: Flight, commands: Signal, layout: Floats, axes: tuple[int, ...]) -> Torque | None:
    if flight.gyro is None:
        return None
    gyro = flight.gyro[1]
    stride = max(1, round(commands.rate / FASTEST))
    time, value = (each[::stride] for each in commands.whole())
    inside = (time > gyro.time[0]) & (time < gyro.time[-1])
    time, value = time[inside], value[inside]
    if len(time) < LEAST_FLOWN or gyro.rate < 5.0:
        return None
    asked = value @ layout.T
    half = 0.5 * max(float(np.median(np.diff(time))), 2.0 / gyro.rate)
    rates = Signal(gyro.time, np.nan_to_num(gyro.value[:, list(axes)]))
    later, sooner, now = rates.at(time + half), rates.at(time - half), rates.at(time)
    alpha = (later - sooner) / (2.0 * half)
    columns = np.stack([alpha, np.gradient(asked, time, axis=0), now], axis=-1)
    flying = flight.in_flight(time) & (time < flight.until)
    if flying.sum() < LEAST_FLOWN:
        return None
    return Torque(time, value, asked, columns, flying, layout)


def fit(torque: Torque, moved: Floats) -> tuple[Floats, Floats]:
    """Fit J, L, D of each of k axes to flight, robustly (k, 3), with their covariance (k, 3, 3).

    ``moved`` (n, k) is what a loss makes.
    """
    axes, flying = torque.asked.shape[1], torque.flying
    found, covariance = np.tile(USUAL, (axes, 1)), np.zeros((axes, 3, 3))
    for axis in range(axes):
        rows = torque.columns[flying, axis]
        asked = (torque.asked - moved)[flying, axis]
        weight = np.ones(len(rows))
        for _ in range(2 * ROUNDS):
            middle = np.average(asked - rows @ found[axis], weights=weight)
            scaled = rows * weight[:, None]
            power = scaled.T @ rows / TOGETHER + np.diag((FLOOR / PRIOR) ** 2)
            known = scaled.T @ (asked - middle) / TOGETHER + (FLOOR / PRIOR) ** 2 * USUAL
            found[axis] = np.linalg.solve(power, known)
            # gusts that the controller answers look like less inertia, and less damping
            found[axis, SIGNED] = np.maximum(found[axis, SIGNED], 0.0)
            left = np.abs(asked - middle - rows @ found[axis])
            bound = 2.0 * TO_SIGMA * float(np.median(left)) + 1e-9
            weight = np.minimum(1.0, bound / np.maximum(left, 1e-12))
            noise = bound**2 / 4.0 + FLOOR**2
            covariance[axis] = noise * np.linalg.inv(power) + np.diag((GAINS * found[axis]) ** 2)
    return found, covariance


def find_step(flight: Flight, torque: Torque) -> tuple[RotorStep | None, float]:
    """Find the first rotor that lost thrust; and what share of any rotor's thrust would show.

    What comes after a loss spoils the model. So models of longer and longer parts of the flight look for one,
    and it has to show with the model of what came before it, too.
    """
    shows = _share_that_shows(torque)
    for end in np.quantile(torque.time[torque.flying], PARTS).tolist():
        step = search(torque, *_model(torque, end), level=CANDIDATE)
        for _ in range(ROUNDS):
            if step is None:
                break
            again = search(torque, *_model(torque, step.onset - SOONER, step))
            is_same = again is not None and again.rotor == step.rotor
            if again is not None and is_same and abs(again.onset - step.onset) < SOONER:
                return again._replace(onset=_begins_to_turn(flight, torque, again)), shows
            step = again
    return None, shows


def _share_that_shows(torque: Torque) -> float:
    """Return the share of its thrust that any rotor may lose without being seen."""
    part = torque.rows(np.flatnonzero(torque.flying))
    rest = part.asked - np.einsum("nak,ak->na", part.columns, fit(part, np.zeros_like(part.asked))[0])
    period = float(np.median(np.diff(part.time)))
    before, count = (max(FEWEST, round(each / period)) for each in (BEFORE, WINDOWS[-1]))
    k = np.arange(FEWEST, len(rest) - FEWEST + 1)
    sigma = np.hypot(FLOOR, scatter(steps(rest, k, before, count)))
    effect = np.median(part.commands, axis=0) * np.linalg.norm(part.layout, axis=0)
    return float(np.max(LEVEL * sigma / np.maximum(effect, 1e-9)))


def _model(torque: Torque, end: float, step: RotorStep | None = None) -> tuple[Floats, Floats]:
    """Fit to the flight up to a time [s]; if that is too little, to all of it less what a loss makes."""
    moved, before = np.zeros_like(torque.asked), torque.flying & (torque.time < end)
    if step is not None and before.sum() < LEAST_FLOWN:
        late = (torque.time >= step.onset)[:, None]
        moved = step.share * late * torque.commands[:, step.rotor, None] * torque.layout[:, step.rotor]
        before = torque.flying
    return fit(torque._replace(flying=before), moved)


class _Moved(NamedTuple):
    """How r moves at some rows, as shares of each rotor's thrust, (m, rotors)."""

    share: Floats
    sure: Floats  # by the least favourable model
    sigma: Floats
    aside: Mask  # whether it points elsewhere

    @property
    def signed(self) -> Floats:
        """Standard deviations by which thrust is missing."""
        return np.asarray(self.sure / self.sigma)


class _Begin(NamedTuple):
    """Where a rotor begins to give less."""

    rotor: int
    row: int
    base: slice  # rows before, of what r is otherwise
    share: float  # by the least favourable model
    score: float  # standard deviations


class _Residual(NamedTuple):
    """The torque that is asked for in vain, in flight, by a model."""

    part: Torque
    rest: Floats  # (n, 2) r
    doubt: Floats  # (n, 2) its variance by the model's
    factors: Floats
    covariance: Floats

    def moves(self, k: NDArray[np.int_], before: int | NDArray[np.int_], count: int, usual: float) -> _Moved:
        """Compare the steps at rows ``k``, over ``count`` samples less ``before``, with those of each rotor.

        ``usual`` is the standard deviation of such steps.
        """
        part, covariance = self.part, self.covariance
        others_only = covariance.copy()
        others_only[:, SIGNED, :] = others_only[:, :, SIGNED] = 0.0
        step = steps(self.rest, k, before, count)
        unsure = steps(part.columns.reshape(-1, 6), k, before, count).reshape(len(k), 2, 3)
        variance = np.einsum("nak,akl,nal->na", unsure, others_only, unsure) + usual**2 + FLOOR**2
        least = _least_favourable(step, unsure, self.factors, covariance)
        effect = _after(part.commands, k, count)[:, :, None] * part.layout.T  # (m, rotors, 2)
        power = np.sum(effect**2 / variance[:, None], axis=2) + 1e-12
        share, sure = (np.einsum("mra,ma->mr", effect, each / variance) / power for each in (step, least))
        aside = np.linalg.norm(least[:, None] - sure[..., None] * effect, axis=2)
        far = aside >= ASIDE * np.linalg.norm(least, axis=1)[:, None]
        return _Moved(share, sure, 1.0 / np.sqrt(power), far)

    def missing(self, rotor: int, spell: slice, base: slice) -> float:
        """Share of a rotor that is missing in a spell, where the model is still sure, against rows before."""
        effect = self.part.commands[spell, rotor, None] * self.part.layout[:, rotor]
        weight = 1.0 / (FLOOR**2 + self.doubt[spell])
        power = float(np.sum(weight * effect**2))
        gone = self.rest[spell] - self.rest[base].mean(axis=0)
        return float(np.sum(weight * gone * effect)) / max(power, 1e-12)

    def missing_by_any(self, rotor: int, spell: slice, around: slice) -> float:
        """Share of a rotor that is missing in a spell, by the J, L and D that fit best to the rows around."""
        part = self.part
        gone = np.zeros((len(self.rest), 1))
        gone[spell] = part.commands[spell, rotor, None]
        both = np.stack([part.asked, gone * part.layout[:, rotor]], axis=2)[around]  # (n, 2, 2)
        for axis in range(both.shape[1]):  # what a model leaves of both
            known = np.column_stack([part.columns[around, axis], np.ones(len(both))])
            both[:, axis] -= known @ np.linalg.lstsq(known, both[:, axis], rcond=None)[0]
        asked, effect = both[..., 0], both[..., 1]
        return float(np.sum(asked * effect)) / max(float(np.sum(effect**2)), 1e-12)

    def back_at(self, begin: _Begin, count: int, usual: float) -> tuple[int, float]:
        """Return the row at which a lost share of a rotor is there again, and how surely; else the end."""
        k = np.arange(begin.row + FEWEST, len(self.rest) - FEWEST + 1)
        if len(k):
            moved = self.moves(k, np.minimum(k - begin.row, count), count, usual)
            signed = -moved.signed[:, begin.rotor]
            there = (-moved.sure[:, begin.rotor] > STAYS * begin.share) & (signed > LEVEL)
            if there.any():
                first = int(np.argmax(there))
                best = first + int(np.argmax(signed[first : first + count]))
                return int(k[best]), float(signed[best])
        return len(self.rest), 0.0

    def follow(
        self, begin: _Begin, before: int, count: int, usual: float
    ) -> tuple[float | None, int, int | None]:
        """Follow a rotor that gives less: the share that is missing, until which row, and when r was back.

        No share: r is back without a step as sharp as the first, or by an inertia that the model does not
        have. No row at which it was back: the rotor stays away.
        """
        rotor, row, base, share, score = begin
        end, least = len(self.rest), STAYS * share
        whole = self.missing(rotor, slice(row, None), base)
        stays = whole > least
        back, sure = self.back_at(begin, count, usual)
        if back < end and self.missing(rotor, slice(back, None), base) < least:
            spell, around = slice(row, back), slice(max(row - before, 0), min(back + before, end))
            within = min(self.missing(rotor, spell, base), self.missing_by_any(rotor, spell, around))
            if within > least and min(score, sure) > ENDED:
                return within, back, back
            if not stays:
                return None, end, back
        return (whole if stays else None), end, None


def search(torque: Torque, factors: Floats, covariance: Floats, level: float = LEVEL) -> RotorStep | None:
    """Find the first step of r that a rotor explains, by a model and its covariance.

    The thrust stays away, or comes back by a step as sharp, and may go again. The end of a loss is no loss of
    the rotor that faces it: r is as it was before both.
    """
    period = float(np.median(np.diff(torque.time)))
    part = torque.rows(np.flatnonzero(torque.flying))
    rest = part.asked - np.einsum("nak,ak->na", part.columns, factors)
    doubt = np.einsum("nak,akl,nal->na", part.columns, covariance, part.columns)
    residual = _Residual(part, rest, doubt, factors, covariance)
    best: RotorStep | None = None
    for window in WINDOWS:
        spells = list(_spells(residual, period, window, level))
        if spells and (best is None or spells[0].onset < best.onset - window):
            own = [each for each in spells if each.rotor == spells[0].rotor]
            best = own[0]._replace(end=own[-1].end, spells=len(own))
    return best


def _spells(residual: _Residual, period: float, window: float, level: float) -> Iterator[RotorStep]:
    """Find spells in which a rotor gives less, each from a step over a window [s] on."""
    part, rest = residual.part, residual.rest
    before, shortest = max(2 * FEWEST, round(BEFORE / period)), max(FEWEST, round(WINDOWS[0] / period))
    count = max(FEWEST, round(window / period))
    k = np.arange(max(FEWEST, round(KNOWN / period)), len(rest) - shortest + 1)
    if not len(k):
        return
    usual = scatter(steps(rest, k, before, count))
    moved = residual.moves(k, before, count, usual)
    share, sure, signed = moved.share, moved.sure, moved.signed
    score: Floats = np.where((signed > level) & (sure > LEAST) & (sure < MOST) & ~moved.aside, signed, 0.0)
    over = origin = 0  # end of the last spell, and where r was as usual before it
    starts: list[int] = np.flatnonzero(score.any(axis=1)).tolist()
    for first in starts:
        at = first + int(np.argmax(score[first : first + count].max(axis=1)))
        rotor, row = int(np.argmax(score[at])), int(k[at])
        if row < over:
            continue
        known = origin if over > 0 and row < over + before else row
        begin = _Begin(
            rotor, row, slice(max(known - before, 0), known), *(each[at, rotor] for each in (sure, score))
        )
        whole, stop, back = residual.follow(begin, before, count, usual)
        if back is not None:
            over, origin = back, known
        if whole is None:
            continue
        others: Floats = score[at].copy()
        others[rotor] = 0.0
        second = int(np.argmax(others))
        yield RotorStep(
            rotor=rotor,
            onset=float(part.time[row]),
            share=min(max(whole, float(share[at, rotor])), 1.0),  # inertia that is too small hides some
            sigma=float(np.hypot(moved.sigma[at, rotor], 0.5 * (share - sure)[at, rotor])),
            score=float(score[at, rotor]),
            second=second if others[second] > NEARLY * score[at, rotor] else None,
            time=part.time,
            rest=rest,
            end=None if stop == len(rest) else float(part.time[stop]),
        )
        if stop == len(rest):
            return


def _least_favourable(step: Floats, columns: Floats, factors: Floats, covariance: Floats) -> Floats:
    """Steps (m, 2) by the inertia and damping, within two standard deviations, that leave least of them."""
    low, high = step.copy(), step.copy()
    for k in SIGNED:
        sigma = np.sqrt(covariance[:, k, k])
        less, more = np.minimum(factors[:, k], 2.0 * sigma) * columns[..., k], -2.0 * sigma * columns[..., k]
        low, high = low + np.minimum(less, more), high + np.maximum(less, more)
    return np.where(low > 0.0, low, np.where(high < 0.0, high, 0.0))


def _after(values: Floats, k: NDArray[np.int_], count: int) -> Floats:
    """Means over the ``count`` rows from each moment on (m, ...)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    last = np.minimum(k + count, len(values))
    return (total[last] - total[k]) / (last - k)[:, None]


def steps(values: Floats, k: NDArray[np.int_], before: int | NDArray[np.int_], count: int) -> Floats:
    """Means after each moment less those before it (m, ...)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    first = np.maximum(k - before, 0)
    return _after(values, k, count) - (total[k] - total[first]) / (k - first)[:, None]


def scatter(step: Floats) -> float:
    """Standard deviation of the steps of a flight (m, 2), by its calmer part."""
    return TO_SIGMA * float(np.quantile(np.linalg.norm(step, axis=1), CALM))


def _begins_to_turn(flight: Flight, torque: Torque, step: RotorStep) -> float:
    """Return when the vehicle begins to turn as it does without the rotor [s]; the answer comes later."""
    assert flight.gyro is not None  # else there were no torques
    gyro = flight.gyro[1]
    direction = -torque.layout[:, step.rotor] / np.linalg.norm(torque.layout[:, step.rotor])
    period = float(np.median(np.diff(torque.time)))
    first, last = np.searchsorted(gyro.time, (step.onset - BEFORE, step.onset + 2.0 * period))
    along = np.nan_to_num(gyro.value[first:last, :2]) @ direction
    change = np.diff(along, prepend=along[:1])
    usual = TO_SIGMA * float(np.median(np.abs(change))) + 1e-6
    near = np.flatnonzero(gyro.time[first:last] > step.onset - max(3.0 * period, 0.15))
    turning = near[change[near] > QUIET * usual]
    return float(gyro.time[first + turning[0]]) if len(turning) else step.onset
