"""The flights worth another look: the worst of each variant, and how to fly them again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_model.samples import AXES
from quadftc_report.campaign.flown_words import unit, value_text
from quadftc_report.campaign.results import Results, Side, numbers
from quadftc_report.templating import NOTHING
from quadftc_report.wording import period, short

Floats = NDArray[np.float64]

LISTED = 5  # of each variant
NOT_FINITE = "not finite"


class Worst(NamedTuple):
    """A flight among the worst."""

    flight: int
    where: str  # the axis, or the fault
    value: str  # [deg]
    drawn: tuple[str, ...]  # as `drawn_headings`
    command: str  # that flies it again


class Ranking(NamedTuple):
    """The worst flights by one measure."""

    key: str
    title: str
    where: str  # heading
    measure: str  # heading, with its unit
    groups: tuple[tuple[str, tuple[Worst, ...]], ...]  # by variant


def rankings(results: Results, directory: Path, command_file: str) -> list[Ranking]:
    """Return the worst flights by tracking, and by the estimate of a fault where there is one."""
    again = _Again(results.campaign, directory, command_file)
    tracking = tuple((side.name, tuple(_by_tracking(side, again))) for side in results.sides)
    estimates = tuple((side.name, tuple(_by_estimate(side, again))) for side in results.with_observer)
    found = [
        Ranking("tracking", "Largest tracking errors", "worst axis", "tracking RMSE [deg]", tracking),
        Ranking("estimate", "Worst fault estimates", "fault", "RMSE of the estimate [deg]", estimates),
    ]
    return [each for each in found if any(lines for _, lines in each.groups)]


def drawn_headings(campaign: Campaign) -> list[str]:
    """Return the paths of the values drawn, with their units."""
    units = {path: unit(drawn) for path, drawn in campaign.vary.items()}
    return [f"{path} [{its}]" if its else path for path, its in units.items()]


class _Again(NamedTuple):
    """What the command of a flight needs to know."""

    campaign: Campaign
    directory: Path
    file: str

    def command(self, flight: int, variant: str) -> str:
        words = ["scripts/quadftc", "campaign", self.file]
        if isinstance(self.campaign.document.origins.get(("flights",)), str):  # not the file's number
            words += ["--flights", str(self.campaign.flights)]
        words += ["--out", str(self.directory), "--flight", str(flight), "--variant", variant]
        return shlex.join(words)

    def worst(self, side: Side, row: Mapping[str, Any], where: str, value: float) -> Worst:
        drawn = (row.get(path) for path in self.campaign.vary)
        return Worst(
            row["flight"],
            where,
            NOT_FINITE if np.isinf(value) else short(value),
            tuple(NOTHING if each is None else value_text(each) for each in drawn),
            self.command(row["flight"], side.name),
        )


def _by_tracking(side: Side, again: _Again) -> list[Worst]:
    values = side.worst_tracking
    found: list[Worst] = []
    for place, row in _rows(side.flights, values):
        axes = {axis: row.get(f"tracking_rmse_deg.{axis}") for axis in AXES}
        known = {axis: value for axis, value in axes.items() if value is not None and np.isfinite(value)}
        axis = NOTHING if np.isinf(values[place]) else max(known, key=lambda name: known[name])
        found.append(again.worst(side, row, axis, float(values[place])))
    return found


def _by_estimate(side: Side, again: _Again) -> list[Worst]:
    """Faults of flights that did not stay finite are left out: those are among the worst in tracking."""
    values = numbers(side.faults, "fault.estimate_rmse_deg")
    values[np.isinf(side.estimate_errors)] = np.nan
    return [
        again.worst(side, row, _fault_text(row), float(values[place]))
        for place, row in _rows(side.faults, values)
    ]


def _rows(frame: pl.DataFrame, values: Floats) -> list[tuple[int, Mapping[str, Any]]]:
    """The rows with the largest values, the largest first; of equal ones the first."""
    order = np.argsort(-values, kind="stable")  # NaN last
    chosen: Sequence[int] = [int(place) for place in order[:LISTED] if not np.isnan(values[place])]
    return [(place, frame.row(place, named=True)) for place in chosen]


def _fault_text(row: Mapping[str, Any]) -> str:
    when = period(row["fault.start"], row["fault.stop"]).removeprefix("from ")
    return f"{row['fault.kind']} on {row['fault.axis']}, {when}"
