"""Numbers in the tables of the studies: three digits, with the unit; `NOTHING` where one is not known.

And exact 95 % intervals of counts.
"""

from __future__ import annotations

from scipy.stats import binomtest, chi2  # type: ignore[import-untyped]

from quadftc_tools.study.page import NOTHING

Values = tuple[float | None, ...]

_DIGITS = 3  # significant


def write_numbers(values: Values) -> str:
    """Write numbers, without a unit."""
    return "/".join(map(write_number, values))


def write_count(values: Values) -> str:
    """Write whole numbers."""
    return "/".join(NOTHING if value is None else f"{value:.0f}" for value in values)


def write_degrees(values: Values) -> str:
    """Write angles [deg]."""
    return NOTHING if None in values else f"{write_numbers(values)} deg"


def write_per_cent(values: Values) -> str:
    """Write shares as per cent."""
    return "/".join(NOTHING if value is None else f"{write_number(100.0 * value)} %" for value in values)


def write_times(values: Values) -> str:
    """Write times [s], short ones in milliseconds."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return NOTHING
    if max(known) >= 1.0:
        return f"{write_numbers(values)} s"
    return f"{'/'.join(write_number(1e3 * value) for value in known)} ms"


def write_number(value: float | None) -> str:
    """Write a number."""
    if value is None:
        return NOTHING
    return f"{value:.0f}" if abs(value) >= 10.0**_DIGITS else f"{value:.{_DIGITS}g}"


def write_share(hits: int, count: int, decimals: int = 0) -> str:
    """Write a share as per cent, with its exact interval."""
    low, high = (100.0 * bound for bound in share_interval(hits, count))
    return f"{100.0 * hits / count:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """Interval of a probability by ``hits`` of ``count`` (Clopper and Pearson, 1934)."""
    found = binomtest(hits, count).proportion_ci()
    return float(found.low), float(found.high)


def poisson_interval(count: int) -> tuple[float, float]:
    """Interval of the mean of a Poisson distribution of which ``count`` were seen (Garwood, 1936)."""
    low = float(chi2.ppf(0.025, 2 * count)) / 2.0 if count else 0.0
    return low, float(chi2.ppf(0.975, 2 * count + 2)) / 2.0
