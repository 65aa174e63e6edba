"""Loss of a rotor in flight: the vehicle turns, all at once, as it does without part of that rotor's thrust.

With the model of `identification`, e = alpha - G u_T - d is what the rotors do not explain. When rotor i
loses share s, e jumps by -s G_i u_i in every axis, whatever the controller does next. For each time t, the
mean of e after t less that before is compared with all rotors:

    s_i = g' W delta / g' W g,    g = -G_i mean(u_i),    W = diag(1 / sigma²)

Of all t and i the one is taken that explains most, if it explains it well, and goes on to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from quadftc_replay.inspection.identification import Grid, Identified, lagged, responses, smooth_like_gradient
from quadftc_replay.inspection.whitening import TO_SIGMA, Floats, Mask

BEFORE = 0.3  # s; over which e is known
AFTER = (0.06, 0.12)  # s; over which it has jumped
STAYS = 0.3  # s; over which it has to stay so, if the log goes on for so long
SCORE = 100.0  # 1; what a rotor has to explain of the sum of squares, over sigma²
CLEARER = 2.5  # times: what it has to explain more than anything before it
SOONER = 0.5  # s; so long before it counts as before
SHARE = 0.7  # 1; of all that is to be explained
LEAST, MOST = 0.3, 1.8  # 1; of the rotor's thrust: less is not seen for sure, more is something else
AHEAD = 1.5  # times: what it has to explain more than the next rotor
REMAINS = 0.5  # 1; of the share, that has to stay


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


def find_loss(grid: Grid, model: Identified) -> Loss | None:
    """Find the clearest loss of a rotor; None if there is none."""
    usable = model.usable
    if usable[:2].sum() < 2:
        return None
    rest = unexplained(grid, model)[:, usable]
    best: Loss | None = None
    for after in AFTER:
        found = _best_onset(grid, model, rest, after)
        if found is not None and (best is None or found.score > best.score):
            best = found
    return best


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
    """Standard deviation of the changes (n, c): of the flight, or of the seconds around if that is more."""
    usual = TO_SIGMA * np.median(np.abs(change[watched]), axis=0)
    length = max(8, round(2.0 / dt))
    count = max(len(change) // length, 1)
    local = np.stack([np.median(np.abs(part), axis=0) for part in np.array_split(change, count)])
    rows = np.minimum(np.arange(len(change)) * count // len(change), count - 1)
    return np.maximum(TO_SIGMA * local[rows], usual)


def _best_onset(grid: Grid, model: Identified, rest: Floats, after: float) -> Loss | None:
    before, count = round(BEFORE / grid.dt), max(2, round(after / grid.dt))
    if len(rest) < 4 * before or grid.flying.sum() < 4 * before:
        return None
    change = _changes(rest, before, count)
    sigma = _scatter(change, grid.flying, grid.dt) + 1e-9
    driven = _window_means(lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt), count)
    effect = -driven[:, :, None] * model.gain[:, model.usable][None]  # (n, rotors, c)
    weighted = change / sigma**2
    along = np.einsum("nrc,nc->nr", effect, weighted)
    power = np.einsum("nrc,nc->nr", effect**2, 1.0 / sigma**2)
    share = along / np.maximum(power, 1e-12)
    explained = np.where(along > 0.0, along**2 / np.maximum(power, 1e-12), 0.0)
    total = np.sum(change * weighted, axis=1)
    watched = ndimage.binary_dilation(grid.flying, np.ones(2 * count + 1, np.bool_))
    fits = (explained > np.maximum(SCORE, SHARE * total[:, None])) & watched[:, None]
    fits &= (share > LEAST) & (share < MOST)
    if not fits.any():
        return None
    score = np.where(fits, explained, 0.0)
    for row in np.argsort(score.max(axis=1))[::-1][:50].tolist():
        rotor = int(np.argmax(score[row]))
        if score[row, rotor] <= 0.0:
            break
        earlier = slice(0, max(row - round(SOONER / grid.dt), 0))
        known = float(explained[earlier][grid.flying[earlier]].max(initial=0.0))
        size = float(share[row, rotor])
        if score[row, rotor] < CLEARER * known or not _stays(grid, model, rest, row, rotor, size):
            continue
        others = np.where(np.arange(len(share[row])) == rotor, 0.0, explained[row])
        second = int(np.argmax(others))
        is_close = float(score[row, rotor]) < AHEAD * float(others[second])
        gains, stds = model.gain[rotor, :2], model.gain_std[rotor, :2]
        of_gain = size * float(np.sqrt(np.mean((stds / gains) ** 2)))
        return Loss(
            rotor=rotor,
            onset=_refine(grid, model, rest, sigma[row], row, rotor),
            share=size,
            sigma=float(np.hypot(1.0 / np.sqrt(power[row, rotor]), of_gain)),
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
    """Whether the rotor still lacks its share a while later; a blow does not last."""
    first, last = row + round(0.5 * STAYS / grid.dt), row + round(STAYS / grid.dt)
    if last >= len(rest):
        return True
    before = rest[max(row - round(BEFORE / grid.dt), 0) : row].mean(axis=0)
    later = rest[first:last].mean(axis=0) - before
    driven = lagged(np.nan_to_num(grid.inputs), model.lag, grid.dt)[first:last, rotor].mean()
    effect = -driven * model.gain[rotor, model.usable]
    scale = np.abs(model.gain[:, model.usable]).mean(axis=0) ** 2
    remaining = float((later / scale) @ effect) / float((effect / scale) @ effect)
    return remaining > REMAINS * share
