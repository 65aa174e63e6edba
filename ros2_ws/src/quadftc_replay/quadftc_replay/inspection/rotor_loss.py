"""Loss of a rotor in flight: the vehicle turns, all at once, as it does without part of that rotor's thrust.

With the model of `identification`, e = alpha - G u_T - d is what the rotors do not explain. When rotor i
loses share s, e jumps by -s G_i u_i in every axis, whatever the controller does next. For each time t, the
mean of e after t less that before is compared with all rotors:

    s_i = g' W delta / g' W g,    g = -G_i mean(u_i),    W = diag(1 / sigma²)

The first t is taken at which a rotor explains e far better than anything before, goes on to, and leaves no
more than gains that are off by a third can. Yaw does not count: rotors that change their speed turn the
vehicle, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from quadftc_replay.inspection.identification import (
    Blocks,
    Grid,
    Identified,
    identify,
    in_blocks,
    lagged,
    responses,
    smooth_like_gradient,
)
from quadftc_replay.inspection.whitening import TO_SIGMA, Floats, Mask

BEFORE = 0.3  # s; over which e is known
AFTER = (0.06, 0.12)  # s; over which it has jumped
STAYS = (0.06, 0.15)  # s; after it jumped, over which it has to stay so, if the log goes on for so long
SWITCHED = 0.5  # 1; of its drive, below which a rotor has been switched off
SCORE = 100.0  # 1; what a rotor has to explain of the sum of squares, over sigma²
CLEARER = 2.5  # times: what it has to explain more than anything before it
SOONER = 0.5  # s; so long before it counts as before
BEGIN = 5.0  # s; of the flight, before there is a model
PARTS = (0.2, 0.35, 0.5, 0.75, 1.0)  # 1; of the flight, of which models look at what follows
PAST = 2.0  # s; of which the scatter counts
PEAK = 0.1  # s; from where it is seen first to where it is clearest
GAINS = 0.35  # 1; by which gains may be off, of those that an axis has
FIT = 6.0  # 1; sum of squares that a rotor may leave, over what sigma and the gains explain
LEAST, MOST = 0.3, 1.8  # 1; of the rotor's thrust: less is not seen for sure, more is something else
AHEAD = 1.5  # times: what it has to explain more than the next rotor
REMAINS = 0.5  # 1; of the share, that has to stay
PIECE = 2**16  # bins


class Loss(NamedTuple):
    """A rotor that lost thrust in flight."""

    rotor: int
    onset: float  # s
    share: float
    sigma: float
    score: float
    second: int | None  # the rotor that explains it nearly as well


def unexplained(grid: Grid, model: Identified) -> Floats:
    """What the rotors do not explain (n, c), in the axes that the model has; others are NaN."""
    driven = smooth_like_gradient(lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt))
    rest = np.nan_to_num(responses(grid)) - driven @ model.gain
    return np.where(model.usable, rest, np.nan)


def search_loss(source: str, grid: Grid) -> tuple[Loss | None, Identified | None]:
    """Find the first loss of a rotor, and return the model that shows it, else that of the whole flight.

    What comes after a loss would spoil the model. So models of longer and longer parts of the flight each
    look at what follows, and a loss has to show with the model of all that came before it, too. If there is
    none with such a model, the begin is looked at with that of the rest.
    """
    blocks = in_blocks(grid)
    whole = identify(source, grid, blocks)
    if whole is None:
        return None, None
    ahead = _look_ahead(source, grid, blocks, whole)
    if ahead is not None and ahead[0].onset > float(grid.time[grid.flying][0]) + BEGIN:
        return ahead
    return _look_back(source, grid, blocks) or ahead or (None, whole)


def _look_ahead(source: str, grid: Grid, blocks: Blocks, whole: Identified) -> tuple[Loss, Identified] | None:
    """Find the first loss by models of what was before, or before a bit later."""
    flown = grid.time[grid.flying]
    ends = [float(np.quantile(flown, part)) for part in PARTS]
    begin = float(flown[0])
    for end, limit in zip(ends, [*ends[1:], float(grid.time[-1])], strict=True):
        model = whole if end >= ends[-1] else identify(source, grid, blocks, end)
        if model is None:
            continue
        while (loss := find_loss(grid, model, (begin, limit))) is not None:
            before = identify(source, grid, blocks, loss.onset - SOONER)
            again = None
            if before is not None:
                again = find_loss(grid, before, (loss.onset - SOONER, loss.onset + SOONER))
            if before is None or (again is not None and again.rotor == loss.rotor):
                return again or loss, before or model
            begin = loss.onset + SOONER
        begin = max(begin, limit - SOONER)
    return None


def _look_back(source: str, grid: Grid, blocks: Blocks) -> tuple[Loss, Identified] | None:
    """Find a loss at the begin of the flight by the model of the rest.

    The rest does not tell what a rotor gave that was lost before. The others do: rotors together hardly turn
    a vehicle, so that their gains add up to zero.
    """
    begin = float(grid.time[grid.flying][0])
    later = identify(source, grid, blocks, since=begin + BEGIN)
    if later is None:
        return None
    found: list[tuple[Loss, Identified]] = []
    for rotor in range(grid.inputs.shape[1]):
        gain = later.gain.copy()
        gain[rotor, :3] -= gain[:, :3].sum(axis=0)
        model = later._replace(gain=gain)
        loss = find_loss(grid.until(begin + 2.0 * BEGIN), model, (begin, begin + BEGIN))
        if loss is not None and loss.rotor == rotor:
            found.append((loss, model))
    return max(found, key=lambda each: each[0].score, default=None)


def find_loss(grid: Grid, model: Identified, span: tuple[float, float]) -> Loss | None:
    """Find the first loss of a rotor in a span of time [s]; None if there is none."""
    if model.usable[:2].sum() < 2:
        return None
    model = _without_yaw(model)
    rest = unexplained(grid, model)[:, model.usable]
    found = [_first_onset(grid, model, rest, after, span) for after in AFTER]
    return min(filter(None, found), key=lambda loss: (round(loss.onset, 1), -loss.score), default=None)


def _without_yaw(model: Identified) -> Identified:
    usable = model.usable.copy()
    usable[2] = False
    return model._replace(usable=usable)


def _window_means(values: Floats, count: int) -> Floats:
    """Means over the ``count`` bins that begin at each bin (n, c); fewer at the end."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    first = np.arange(len(values))
    last = np.minimum(first + count, len(values))
    return (total[last] - total[first]) / (last - first)[:, None]


def _changes(values: Floats, before: int, after: int) -> Floats:
    """Mean after each bin, it included, less that before (n, c); 0 where there is nothing before."""
    means_before = _window_means(values, before)
    change = np.zeros_like(values)
    change[before:] = _window_means(values, after)[before:] - means_before[:-before]
    return change


def _scatter(change: Floats, watched: Mask, dt: float) -> Floats:
    """Standard deviation of the changes (n, c): of the flight, or of the seconds before if that is more."""
    usual = TO_SIGMA * np.median(np.abs(change[watched]), axis=0)
    length = max(8, round(PAST / dt))
    count = max(len(change) // length, 1)
    local = np.stack([np.median(np.abs(part), axis=0) for part in np.array_split(change, count)])
    rows = np.minimum(np.arange(len(change)) * count // len(change), count - 1) - 1
    return np.maximum(TO_SIGMA * local[np.maximum(rows, 0)], usual)


class Compared(NamedTuple):
    """How each rotor explains the changes."""

    explained: Floats  # (n, rotors) of the sum of squares over sigma²
    share: Floats  # (n, rotors) of its thrust
    misfit: Floats  # (n, rotors) what it leaves, over what sigma and the gains explain


def _compare(change: Floats, sigma: Floats, effect: Floats) -> Compared:
    """Compare changes (n, c) with the effects of the rotors (n, rotors, c), piece by piece for memory."""
    pieces = [slice(first, first + PIECE) for first in range(0, len(change), PIECE)]
    return Compared(
        *map(
            np.concatenate,
            zip(*(_compare_piece(change[k], sigma[k], effect[k]) for k in pieces), strict=True),
        )
    )


def _compare_piece(change: Floats, sigma: Floats, effect: Floats) -> Compared:
    along = np.einsum("nrc,nc->nr", effect, change / sigma**2)
    power = np.einsum("nrc,nc->nr", effect**2, 1.0 / sigma**2)
    explained = np.where(along > 0.0, along**2 / np.maximum(power, 1e-12), 0.0)
    usual = np.sqrt(np.mean(effect**2, axis=1))[:, None]  # of all rotors: one may have no effect on an axis
    weight = 1.0 / (sigma[:, None] ** 2 + (GAINS * usual) ** 2)
    share = np.sum(weight * effect * change[:, None], axis=2) / np.sum(weight * effect**2, axis=2)
    off = GAINS * np.maximum(share, LEAST)[..., None] * usual
    misfit = np.sum((change[:, None] - share[..., None] * effect) ** 2 / (sigma[:, None] ** 2 + off**2), 2)
    return Compared(explained, share, misfit)


def _turning(grid: Grid, effect: Floats, before: int, count: int) -> Floats:
    """How far the angular acceleration itself changes as it does when rotors stop (n, rotors), 1: as far.

    Gains that are too large make a rotor that slows down look like a loss of the opposite one.
    """
    change = _changes(np.gradient(grid.rate[:, :2], grid.dt, axis=0), before, count)
    turn = effect[..., :2]
    return np.einsum("nrc,nc->nr", turn, change) / np.maximum(np.einsum("nrc,nrc->nr", turn, turn), 1e-12)


def turns_as_without(grid: Grid, model: Identified, rotor: int, moment: float) -> bool:
    """Whether the vehicle, at a moment [s], starts to turn as it does when a rotor stops."""
    rate = np.nan_to_num(grid.rate[:, :2])
    rows = np.searchsorted(grid.time, (moment - AFTER[1], moment, moment + AFTER[0], moment + AFTER[1]))
    if not model.usable[:2].all() or rows[1] <= rows[0] or rows[3] <= rows[2]:
        return False
    start, onset, soon, late = (int(row) for row in rows)
    trend = (rate[onset] - rate[start]) / (onset - start)
    change = rate[soon:late].mean(axis=0) - rate[onset] - trend * (0.5 * (soon + late) - onset)
    return bool(change @ -model.gain[rotor, :2] > 0.0)


def _first_onset(
    grid: Grid, model: Identified, rest: Floats, after: float, span: tuple[float, float]
) -> Loss | None:
    before, count = round(BEFORE / grid.dt), max(2, round(after / grid.dt))
    healthy = grid.flying & (grid.time < span[0])
    healthy = healthy if healthy.sum() > 8 * before else grid.flying
    if len(rest) < 4 * before or healthy.sum() < 4 * before:
        return None
    change = _changes(rest, before, count)
    sigma = _scatter(change, healthy, grid.dt) + 1e-9
    driven = _window_means(lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt), count)
    effect = -driven[:, :, None] * model.gain[:, model.usable][None] + 1e-12  # (n, rotors, c)
    seen = _compare(change, sigma, effect)
    watched = ndimage.binary_dilation(grid.flying, np.ones(2 * count + 1, np.bool_))
    fits = (seen.explained > SCORE) & (seen.misfit < FIT) & watched[:, None]
    fits &= (seen.share > LEAST) & (seen.share < MOST) & (_turning(grid, effect, before, count) > 0.0)
    fits &= ((grid.time >= span[0]) & (grid.time <= span[1]))[:, None]
    fits[len(fits) - count :] = False
    score = np.where(fits, seen.explained, 0.0)
    peak = round(PEAK / grid.dt)
    for first in np.flatnonzero(fits.any(axis=1)).tolist():
        row = first + int(np.argmax(score[first : first + peak].max(axis=1)))
        rotor = int(np.argmax(score[row]))
        earlier = slice(0, max(row - round(SOONER / grid.dt), 0))
        known = float(seen.explained[earlier][grid.flying[earlier]].max(initial=0.0))
        size = float(seen.share[row, rotor])
        if score[row, rotor] < CLEARER * known or not _stays(grid, model, rest, row + count, rotor, size):
            continue
        onset = _refine(grid, model, rest, sigma[row], row, rotor)
        if not turns_as_without(grid, model, rotor, onset):
            continue
        others = np.where(np.arange(len(score[row])) == rotor, 0.0, score[row])
        second = int(np.argmax(others))
        is_close = float(score[row, rotor]) < AHEAD * float(others[second])
        gains, stds = model.gain[rotor, :2], model.gain_std[rotor, :2]
        of_gain = size * float(np.sqrt(np.mean((stds / gains) ** 2)))
        return Loss(
            rotor=rotor,
            onset=onset,
            share=size,
            sigma=float(np.hypot(size / np.sqrt(seen.explained[row, rotor]), of_gain)),
            score=float(score[row, rotor]),
            second=second if is_close else None,
        )
    return None


def _refine(grid: Grid, model: Identified, rest: Floats, sigma: Floats, row: int, rotor: int) -> float:
    """Return the onset [s] near a bin for which a loss of this rotor leaves least."""
    reach = round(BEFORE / grid.dt)
    first, last = max(row - 2 * reach, 0), min(row + round(max(AFTER) / grid.dt), len(rest))
    effect = -lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt)[first:last, rotor, None]
    effect = effect * model.gain[rotor, model.usable] / sigma
    seen = rest[first:last] / sigma
    best, found = np.inf, row
    for onset in range(max(row - reach, first + 2), min(row + 3, last - 2)):
        after = np.arange(first, last) >= onset
        base = seen[~after].mean(axis=0)
        left = seen - base
        share = float(np.sum(left[after] * effect[after]) / np.sum(effect[after] ** 2))
        error = float(np.sum((left - share * effect * after[:, None]) ** 2))
        if error < best:
            best, found = error, onset
    return float(grid.time[found]) - 0.5 * grid.dt


def _stays(grid: Grid, model: Identified, rest: Floats, row: int, rotor: int, share: float) -> bool:
    """Whether a rotor still lacks its share after it jumped, before a bin; a blow does not last.

    Of a rotor that has been switched off meanwhile nobody knows.
    """
    first, last = row, row + round((STAYS[1] - STAYS[0]) / grid.dt)
    if last >= len(rest):
        return True
    start, until = row - round((BEFORE + STAYS[0]) / grid.dt), row - round(STAYS[0] / grid.dt)
    before = rest[max(start, 0) : max(until, 0)]
    if not (len(before) and last > first):  # too near the start, or bins too wide, to tell a jump from a blow
        return False
    later = rest[first:last].mean(axis=0) - before.mean(axis=0)
    drive = lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt)[:, rotor]
    driven = float(drive[first:last].mean())
    if driven < SWITCHED * float(drive[max(row - round(BEFORE / grid.dt), 0) : row].mean()):
        return True
    effect = -driven * model.gain[rotor, model.usable]
    scale = np.mean(model.gain[:, model.usable] ** 2, axis=0)
    remaining = float((later / scale) @ effect) / float((effect / scale) @ effect)
    return remaining > REMAINS * share
