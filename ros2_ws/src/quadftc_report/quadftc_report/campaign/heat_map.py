"""A metric over two varied values: its median in each cell of a map, and how many flights that is of."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.table import whole_flights
from quadftc_model.samples import AXES
from quadftc_report.campaign.bins import BinAxis, bin_axis, bins_for, can_be_divided
from quadftc_report.campaign.results import Results
from quadftc_report.metric_kinds import EVENT, Kind, kind_of

Floats = NDArray[np.float64]

FEWEST = 5  # flights in a cell that is shown
FAULT = "fault."  # how columns of faults begin
VALUE = "_value"


@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """The map of a variant; arrays (y, x)."""

    medians: Floats  # in the metric's unit; NaN: too few flights
    flights: NDArray[np.int64]
    rows: int  # faults or flights that are in the cells shown


@dataclasses.dataclass(frozen=True, eq=False)
class Maps:
    """The maps of all variants."""

    x: BinAxis
    y: BinAxis
    metric: str
    kind: Kind
    of_faults: bool
    worst_axis: bool  # whether the metric is of an axis, and that of the worst one is taken
    cells: Mapping[str, Cells]  # by variant

    @property
    def divided(self) -> bool:
        """Whether a range is divided."""
        return any(axis.continuous for axis in (self.x, self.y))

    @property
    def span(self) -> tuple[float, float] | None:
        """Smallest and largest median of all; None: no cell is shown."""
        every = np.concatenate([each.medians.ravel() for each in self.cells.values()])
        shown = every[np.isfinite(every)]
        return (float(shown.min()), float(shown.max())) if len(shown) else None


def mapped_paths(campaign: Campaign) -> tuple[str, ...]:
    """Return the two varied values that the map is over; fewer: there is no map."""
    able = [path for path, drawn in campaign.vary.items() if can_be_divided(drawn)]
    wanted = [path for path in campaign.map if path in able]
    return tuple(wanted if len(wanted) == 2 and wanted[0] != wanted[1] else able[:2])


def maps_of(results: Results) -> Maps | None:
    """Return the maps of a campaign; None if fewer than two values vary, or no column is the metric."""
    campaign, frame = results.campaign, results.frame
    paths = mapped_paths(campaign)
    columns = metric_columns(frame, campaign.metric)
    if len(paths) < 2 or not columns:
        return None
    both = campaign.vary[paths[0]], campaign.vary[paths[1]]
    most = bins_for(frame["flight"].n_unique(), both)
    x, y = (bin_axis(frame, path, drawn, most) for path, drawn in zip(paths, both, strict=True))
    of_faults = campaign.metric.startswith(FAULT)
    kind = kind_of(f"{EVENT}0.{campaign.metric.removeprefix(FAULT)}" if of_faults else campaign.metric, ())
    values = frame.select(
        "flight",
        "variant",
        (kind.scale * pl.max_horizontal(pl.col(columns).cast(pl.Float64).fill_nan(None))).alias(VALUE),
        x=pl.Series(x.bins),
        y=pl.Series(y.bins),
    )
    values = values if of_faults else whole_flights(values)
    values = values.filter(pl.col(VALUE).is_finite(), pl.col("x") >= 0, pl.col("y") >= 0)
    shape = len(y.names), len(x.names)
    cells = {
        side.name: _cells(values.filter(pl.col("variant") == side.name), shape) for side in results.sides
    }
    return Maps(x, y, campaign.metric, kind, of_faults, len(columns) > 1, cells)


def metric_columns(frame: pl.DataFrame, metric: str) -> list[str]:
    """Return the column of a metric, or those of its axes; none: there are no such numbers."""
    wanted = [metric] if metric in frame.columns else [f"{metric}.{axis}" for axis in AXES]
    return [name for name in wanted if name in frame.columns and frame.schema[name].is_numeric()]


def _cells(values: pl.DataFrame, shape: tuple[int, int]) -> Cells:
    found = values.group_by("y", "x").agg(
        pl.col(VALUE).median(), pl.col("flight").n_unique().alias("flights"), pl.len().alias("rows")
    )
    medians, flights = np.full(shape, np.nan), np.zeros(shape, np.int64)
    place = found["y"].to_numpy(), found["x"].to_numpy()
    medians[place], flights[place] = found[VALUE].to_numpy(), found["flights"].to_numpy()
    medians[flights < FEWEST] = np.nan
    rows = found.filter(pl.col("flights") >= FEWEST)["rows"].sum()
    return Cells(medians, flights, int(rows))
