"""Gains that are tuned, how metrics of flights change with their logarithms, and the cost made of metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.engine import Progress
from quadftc_campaign.batch.records import ROOTS, metric_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.flights import batch_flight, flight_scenario
from quadftc_flight.scenario import ROLES, Part, Problem, Scheme
from quadftc_model.arrays import AnyArray
from quadftc_model.numbers import numbers_of
from quadftc_model.parameters import parameters_of

if TYPE_CHECKING:
    from quadftc_campaign.batch.slope import Sloped

Floats = NDArray[np.float64]

DIFFERENCE = 1e-5  # of a logarithm, between two builds
DIGITS = 4  # significant, of gains that are given out


class Gains(NamedTuple):
    """Gains by name."""

    names: tuple[str, ...]  # ``role.parameter``, such as ``controller.k_c1``
    values: tuple[Floats, ...]  # each () or (n,), positive

    @property
    def logarithms(self) -> Floats:
        """All of them in one vector (n,)."""
        return np.concatenate([np.log(np.atleast_1d(value)) for value in self.values])

    def at(self, logarithms: Floats) -> Gains:
        """Return the same gains with other values."""
        ends = np.cumsum([value.size for value in self.values])[:-1]
        pieces = zip(np.split(logarithms, ends), self.values, strict=True)
        return self._replace(values=tuple(np.exp(piece).reshape(value.shape) for piece, value in pieces))

    def rounded(self) -> Gains:
        """Round to a few significant digits, as people write them."""

        def short(numbers: Floats) -> Floats:
            return np.array([float(f"{each:.{DIGITS}g}") for each in numbers.flat]).reshape(numbers.shape)

        return self._replace(values=tuple(map(short, self.values)))

    def plain(self) -> dict[str, float | list[float]]:
        """Return numbers and lists, by name."""
        return {name: value.tolist() for name, value in zip(self.names, self.values, strict=True)}


class Sensitivity(NamedTuple):
    """Metrics of some flights, and how gains change them."""

    values: Floats  # (flights, metrics, 3)
    slopes: Floats  # (flights, gains, metrics, 3), by the logarithm of a gain


def gains_of(campaign: Campaign, scheme: Scheme, names: Sequence[str]) -> Gains:
    """Return the gains of a scheme as they are; `ScenarioError` if one is missing or cannot be tuned."""
    values: list[Floats] = []
    problems: list[Problem] = []
    for index, name in enumerate(names):
        try:
            values.append(_value(scheme, name))
        except ValueError as error:
            problems.append(Problem(("tune", "gains", index), str(error)))
        if name in names[:index]:
            problems.append(Problem(("tune", "gains", index), f"'{name}' is given twice"))
    if problems:
        raise campaign.document.error(problems)
    return Gains(tuple(names), tuple(values))


def with_gains(campaign: Campaign, scheme: str, gains: Gains) -> Campaign:
    """Return the campaign with these gains."""
    values = {f"schemes.{scheme}.{name}": value for name, value in gains.plain().items()}
    return campaign.model_copy(update={"base": campaign.base.with_values(values, "tuned")})


def directions(campaign: Campaign, variant: Variant, gains: Gains, number: int) -> dict[str, Floats]:
    """Return how the numbers of a flight's laws (`numbers_of`) change by the logarithm of each gain.

    By the path of a number: (gains, ...). The laws are built by their own code, from gains a little larger
    and smaller. So what a law computes of its gains counts, too.
    """

    def build(logarithms: Floats) -> dict[str, AnyArray]:
        tried = with_gains(campaign, variant.scheme, gains.at(logarithms))
        return numbers_of(batch_flight(flight_scenario(tried, number, variant)).loop)

    middle = gains.logarithms
    steps = DIFFERENCE * np.eye(len(middle))
    pairs = [(build(middle - step), build(middle + step)) for step in steps]
    paths = [path for path in pairs[0][0] if any(np.any(low[path] != high[path]) for low, high in pairs)]
    return {
        path: np.stack([high[path] - low[path] for low, high in pairs]) / (2.0 * DIFFERENCE) for path in paths
    }


def sensitivity(
    campaign: Campaign, gains: Gains, metrics: Sequence[str], numbers: Sequence[int], progress: Progress
) -> Sensitivity:
    """Fly some flights of a campaign that has these gains, with their slopes; metrics: `COSTS`."""
    from quadftc_campaign.batch.slope import fly_with_slopes

    variant = campaign.variants[0]
    flights = [batch_flight(flight_scenario(campaign, number, variant)) for number in numbers]
    flown = fly_with_slopes(flights, directions(campaign, variant, gains, numbers[0]), progress)
    values = [[metric_of(name, each.outcome) for name in metrics] for each in flown]
    slopes = [[_slopes_of_metric(name, each) for name in metrics] for each in flown]
    return Sensitivity(np.array(values), np.moveaxis(np.array(slopes), 2, 1))


def mean_cost(shares: Floats, values: Floats) -> float:
    """Return the mean cost of flights (flights, metrics, 3), with the shares of `shares_of_cost`."""
    terms: Floats = np.where(shares > 0.0, values * shares, 0.0)
    return float(terms.sum()) / len(terms)


def shares_of_cost(weights: Mapping[str, float], values: Floats) -> Floats:
    """Return the cost (metrics, 3) of a unit of each metric on each axis; 0: it does not count.

    The cost of flights (flights, metrics, 3) with these values is 1; `ValueError` if all metrics are 0.
    """
    scale = np.asarray(np.mean(values, axis=0))
    counts = scale > 0.0  # not an axis on which a metric is 0 or has no value
    if not np.any(counts):
        raise ValueError(f"every metric is 0 from the start: {', '.join(weights)}")
    each: Floats = np.array([*weights.values()], np.float64)
    shares = each[:, None] * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return shares / shares.sum() / np.where(counts, scale, 1.0)


def _slopes_of_metric(name: str, flown: Sloped) -> Floats:
    """Return the slopes (gains, 3) of a metric, from those of the sums; 0 where it is 0 or has no value."""
    outcome, slopes = flown
    if name not in ROOTS:
        return np.asarray(slopes["variation"] / outcome.span)
    squares, count = ROOTS[name]
    value, scale = metric_of(name, outcome), float(np.degrees(1.0)) if name.endswith("_deg") else 1.0
    change = slopes[squares] / np.maximum(outcome.sums[count], 1)
    return np.where(value > 0.0, scale**2 * change / (2.0 * np.where(value > 0.0, value, 1.0)), 0.0)


def _value(scheme: Scheme, name: str) -> Floats:
    role, _, parameter = name.partition(".")
    if role not in ROLES or not parameter:
        roles = ", ".join(ROLES)
        raise ValueError(f"'{name}': expected role.parameter, such as controller.k_c1; roles: {roles}")
    part: Part = getattr(scheme, role)
    specs = parameters_of(part.law.__class__)
    numbers = [spec.name for spec in specs if isinstance(spec.default, (float, tuple))]
    if parameter not in numbers:
        there = ", ".join(numbers) or "none"
        raise ValueError(f"'{name}': {part.kind} has no such number; there are: {there}")
    value = np.asarray(getattr(part.law, parameter), np.float64)
    if not np.all((value > 0.0) & np.isfinite(value)):
        raise ValueError(f"'{name}' = {value.tolist()}: must be positive to be tuned")
    return value
