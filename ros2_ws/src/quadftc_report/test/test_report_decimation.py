"""Decimation for drawing: what must not be lost, and what may go."""

import numpy as np
import pytest

from quadftc_report.decimation import LIMIT, STRETCHES, TOLERANCE, choose_samples

COUNT = 20_000
TIME = np.arange(COUNT) / 250.0


def decimate(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    chosen = choose_samples(t, y)
    return t[chosen], y[chosen]


def noise(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=COUNT)


def gaps(y: np.ndarray) -> int:
    """Runs of NaN between samples."""
    known = np.flatnonzero(np.isfinite(y))
    return int(np.sum(np.diff(known) > 1))


def test_short_series_is_untouched():
    t, y = TIME[:LIMIT], noise()[:LIMIT]
    drawn_t, drawn_y = decimate(t, y)
    assert np.array_equal(drawn_t, t)
    assert np.array_equal(drawn_y, y)


@pytest.mark.parametrize("count", [COUNT, 19_997, 4_001, LIMIT + 1])
def test_extremes_of_every_stretch_are_kept(count):
    t, y = TIME[:count], noise()[:count]
    _, shown = decimate(t, y)
    # two stretches of the decimation fit into each of these, whichever way it divides the series
    stretches = np.array_split(y, STRETCHES // 3)
    assert all(part.min() in shown and part.max() in shown for part in stretches)
    assert len(shown) <= LIMIT


def test_drawn_points_are_samples_in_their_order():
    y = noise()
    t, shown = decimate(TIME, y)
    index = np.searchsorted(TIME, t)
    assert np.all(np.diff(index) > 0)
    assert np.array_equal(y[index], shown)
    assert index[0] == 0
    assert index[-1] == COUNT - 1


def test_gaps_are_kept_with_both_edges():
    y = noise()
    missing = [(100, 101), (5_000, 9_000), (15_000, 15_003)]
    for start, stop in missing:
        y[start:stop] = np.nan
    t, shown = decimate(TIME, y)
    assert gaps(shown) == len(missing)
    for start, stop in missing:
        assert {TIME[start - 1], TIME[start], TIME[stop]} <= set(t)
        assert not np.any((TIME[start] < t) & (t < TIME[stop]))


def test_many_gaps_are_all_kept():
    y = np.where(np.random.default_rng(1).random(COUNT) < 0.2, np.nan, noise())
    _, shown = decimate(TIME, y)
    assert gaps(shown) == gaps(y)


def test_unknown_beginning_and_end_are_not_drawn():
    y = noise()
    y[:4_000] = y[-4_000:] = np.nan
    t, shown = decimate(TIME, y)
    assert np.all(np.isfinite(shown))
    assert (t[0], t[-1]) == (TIME[4_000], TIME[-4_001])


def test_series_without_any_number_is_empty():
    t, shown = decimate(TIME, np.full(COUNT, np.nan))
    assert len(t) == len(shown) == 0


@pytest.mark.parametrize("onset", [1, 33, 4_999, 12_345, COUNT - 1])
def test_step_stays_at_its_sample(onset):
    t, shown = decimate(TIME, (np.arange(COUNT) >= onset).astype(float))
    jump = int(np.flatnonzero(np.diff(shown))[0])
    assert (t[jump], t[jump + 1]) == (TIME[onset - 1], TIME[onset])


def test_drawn_line_follows_a_transient_within_the_tolerance():
    y = np.where(TIME < 20.0, 0.0, 1.0 - np.exp(-np.maximum(TIME - 20.0, 0.0) / 0.02)) + 0.1 * np.sin(TIME)
    t, shown = decimate(TIME, y)
    assert np.max(np.abs(np.interp(TIME, t, shown) - y)) <= TOLERANCE * np.ptp(y)
    assert len(shown) < LIMIT


def test_constant_parts_cost_few_samples():
    y = np.floor(TIME / 20.0)  # four levels
    t, shown = decimate(TIME, y)
    assert len(shown) < 2 * STRETCHES
    assert np.array_equal(np.interp(TIME, t, shown), y)


def test_columns_are_drawn_at_the_same_samples():
    low, high = noise(1), 5.0 + noise(2)
    high[7_000:7_100] = np.nan  # a gap in one of them is a gap in both
    chosen = choose_samples(TIME, low, high)
    assert low.argmin() in chosen
    assert np.nanargmax(high) in chosen
    assert np.flatnonzero((chosen >= 7_000) & (chosen < 7_100)).size == 1
