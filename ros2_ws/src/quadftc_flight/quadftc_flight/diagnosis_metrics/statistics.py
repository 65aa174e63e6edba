"""Figures of samples: root mean square, median, and how many of them are independent. None: no sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CONFIDENCE = 0.95  # probability that the band holds the statistic of a consistent estimate


def number(value: Any) -> float | None:
    """Return a number that JSON can hold; None for NaN and infinity."""
    return None if value is None or not np.isfinite(value) else float(value)


def finite(values: Floats) -> Floats:
    """Return those that are finite."""
    return values[np.isfinite(values)]


def rms(values: Floats) -> float | None:
    """Root mean square of the finite values."""
    known = finite(values)
    return number(np.sqrt(np.mean(known * known))) if len(known) else None


def largest(values: Floats) -> float | None:
    """Largest size of the finite values."""
    known = finite(values)
    return number(np.max(np.abs(known))) if len(known) else None


def mean(values: Floats) -> float | None:
    """Mean of the finite values."""
    known = finite(values)
    return number(np.mean(known)) if len(known) else None


def median(values: Sequence[float]) -> float | None:
    """Median."""
    return number(np.median(values)) if len(values) else None


def percentile_95(values: Sequence[float]) -> float | None:
    """95th percentile, interpolated."""
    return number(np.percentile(values, 95.0)) if len(values) else None


def independent_samples(normalised: Floats) -> float:
    r"""Return the number nu of independent samples that tell as much about a mean square as these (n,).

        nu = n / (1 + 2 sum_k (1 - k/n) rho_k^2),    k = 1, 2, ... until rho_k <= 0

    with rho_k the autocorrelation about zero (a consistent error has mean zero). The mean square of a
    Gaussian sequence has the variance 2 sigma^4 / nu (Bayley and Hammersley 1946). White noise has nu = n, an
    error that stays the same nu = 1.
    """
    count = len(normalised)
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(normalised, size)
    covariance = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, size)[:count]
    if covariance[0] <= 0.0:
        return float(count)
    rho = covariance[1:] / covariance[0]  # times (1 - k/n), as the sum has n - k terms
    negative = np.flatnonzero(rho <= 0.0)
    rho = rho[: int(negative[0])] if len(negative) else rho
    weights = 1.0 - np.arange(1, len(rho) + 1) / count
    return float(count / (1.0 + 2.0 * np.sum(rho**2 / weights)))


def consistency_band(samples: float) -> tuple[float, float]:
    """Return where a mean of squares of so many independent standard normal samples is in 95 % of all cases.

    Quantiles of the chi-square distribution with that many degrees of freedom, over their number.
    """
    from scipy.special import gammaincinv  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (2.0 * float(gammaincinv(0.5 * samples, p)) / samples for p in (tail, 1.0 - tail))
    return low, high
