"""A flight as its diagnosis sees it, columns of three axes in degrees and seconds; and figures of samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadftc_flight.flight import NO_STATE, Flight
from quadftc_model.rotations import wrap
from quadftc_model.samples import FAULTY, HEALTHY, RECOVERING, SUSPECT
from quadftc_model.stepper import NANOSECONDS_PER_SECOND

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Figure = Callable[[ArrayLike], float | None]  # of samples; None: no sample is finite
Record = dict[str, float | str | bool | None]  # of one fault: when and where it was, and how it was judged
PerAxis = dict[str, float | None]  # figures by the name of an axis
Metrics = dict[str, Any]  # as in summary.json: figures by name, and mappings and lists of them

CONFIDENCE = 0.95  # probability that the band holds the statistic of a consistent estimate


class Columns:
    """Columns of a flight; NaN where a number is not known."""

    def __init__(self, flight: Flight) -> None:
        state, std_dev = flight.fault_state, np.degrees(flight.fault_std_dev)
        gaps_ns, first_ns = np.diff(flight.stamp_ns), flight.stamp_ns[0] if len(flight) else 0
        self.time: Float[Floats, " n"] = flight.time  # scenario time [s]
        # what a row stands for: the median time between two [s]; NaN of less than two rows
        self.period = float(np.median(gaps_ns)) / NANOSECONDS_PER_SECOND if len(gaps_ns) else np.nan
        # the states: whether there is one, whether it says faulty, whether the sensor is believed
        self.known: Bool[Mask, "n 3"] = state != NO_STATE
        self.declared: Bool[Mask, "n 3"] = (state == FAULTY) | (state == RECOVERING)
        self.trusted: Bool[Mask, "n 3"] = (state == HEALTHY) | (state == SUSPECT)
        # true and estimated fault [deg], and what is between them, over the std dev of the observer, too [1]
        self.fault: Float[Floats, "n 3"] = np.degrees(flight.fault)
        self.estimate: Float[Floats, "n 3"] = np.degrees(flight.fault_estimate)
        self.error: Float[Floats, "n 3"] = np.degrees(wrap(flight.fault_estimate - flight.fault))
        given = std_dev > 0.0  # false for NaN, too
        self.normalised: Float[Floats, "n 3"] = np.where(
            given, self.error / np.where(given, std_dev, 1.0), np.nan
        )
        # true angle less reference [deg]
        self.tracking: Float[Floats, "n 3"] = np.degrees(wrap(flight.angles - flight.reference))
        # when the present fault began, as the observer says [s]; NaN: it reports none
        self.onset: Float[Floats, "n 3"] = np.where(
            flight.fault_onset_ns > 0, (flight.fault_onset_ns - first_ns) / NANOSECONDS_PER_SECOND, np.nan
        )

    def rows(self, start: float, stop: float) -> slice:
        """Return the rows with start <= time < stop."""
        first, last = np.searchsorted(self.time, (start, stop), side="left").tolist()
        return slice(first, max(first, last))


def number(value: float | np.floating | None) -> float | None:
    """Return a number that JSON can hold; None for NaN and infinity."""
    return None if value is None or not np.isfinite(value) else float(value)


def finite(values: Floats) -> Floats:
    """Return those that are finite."""
    return values[np.isfinite(values)]


def _figure(compute: Callable[[Floats], float | np.floating]) -> Figure:
    """Return a figure of the finite samples."""

    def figure(values: ArrayLike) -> float | None:
        known = finite(np.asarray(values, np.float64))
        return number(compute(known)) if len(known) else None

    return figure


rms = _figure(lambda values: np.sqrt(np.mean(values * values)))
largest = _figure(lambda values: np.max(np.abs(values)))
mean = _figure(np.mean)
median = _figure(np.median)
median_size = _figure(lambda values: np.median(np.abs(values)))
percentile_95 = _figure(lambda values: np.percentile(values, 95.0))  # interpolated


def independent_samples(normalised: Float[Floats, " n"]) -> float:
    r"""Return the number nu of independent samples that tell as much about a mean square as these.

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
