"""Empirical distribution: which share of all is at most so much."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

EVEN, TAIL = 400, 100  # points of a curve: all along, and besides towards the largest values


class Ecdf(NamedTuple):
    """A distribution; each array (m,), rising."""

    values: Floats
    shares: Floats  # of all, that are at most the value
    total: int  # how many are all

    @property
    def final(self) -> float:
        """The share that has a finite value."""
        return float(self.shares[-1]) if len(self.shares) else 0.0


def ecdf(values: Floats) -> Ecdf:
    """Return the distribution of values (n,).

    Parameters
    ----------
    values : array (n,)
        NaN is left out. Infinite is what no value was large enough for, such as the delay of a fault that was
        never found: it belongs to all, and the curve ends below 1.

    Returns
    -------
    Ecdf
        At most ``EVEN + TAIL`` points of it, the smallest and the largest among them.
    """
    given = values[~np.isnan(values)]
    ordered = np.sort(given[np.isfinite(given)])
    ranks = _ranks(len(ordered))
    return Ecdf(ordered[ranks], (ranks + 1) / max(len(given), 1), len(given))


def _ranks(count: int) -> NDArray[np.intp]:
    """Which of so many ordered values are drawn."""
    if count <= EVEN + TAIL:
        return np.arange(count)
    even = np.linspace(0, count - 1, EVEN)
    tail = count - np.geomspace(1, count / EVEN, TAIL)
    return np.unique(np.rint(np.concatenate([even, tail])).astype(np.intp))
