# pyright: basic
"""A map of a campaign: the median of a metric over two varied values, variant by variant."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.distributions import Distribution, plain, unit_of
from quadftc_campaign.table import whole_flights
from quadftc_model.samples import AXES
from quadftc_report.campaign_curves import (
    RATIO,
    Picture,
    Scale,
    counts_text,
    escaped,
    log_ticks,
    variant_figure,
)
from quadftc_report.campaign_results import Floats, Results, numbers
from quadftc_report.draw_plotly import spec_of
from quadftc_report.metric_kinds import EVENT, Kind, kind_of
from quadftc_report.wording import plain as digits
from quadftc_report.wording import sentence, short

FEWEST = 5  # flights in a cell that is shown
MOST = 8  # bins of a continuous value
WANTED = 8  # flights in a cell, on average
FEW = 5  # bins of which every edge is written
MANY = 12  # values of a list that are all written
FAULT = "fault."  # how columns of faults begin
COLOURS = "Cividis"  # even steps, the same for colour-blind readers
MISSING = "#dcdcdc"  # of cells with too few flights
READABLE = 10  # columns of a map in which the numbers have room


class BinAxis(NamedTuple):
    """How a varied value is divided; bin k reaches from k - 1/2 to k + 1/2."""

    path: str
    unit: str
    names: tuple[str, ...]  # of each bin
    ticks: tuple[tuple[float, str], ...]  # places and texts
    continuous: bool
    bins: NDArray[np.intp]  # (rows,) bin of each row of the table; -1: none


class Cells(NamedTuple):
    """The map of a variant; arrays (y, x)."""

    medians: Floats  # in the metric's unit; NaN: too few flights
    flights: NDArray[np.int64]
    rows: int  # faults or flights that are in the cells shown


class Maps(NamedTuple):
    """The maps of all variants."""

    x: BinAxis
    y: BinAxis
    kind: Kind
    of_faults: bool
    worst_axis: bool  # whether the metric is of an axis, and that of the worst one is taken
    cells: Mapping[str, Cells]  # by variant

    @property
    def span(self) -> tuple[float, float] | None:
        """Smallest and largest median of all; None: no cell is shown."""
        every = np.concatenate([each.medians.ravel() for each in self.cells.values()])
        shown = every[np.isfinite(every)]
        return (float(shown.min()), float(shown.max())) if len(shown) else None


def draw_maps(results: Results) -> Iterator[Picture]:
    """Yield the figure with the maps of all variants, or one that says why there is none."""
    paths, metric = _mapped_paths(results.campaign), results.campaign.metric
    if len(paths) < 2:
        return
    if not _metric_columns(results.frame, metric):
        yield Picture("map", "No map", f"The campaign's table has no numbers '{metric}'.", {})
        return
    maps = maps_of(results)
    if maps is None or maps.span is None:
        yield Picture("map", "No map", f"No cell holds {FEWEST} flights with a '{metric}'.", {})
        return
    plots = {
        name: _spec(f"map-{index}", maps, cells) for index, (name, cells) in enumerate(maps.cells.items())
    }
    yield Picture("map", f"Over {paths[0]} and {paths[1]}", _caption(maps), plots)


def maps_of(results: Results) -> Maps | None:
    """Return the maps of a campaign; None if fewer than two values vary, or no column is the metric."""
    campaign, frame = results.campaign, results.frame
    paths, columns = _mapped_paths(campaign), _metric_columns(frame, campaign.metric)
    if len(paths) < 2 or not columns:
        return None
    both = campaign.vary[paths[0]], campaign.vary[paths[1]]
    most = _bins_for(frame["flight"].n_unique(), both)
    x, y = (bin_axis(frame, path, drawn, most) for path, drawn in zip(paths, both, strict=True))
    of_faults = campaign.metric.startswith(FAULT)
    path = f"{EVENT}0.{campaign.metric.removeprefix(FAULT)}" if of_faults else campaign.metric
    kind = kind_of(path)[1]
    largest = pl.max_horizontal(pl.col(columns).cast(pl.Float64).fill_nan(None))
    values = frame.select(
        "flight", "variant", value=kind.scale * largest, x=pl.Series(x.bins), y=pl.Series(y.bins)
    )
    values = values if of_faults else whole_flights(values)
    values = values.filter(pl.col("value").is_finite(), pl.col("x") >= 0, pl.col("y") >= 0)
    shape = len(y.names), len(x.names)
    cells = {
        side.name: _cells(values.filter(pl.col("variant") == side.name), shape) for side in results.sides
    }
    return Maps(x, y, kind, of_faults, len(columns) > 1, cells)


def bin_axis(frame: pl.DataFrame, path: str, drawn: Distribution, most: int) -> BinAxis:
    """Divide a varied value: each value of a list its own bin, a continuous one in ``most`` quantiles."""
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
    numeric = [isinstance(plain(given[key]), (int, float)) and bool(unit) for key in keys]
    names = tuple(
        digits(plain(given[key])) if number else str(given[key])
        for key, number in zip(keys, numeric, strict=True)
    )
    place = {key: index for index, key in enumerate(keys)}
    there: list[Any] = frame[path].to_list() if path in frame.columns else [None] * frame.height
    bins = np.array([place.get(_key(value), -1) for value in there], np.intp)
    ticks = tuple((float(index), name) for index, name in enumerate(names))[:: -(-len(names) // MANY)]
    return BinAxis(path, unit, names, ticks, False, bins)


def _key(value: Any) -> float | str:
    """A value as it compares between the campaign file and the table."""
    if isinstance(value, bool):
        return str(value)
    return float(value) if isinstance(value, (int, float)) else str(value)


def _bins_for(flights: int, both: tuple[Distribution, Distribution]) -> int:
    """Into how many bins a continuous value is divided, so that a cell holds a few flights on average."""
    listed = [len(each.values) for each in both if each.values]
    cells = flights / (WANTED * float(np.prod(listed, initial=1.0)))
    return int(np.clip(np.floor(cells ** (1.0 / max(len(both) - len(listed), 1))), 2, MOST))


def _mapped_paths(campaign: Campaign) -> tuple[str, ...]:
    """The two varied values that the map is over; fewer: there is no map."""
    able = [path for path, drawn in campaign.vary.items() if drawn.size == 0]
    wanted = [path for path in campaign.map if path in able]
    return tuple(wanted if len(set(wanted)) == len(wanted) == 2 else able[:2])


def _metric_columns(frame: pl.DataFrame, metric: str) -> list[str]:
    """The column of a metric, or those of its axes; none: there are no such numbers."""
    wanted = [metric] if metric in frame.columns else [f"{metric}.{axis}" for axis in AXES]
    return [name for name in wanted if name in frame.columns and frame.schema[name].is_numeric()]


def _cells(values: pl.DataFrame, shape: tuple[int, int]) -> Cells:
    found = values.group_by("y", "x").agg(
        pl.col("value").median(), pl.col("flight").n_unique().alias("flights"), pl.len().alias("rows")
    )
    medians, flights = np.full(shape, np.nan), np.zeros(shape, np.int64)
    place = found["y"].to_numpy(), found["x"].to_numpy()
    medians[place], flights[place] = found["value"].to_numpy(), found["flights"].to_numpy()
    medians[flights < FEWEST] = np.nan
    return Cells(medians, flights, int(found.filter(pl.col("flights") >= FEWEST)["rows"].sum()))


def _caption(maps: Maps) -> str:
    thing = "fault" if maps.of_faults else "flight"
    what = f"median of the {maps.kind.label}{', worst axis' * maps.worst_axis}{_unit(maps)} in each cell"
    counts = counts_text({name: each.rows for name, each in maps.cells.items()}, thing)
    parts = (
        ". A range is divided into parts with as many flights each"
        if maps.x.continuous or maps.y.continuous
        else ""
    )
    return sentence(f"{what}; {counts}. Cells with fewer than {FEWEST} flights are grey{parts}")


def _unit(maps: Maps) -> str:
    return f" [{maps.kind.unit}]" if maps.kind.unit else ""


def _spec(key: str, maps: Maps, cells: Cells) -> dict[str, Any]:
    """Draw the map of a variant, in the colours that hold for all variants."""
    low, high = maps.span or (0.0, 1.0)
    log = low > 0.0 and high > RATIO * low
    bar: dict[str, Any] = {"title": {"text": f"median{_unit(maps)}", "side": "right"}, "thickness": 14}
    shown, edges = cells.medians, (low, high)
    if log:
        shown, edges = np.log10(np.maximum(shown, low)), (np.log10(low), np.log10(high))
        ticks = log_ticks(Scale(low, high, log=True))
        bar |= {**ticks, "tickvals": np.log10(ticks["tickvals"]).tolist()}
    titles = [f"{axis.path} [{axis.unit}]" if axis.unit else axis.path for axis in (maps.x, maps.y)]
    drawing = variant_figure(0, (titles[0], titles[1]))
    drawing.update_layout(
        xaxis=_bin_ticks(maps.x),
        yaxis={**_bin_ticks(maps.y), "automargin": True},
        plot_bgcolor=MISSING,
        margin={"t": 16, "r": 8},
    )
    drawing.add_heatmap(
        z=[[None if np.isnan(value) else value for value in row] for row in shown.tolist()],
        x=list(range(len(maps.x.names))),
        y=list(range(len(maps.y.names))),
        zmin=edges[0],
        zmax=edges[1] if edges[1] > edges[0] else edges[0] + 1.0,
        colorscale=COLOURS,
        colorbar={**bar, "outlinewidth": 0},
        xgap=1,
        ygap=1,
        customdata=_hover(maps, cells),
        hovertemplate="%{customdata}<extra></extra>",
        hoverongaps=False,
    )
    if len(maps.x.names) <= READABLE:
        texts = [[f"{value:.2g}" if np.isfinite(value) else "" for value in row] for row in cells.medians]
        drawing.update_traces(text=texts, texttemplate="%{text}", textfont={"size": 10})
    return spec_of(drawing, key)


def _bin_ticks(axis: BinAxis) -> dict[str, Any]:
    values, texts = zip(*axis.ticks, strict=True)
    span = [-0.5, len(axis.names) - 0.5]
    return {
        "tickvals": values,
        "ticktext": [escaped(text) for text in texts],
        "range": span,
        "showgrid": False,
    }


def _hover(maps: Maps, cells: Cells) -> list[list[str]]:
    """Bins, median and number of flights of each cell."""
    x, y = (
        [f"{escaped(axis.path)}: {escaped(name)} {axis.unit}".rstrip() for name in axis.names]
        for axis in (maps.x, maps.y)
    )
    return [
        [
            f"{x[column]}<br>{y[row]}<br>median {short(value)} {maps.kind.unit}"
            f"<br>{cells.flights[row, column]} flights"
            for column, value in enumerate(line)
        ]
        for row, line in enumerate(cells.medians.tolist())
    ]
