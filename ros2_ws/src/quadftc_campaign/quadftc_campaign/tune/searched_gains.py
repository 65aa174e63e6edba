"""The gains that are tuned: positive numbers of a scheme's parts, searched in their logarithms."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadftc_campaign.batch.parts import numbers_of
from quadftc_campaign.campaign_file import Campaign, Variant
from quadftc_campaign.flights import flight
from quadftc_flight.scenario import ROLES, Part, Problem, Scheme, with_values
from quadftc_model.parameters import parameters_of

Floats = NDArray[np.float64]

DIFFERENCE = 1e-5  # of a logarithm, between two builds
DIGITS = 4  # significant, of gains that are given out


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
        """The same gains with other values."""
        found: list[Floats] = []
        for value in self.values:
            found.append(np.exp(logarithms[: value.size]).reshape(value.shape))
            logarithms = logarithms[value.size :]
        return self._replace(values=tuple(found))

    def rounded(self) -> Gains:
        """With a few significant digits, as people write them."""
        return self._replace(values=tuple(_rounded(value) for value in self.values))

    def plain(self) -> dict[str, float | list[float]]:
        """As numbers and lists, by name."""
        return {name: value.tolist() for name, value in zip(self.names, self.values, strict=True)}


def gains_of(campaign: Campaign, scheme: Scheme, names: Sequence[str]) -> Gains:
    """The gains of a scheme as they are.

    Raises
    ------
    ScenarioError
        If one is not there, or is nothing that can be tuned.
    """
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
    """The campaign flown with these gains."""
    values = {f"schemes.{scheme}.{name}": value for name, value in gains.plain().items()}
    return dataclasses.replace(campaign, base=with_values(campaign.base, values, "tuned"))


def directions(campaign: Campaign, variant: Variant, gains: Gains, number: int) -> list[Mapping[str, Floats]]:
    """How the numbers of a flight's parts change by the logarithm of each gain.

    Parts are built by their own code, from gains a little larger and smaller: what a part computes of its
    gains when it is built, by whatever means, is followed.

    Returns
    -------
    list of mappings
        For each gain, by path as in `quadftc_campaign.batch.parts.numbers_of`; all of the same paths.
    """

    def built(logarithms: Floats) -> dict[str, Any]:
        tried = with_gains(campaign, variant.scheme, gains.at(logarithms))
        return numbers_of(flight(tried, number, variant).parts.loop)

    middle = gains.logarithms
    steps = DIFFERENCE * np.eye(len(middle))
    pairs = [(built(middle - step), built(middle + step)) for step in steps]
    paths = [path for path in pairs[0][0] if any(np.any(low[path] != high[path]) for low, high in pairs)]
    return [{path: (high[path] - low[path]) / (2.0 * DIFFERENCE) for path in paths} for low, high in pairs]


def _rounded(values: Floats) -> Floats:
    numbers: list[float] = values.ravel().tolist()
    return np.array([float(f"{number:.{DIGITS}g}") for number in numbers]).reshape(values.shape)


def _value(scheme: Scheme, name: str) -> Floats:
    role, _, parameter = name.partition(".")
    if role not in ROLES or not parameter:
        raise ValueError(
            f"'{name}': expected role.parameter, such as controller.k_c1; roles: {', '.join(ROLES)}"
        )
    part: Part = getattr(scheme, role)
    specs = {spec.name: spec for spec in parameters_of(part.law.__class__)}
    numbers = [key for key, spec in specs.items() if isinstance(spec.default, (float, tuple))]
    if parameter not in numbers:
        there = ", ".join(numbers) or "none"
        raise ValueError(f"'{name}': {part.kind} has no such number; there are: {there}")
    value = np.asarray(getattr(part.law, parameter), np.float64)
    if not np.all((value > 0.0) & np.isfinite(value)):
        raise ValueError(f"'{name}' = {value.tolist()}: must be positive to be tuned")
    return value
