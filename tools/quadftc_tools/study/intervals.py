"""Exact intervals of counts, at 95 %."""

from __future__ import annotations

from scipy.stats import beta, chi2  # type: ignore[import-untyped]

TAIL = 0.025


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """Interval of a probability by ``hits`` of ``count`` (Clopper and Pearson, 1934)."""
    low = float(beta.ppf(TAIL, hits, count - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - TAIL, hits + 1, count - hits)) if hits < count else 1.0
    return low, high


def poisson_interval(count: int) -> tuple[float, float]:
    """Interval of the mean of a Poisson distribution of which ``count`` were seen (Garwood, 1936)."""
    low = float(chi2.ppf(TAIL, 2 * count)) / 2.0 if count else 0.0
    return low, float(chi2.ppf(1.0 - TAIL, 2 * count + 2)) / 2.0
