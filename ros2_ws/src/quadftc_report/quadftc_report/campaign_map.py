# pyright: basic
"""A map of a campaign: the median of a metric over two varied values, variant by variant."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.distributions import Distribution, plain
from quadftc_campaign.table import whole_flights
from quadftc_model.samples import AXES
from quadftc_report.campaign_curves import RATIO, Picture, escape, log_ticks, variant_figure
from quadftc_report.campaign_results import Floats, Results, numbers
from quadftc_report.draw_plotly import Look, spec_of
from quadftc_report.metric_kinds import SCALES, Kind, describe
from quadftc_report.wording import plain as digits
from quadftc_report.wording import short

FEWEST = 5  # flights in a cell that is shown
MOST = 8  # bins of a continuous value
WANTED = 8  # flights in a cell, on average
FAULT = "fault."  # how columns of faults begin
# even steps, the same for colour-blind readers
LOOK = {"colorscale": "Cividis", "xgap": 1, "ygap": 1, "textfont": {"size": 10}, "hoverongaps": False}
MISSING = "#dcdcdc"  # of cells with too few flights
READABLE = 10  # columns of a map in which the numbers have room


class BinAxis(NamedTuple):
    """How a varied value is divided."""

    title: str
    names: tuple[str, ...]  # of each bin
    bins: NDArray[np.intp]  # (rows,) bin of each row of the table; -1: none


class Maps(NamedTuple):
    """The maps of all variants; arrays (y, x)."""

    x: BinAxis
    y: BinAxis
    kind: Kind  # of the metric
    medians: dict[str, Floats]  # by variant; in the metric's unit; NaN: too few flights
    flights: dict[str, NDArray[np.int64]]
    span: tuple[float, float]  # smallest and largest median of all


def draw_maps(results: Results) -> Iterator[Picture]:
    """Yield the figure with the maps of all variants, or one that says why there is none."""
    paths, metric = _mapped_paths(results.campaign), results.campaign.report.metric
    if len(paths) < 2:
        return
    if (maps := maps_of(results)) is None:
        yield Picture("map", "No map", f"No cell holds {FEWEST} flights with a '{metric}'.", {})
        return
    caption = (
        f"Median of the {maps.kind.heading} in each cell, of its worst axis where it has several. Cells with"
        f" fewer than {FEWEST} flights are grey. A range is divided into parts with as many flights each."
    )
    plots = {name: _spec(f"map-{index}", maps, name) for index, name in enumerate(maps.medians)}
    yield Picture("map", f"Over {paths[0]} and {paths[1]}", caption, plots)


def maps_of(results: Results) -> Maps | None:
    """Return the maps of a campaign; None if fewer than two values vary, or no cell has the metric."""
    campaign, frame = results.campaign, results.frame
    paths, metric = _mapped_paths(campaign), campaign.report.metric
    wanted = [metric] if metric in frame.columns else [f"{metric}.{axis}" for axis in AXES]
    columns = [name for name in wanted if name in frame.columns and frame.schema[name].is_numeric()]
    of_faults = metric.startswith(FAULT)
    if len(paths) < 2 or not columns:
        return None
    both = campaign.vary[paths[0]], campaign.vary[paths[1]]
    most = _bins_for(frame["flight"].n_unique(), both)
    x, y = (bin_axis(frame, path, drawn, most) for path, drawn in zip(paths, both, strict=True))
    kind = describe(metric.replace(FAULT, "diagnosis.events.0.", 1) if of_faults else metric)[1]
    largest = pl.max_horizontal(pl.col(columns).cast(pl.Float64).fill_nan(None))
    value = SCALES.get(kind.unit, 1.0) * largest
    values = frame.select("flight", "variant", value=value, x=pl.Series(x.bins), y=pl.Series(y.bins))
    values = values if of_faults else whole_flights(values)
    values = values.filter(pl.col("value").is_finite(), pl.col("x") >= 0, pl.col("y") >= 0)
    shape = len(y.names), len(x.names)
    medians = {side.name: np.full(shape, np.nan) for side in results.sides}
    flights = {side.name: np.zeros(shape, np.int64) for side in results.sides}
    cells = values.group_by("variant", "y", "x").agg(pl.col("value").median(), pl.col("flight").n_unique())
    for name, row, column, median, count in cells.rows():
        flights[name][row, column] = count
        medians[name][row, column] = median if count >= FEWEST else np.nan
    every = np.stack([*medians.values()])
    if np.isnan(every).all():
        return None
    return Maps(x, y, kind, medians, flights, (float(np.nanmin(every)), float(np.nanmax(every))))


def bin_axis(frame: pl.DataFrame, path: str, drawn: Distribution, most: int) -> BinAxis:
    """Divide a varied value: each value of a list its own bin, a continuous one in ``most`` quantiles."""
    if drawn.values:
        return _listed(frame, path, drawn)
    values = numbers(frame, path)
    known = values[np.isfinite(values)]
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, most + 1))) if len(known) else np.zeros(1)
    edges = np.repeat(edges, 2) if len(edges) == 1 else edges
    names = tuple(f"{low} to {high}" for low, high in itertools.pairwise(map(digits, edges.tolist())))
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(names) - 1)
    bins = np.where(np.isfinite(values), bins, -1).astype(np.intp)
    return BinAxis(f"{path} [{drawn.unit}]" if drawn.unit else path, names, bins)


def _listed(frame: pl.DataFrame, path: str, drawn: Distribution) -> BinAxis:
    """One bin for each value; numbers in their order."""
    names = {_key(plain(each)): str(plain(each) if isinstance(each, dict) else each) for each in drawn.values}
    keys = sorted(names) if all(isinstance(key, float) for key in names) else list(names)
    there: list[object] = frame[path].to_list() if path in frame.columns else [None] * frame.height
    bins = np.array([keys.index(key) if (key := _key(value)) in names else -1 for value in there], np.intp)
    return BinAxis(path, tuple(names[key] for key in keys), bins)


def _key(value: object) -> float | str:
    """A value as it compares between the campaign file and the table."""
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else str(value)


def _bins_for(flights: int, both: tuple[Distribution, Distribution]) -> int:
    """Into how many bins a continuous value is divided, so that a cell holds a few flights on average."""
    listed = [len(each.values) for each in both if each.values]
    cells = flights / (WANTED * math.prod(listed))
    return int(np.clip(np.floor(cells ** (1.0 / max(len(both) - len(listed), 1))), 2, MOST))


def _mapped_paths(campaign: Campaign) -> tuple[str, ...]:
    """The two varied values that the map is over; fewer: there is no map."""
    able = [path for path, drawn in campaign.vary.items() if drawn.size == 0]
    wanted = [path for path in campaign.report.map if path in able]
    return tuple(wanted if len(set(wanted)) == len(wanted) == 2 else able[:2])


def _spec(key: str, maps: Maps, variant: str) -> Look:
    """Draw the map of a variant, in the colours that hold for all variants."""
    medians, (low, high) = maps.medians[variant], maps.span
    bar: Look = {"title": {"text": f"median {maps.kind.heading}", "side": "right"}}
    shown, edges = medians, (low, high)
    if low > 0.0 and high > RATIO * low:
        shown, edges = np.log10(np.maximum(shown, low)), (np.log10(low), np.log10(high))
        ticks = log_ticks(low, high)
        bar |= {**ticks, "tickvals": np.log10(ticks["tickvals"]).tolist()}
    x, y = ([escape(name) for name in axis.names] for axis in (maps.x, maps.y))
    hover = [
        [f"{column}<br>{row}<br>{count} flights" for column, count in zip(x, counts, strict=True)]
        for row, counts in zip(y, maps.flights[variant].tolist(), strict=True)
    ]
    drawing = variant_figure(0, (maps.x.title, maps.y.title))
    drawing.update_layout(
        xaxis={"tickvals": [*range(len(x))], "ticktext": x, "showgrid": False},
        yaxis={"tickvals": [*range(len(y))], "ticktext": y, "showgrid": False, "automargin": True},
        plot_bgcolor=MISSING,
        margin={"t": 16, "r": 8},
    )
    drawing.add_heatmap(
        z=[[None if np.isnan(value) else value for value in row] for row in shown.tolist()],
        zmin=edges[0],
        zmax=edges[1] if edges[1] > edges[0] else edges[0] + 1.0,
        text=[["" if np.isnan(value) else short(value) for value in row] for row in medians.tolist()],
        texttemplate="%{text}" if len(x) <= READABLE else "",
        customdata=hover,
        hovertemplate=f"%{{customdata}}<br>median %{{text}} {maps.kind.unit}<extra></extra>",
        colorbar={**bar, "thickness": 14, "outlinewidth": 0},
        **LOOK,
    )
    return spec_of(drawing, key)
