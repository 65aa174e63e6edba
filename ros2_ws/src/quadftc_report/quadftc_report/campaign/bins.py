"""The axis of a map: a varied value in bins, each value of a list its own, a continuous one in quantiles."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.distributions import Distribution, plain, unit_of
from quadftc_report.campaign.results import numbers
from quadftc_report.wording import plain as digits

Bins = NDArray[np.intp]

MOST = 8  # bins of a continuous value
FEW = 5  # bins of which every edge is written
MANY = 12  # values of a list that are all written
WANTED = 8  # flights in a cell, on average


class BinAxis(NamedTuple):
    """How a varied value is divided."""

    path: str
    unit: str
    names: tuple[str, ...]  # of each bin
    ticks: tuple[tuple[float, str], ...]  # where to write what; bin k reaches from k - 1/2 to k + 1/2
    continuous: bool
    bins: Bins  # (rows,) bin of each row of the table; -1: none


def can_be_divided(drawn: Distribution) -> bool:
    """Whether a value is one of a list or a single number."""
    return drawn.size == 0


def bins_for(flights: int, both: tuple[Distribution, Distribution]) -> int:
    """Into how many bins a continuous value is divided, so that a cell holds a few flights on average."""
    listed = [len(each.values) for each in both if each.values]
    continuous = len(both) - len(listed)
    cells = flights / (WANTED * float(np.prod(listed, initial=1.0)))
    return int(np.clip(np.floor(cells ** (1.0 / max(continuous, 1))), 2, MOST))


def bin_axis(frame: pl.DataFrame, path: str, drawn: Distribution, most: int) -> BinAxis:
    """Divide a varied value.

    Parameters
    ----------
    frame : polars.DataFrame
        The table of the campaign.
    path : str
        Of the value.
    drawn : Distribution
        What it was drawn from.
    most : int
        Bins of a continuous value.
    """
    if drawn.values:
        return _listed(frame, path, drawn)
    values = numbers(frame, path)
    known = values[np.isfinite(values)]
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, most + 1))) if len(known) else np.zeros(1)
    if len(edges) == 1:
        edges = np.array([edges[0], edges[0]])
    texts = [digits(edge) for edge in edges.tolist()]
    names = tuple(f"{low} to {high}" for low, high in itertools.pairwise(texts))
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(names) - 1)
    every = 2 if len(names) > FEW and len(names) % 2 == 0 else 1
    ticks = tuple((index - 0.5, text) for index, text in enumerate(texts))[::every]
    bins = np.where(np.isfinite(values), bins, -1).astype(np.intp)
    return BinAxis(path, drawn.unit, names, ticks, True, bins)


def _listed(frame: pl.DataFrame, path: str, drawn: Distribution) -> BinAxis:
    """One bin for each value; numbers in their order."""
    given = {_key(plain(value)): value for value in drawn.values}
    keys = sorted(given) if all(isinstance(key, float) for key in given) else list(given)
    units = {unit_of(value) for value in drawn.values}
    unit = units.pop() if len(units) == 1 else ""
    names = tuple(_name(given[key], unit) for key in keys)
    place = {key: index for index, key in enumerate(keys)}
    there: list[Any] = frame[path].to_list() if path in frame.columns else [None] * frame.height
    bins = np.array([place.get(_key(value), -1) for value in there], np.intp)
    ticks = tuple((float(index), name) for index, name in enumerate(names))[:: -(-len(names) // MANY)]
    return BinAxis(path, unit, names, ticks, False, bins)


def _key(value: Any) -> float | str:
    """What values in the campaign file and in the table have in common."""
    if isinstance(value, bool):
        return str(value)
    return float(value) if isinstance(value, (int, float)) else str(value)


def _name(value: Any, unit: str) -> str:
    number = plain(value)
    if unit and isinstance(number, float):
        return digits(number)
    return str(value)
