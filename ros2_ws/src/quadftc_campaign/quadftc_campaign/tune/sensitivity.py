"""Gains that are tuned, and how the metrics of flights change with their logarithms."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.parts import numbers_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.flights import flight
from quadftc_campaign.tune.cost import slope_of_term, term
from quadftc_flight.scenario import ROLES, Part, Problem, Scheme
from quadftc_model.parameters import parameters_of

Floats = NDArray[np.float64]

DIFFERENCE = 1e-5  # of a logarithm, between two builds
DIGITS = 4  # significant, of gains that are given out
TOGETHER = 256  # lanes: flights times gains


class Gains(NamedTuple):
    """Gains by name.

    Parameters
    ----------
    names : tuple of str
        ``role.parameter``, such as ``controller.k_c1``.
    values : tuple of arrays
        Each () or (n,), positive.
    """

    names: tuple[str, ...]
    values: tuple[Floats, ...]

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
        return self._replace(values=tuple(_round(value) for value in self.values))

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
    return dataclasses.replace(campaign, base=campaign.base.with_values(values, "tuned"))


def directions(campaign: Campaign, variant: Variant, gains: Gains, number: int) -> list[Mapping[str, Floats]]:
    """Return how the numbers of a flight's parts change by the logarithm of each gain.

    The parts are built by their own code, from gains a little larger and smaller: that covers whatever a part
    computes of its gains when it is built.

    Returns
    -------
    list of mappings
        For each gain, by path as in `quadftc_campaign.batch.parts.numbers_of`; all have the same paths.
    """

    def build(logarithms: Floats) -> dict[str, Any]:
        tried = with_gains(campaign, variant.scheme, gains.at(logarithms))
        return numbers_of(flight(tried, number, variant).parts.loop)

    middle = gains.logarithms
    steps = DIFFERENCE * np.eye(len(middle))
    pairs = [(build(middle - step), build(middle + step)) for step in steps]
    paths = [path for path in pairs[0][0] if any(np.any(low[path] != high[path]) for low, high in pairs)]
    return [{path: (high[path] - low[path]) / (2.0 * DIFFERENCE) for path in paths} for low, high in pairs]


def sensitivity(
    campaign: Campaign,
    gains: Gains,
    metrics: Sequence[str],
    numbers: Sequence[int],
    progress: Callable[[int], None] = lambda samples: None,
) -> Sensitivity:
    """Fly some flights of a campaign with slopes, each once for each gain.

    Parameters
    ----------
    campaign : Campaign
        With these gains.
    gains : Gains
    metrics : sequence of str
        Of `quadftc_campaign.tune.cost.TERMS`.
    numbers : sequence of int
        Of the flights.
    progress : callable
        Called with the number of samples flown since the last call.
    """
    variant = campaign.variants[0]
    ways = directions(campaign, variant, gains, numbers[0])
    flights = [flight(campaign, number, variant) for number in numbers]
    flown = _engine(campaign.float32, tuple(ways[0])).slopes(
        [each.parts for each in flights for _ in ways],
        [each.events for each in flights for _ in ways],
        ways * len(flights),
        progress,
    )
    values = [[term(name, each.outcome) for name in metrics] for each in flown[:: len(ways)]]
    slopes = [[slope_of_term(name, each.outcome, each.slope) for name in metrics] for each in flown]
    shape = (len(flights), len(ways), len(metrics), 3)
    return Sensitivity(np.array(values), np.array(slopes).reshape(shape))


def flights_together(gains: Gains) -> int:
    """Return how many flights fill the lanes."""
    return max(TOGETHER // len(gains.logarithms), 1)


@functools.cache
def _engine(float32: bool, free: tuple[str, ...]) -> Any:
    from quadftc_campaign.batch.engine import LANES, Engine
    from quadftc_campaign.batch.jax_settings import keep_compiled

    keep_compiled()
    return Engine(float32, LANES, free)


def _round(values: Floats) -> Floats:
    numbers: list[float] = values.ravel().tolist()
    return np.array([float(f"{number:.{DIGITS}g}") for number in numbers]).reshape(values.shape)


def _value(scheme: Scheme, name: str) -> Floats:
    role, _, parameter = name.partition(".")
    if role not in ROLES or not parameter:
        raise ValueError(
            f"'{name}': expected role.parameter, such as controller.k_c1; roles: {', '.join(ROLES)}"
        )
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
