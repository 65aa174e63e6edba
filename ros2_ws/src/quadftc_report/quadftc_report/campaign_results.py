"""What each variant of a campaign gave, flight by flight and fault by fault."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.table import whole_flights
from quadftc_flight.summary import NO_OBSERVER, Summary
from quadftc_model.samples import AXES

Floats = NDArray[np.float64]
HOUR = 3600.0  # s


@dataclasses.dataclass(frozen=True, eq=False)
class Side:
    """The results of one variant."""

    name: str
    rows: pl.DataFrame  # of the table
    summary: Summary  # its part
    has_observer: bool  # whether any of its flights estimates sensor faults
    role: str  # look of its lines (`quadftc_report.style.line_style`)
    rank: int

    @functools.cached_property
    def flights(self) -> pl.DataFrame:
        """One row for each flight."""
        return whole_flights(self.rows)

    @functools.cached_property
    def faults(self) -> pl.DataFrame:
        """One row for each fault."""
        return self.rows.filter(pl.col("fault").is_not_null())

    @property
    def parts(self) -> str:
        """Its fault observer, disturbance observer and controller."""
        keys = ("observer", "disturbance_observer", "controller")
        given = [self.rows[key].drop_nulls() for key in keys if key in self.rows.columns]
        return ", ".join(str(names[0]) for names in given if len(names))

    @functools.cached_property
    def worst_tracking(self) -> Floats:
        """Tracking RMSE of the worst axis of each flight [deg]; infinite if it did not stay finite."""
        worst = np.fmax.reduce(self.by_axis("tracking_rmse_deg").reshape(len(AXES), -1))
        return np.where(_stayed_finite(self.flights), worst, np.inf)

    @functools.cached_property
    def estimate_errors(self) -> Floats:
        """RMSE of the estimate of each fault [deg]; infinite if the flight did not stay finite."""
        errors = numbers(self.faults, "fault.estimate_rmse_deg")
        return np.where(_stayed_finite(self.faults), errors, np.inf)

    @functools.cached_property
    def detection_delays(self) -> Floats:
        """Delay of each fault that a detector can find [s]; infinite if it was not found after its onset."""
        found = numbers(self.faults, "fault.detected")
        delays = numbers(self.faults, "fault.detection_delay_s")[~np.isnan(found)]
        return np.where(np.isnan(delays), np.inf, delays)

    def by_axis(self, name: str, axes: Sequence[str] = AXES) -> Floats:
        """Return a column of each axis of all flights, axis after axis."""
        return np.concatenate([numbers(self.flights, f"{name}.{axis}") for axis in axes])

    def alarms_per_hour(self, axes: Sequence[str] = AXES) -> float | None:
        """Return the false alarms in an hour of a healthy axis [1/h]; None: no axis was healthy."""
        hours = np.nansum(self.by_axis("healthy_time_s", axes)) / HOUR
        return float(np.nansum(self.by_axis("false_alarms", axes)) / hours) if hours > 0.0 else None


class Results(NamedTuple):
    """The results of all variants, in the order of the campaign."""

    campaign: Campaign
    frame: pl.DataFrame
    sides: tuple[Side, ...]
    checks: Mapping[str, Sequence[Mapping[str, object]]]  # what became of them, by variant

    @property
    def kinds(self) -> list[str]:
        """Kinds of fault that were flown, then ``all`` of them; empty: no flight had a fault."""
        found = {kind for side in self.sides for kind in side.summary["faults"]}
        return [*sorted(found - {"all"}), *(["all"] if found else [])]


def results_of(campaign: Campaign, frame: pl.DataFrame, summary: Summary) -> Results:
    """Divide the table of a campaign among its variants."""
    sides: list[Side] = []
    for name in [variant.name for variant in campaign.variants]:
        rows = frame.filter(pl.col("variant") == name)
        observes = bool((rows["observer"] != NO_OBSERVER).any())
        first = observes and not any(side.role == "proposed" for side in sides)
        look = ("proposed", 0) if first else ("compared", sum(side.role == "compared" for side in sides))
        sides.append(Side(name, rows, summary["variants"][name], observes, *look))
    checks: dict[str, list[Mapping[str, object]]] = {}
    for check in summary.get("checks", ()):
        checks.setdefault(check["variant"], []).append(check)
    return Results(campaign, frame, tuple(sides), checks)


def numbers(frame: pl.DataFrame, name: str) -> Floats:
    """Return a column as numbers (n,); NaN where there is no value, or no such column."""
    if name not in frame.columns:
        return np.full(frame.height, np.nan)
    return np.array(frame[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy(), np.float64)


def known(values: Floats) -> Floats:
    """Return the values that are finite."""
    return values[np.isfinite(values)]


def _stayed_finite(rows: pl.DataFrame) -> NDArray[np.bool_]:
    return np.array(rows["finite"].fill_null(False).to_numpy(), np.bool_)
