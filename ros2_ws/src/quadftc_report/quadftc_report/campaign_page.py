# pyright: basic
"""The report of a campaign as one HTML page: a sentence for each variant, tables, figures, worst flights."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from quadftc_campaign.distributions import Distribution, unit_of
from quadftc_model.samples import AXES
from quadftc_report.campaign_curves import characteristics, distributions
from quadftc_report.campaign_map import draw_maps
from quadftc_report.campaign_results import Floats, Results, Side, known, numbers
from quadftc_report.page import render_template
from quadftc_report.tables import Cell, Group, Row, Table, fact_table, two_heads
from quadftc_report.wording import (
    NOTHING,
    counted,
    duration,
    listing,
    period,
    plain,
    quantity,
    sentence,
    short,
)

LISTED = 5  # worst flights of each variant
OBSERVED = " Without a fault observer the error of the estimate is the fault itself."
_LONG_NUMBER = re.compile(r"[-+]?\d+\.\d{4,}(?:[eE][-+]?\d+)?")
_DISTRIBUTIONS = {
    "uniform": "uniform, {} to {}",
    "log_uniform": "uniform in the logarithm, {} to {}",
    "normal": "normal, mean {}, standard deviation {}",
}


class Quantiles(NamedTuple):
    """A metric whose quantiles are columns of a table."""

    title: str
    metric: str
    shown: tuple[str, ...] = ("q50", "q95")
    scale: float = 1.0


HEADINGS = {"q50": "median", "q95": "95 %", "max": "largest"}
WITH_LARGEST = ("q50", "q95", "max")
DELAY = Quantiles("detection delay [s]", "fault.detection_delay_s")
OF_FAULTS = (
    Quantiles("RMSE of the estimate [deg]", "fault.estimate_rmse_deg", WITH_LARGEST),
    Quantiles("tracking RMSE [deg]", "fault.tracking_rmse_deg"),
)
OF_FLIGHTS = (
    Quantiles("tracking RMSE [deg]", "tracking_rmse_deg", WITH_LARGEST),
    Quantiles("RMSE of the fault estimate [deg]", "fault_estimate_rmse_deg", WITH_LARGEST),
    Quantiles("total variation of the torque [N\u00a0m/s]", "torque_total_variation"),
    Quantiles("samples with the torque cut [%]", "saturation_share", scale=100.0),
)


def render_campaign(results: Results, directory: Path, command_file: str) -> str:
    """Return the page: HTML that needs no other file.

    Parameters
    ----------
    results : Results
    directory : Path
        Of the campaign, for the commands that fly a flight again.
    command_file : str
        The campaign file as the user names it.
    """
    campaign = results.campaign
    pictures = {
        "Distributions": list(distributions(results)),
        "Map": list(draw_maps(results)),
        "Detection": list(characteristics(results)),
    }
    return render_template(
        "campaign.html",
        name=campaign.name,
        description=campaign.description.strip(),
        extent=f"{counted(campaign.flights, 'flight')} of {counted(len(results.sides), 'variant')}",
        sentences=[_tell(side) for side in results.sides],
        facts=_facts(results),
        tables=_quantile_tables(results),
        pictures={title: shown for title, shown in pictures.items() if shown},
        worst=_worst_tables(results, _Again(results, directory, command_file)),
    )


def _tell(side: Side) -> str:
    """One sentence on a variant: whether it stayed finite, how it tracked, what it found."""
    flights, broken = side.summary["flights"], side.summary["not_finite"]
    parts = [f"{broken} of {counted(flights, 'flight')} did NOT stay finite"] if broken else []
    tracking = known(side.worst_tracking)
    if len(tracking):
        median, high = (quantity(float(np.quantile(tracking, q)), "deg") for q in (0.5, 0.95))
        parts.append(
            f"the median flight tracks its worst axis with an RMSE of {median}, 95 % with at most {high}"
        )
    parts.append(_detection(side) if side.has_observer else "it has no fault observer")
    return sentence(f"{side.title}: {'; '.join(part for part in parts if part)}")


def _detection(side: Side) -> str:
    judged = known(numbers(side.faults, "fault.detected"))
    if not len(judged):
        return ""
    delays = known(numbers(side.faults, "fault.detection_delay_s"))
    after = f", the median one after {duration(float(np.median(delays)))}" if len(delays) else ""
    rate = side.alarms_per_hour()
    alarms = "no false alarm" if not rate else f"{plain(rate)} false alarms an hour"
    hours = f", with {alarms} in {plain(side.healthy_hours())} h of healthy axes" if rate is not None else ""
    return f"it finds {int(np.sum(judged))} of {counted(len(judged), 'fault')}{after}{hours}"


def _facts(results: Results) -> Table:
    campaign = results.campaign
    data, base = campaign.document.data, campaign.base.data
    fixed = [str(each) for each in data.get("set", [])]
    facts = {
        "scenario": " with ".join(filter(None, [str(data.get("scenario", "")), listing(fixed)])),
        "duration of a flight": str(base.get("duration", "")),
        "flights": f"{campaign.flights} of each variant, the same draws for all",
        "seed": str(campaign.seed),
        "precision": "float32" if campaign.float32 else "float64",
    }
    drawn = {path: _describe(each) for path, each in campaign.vary.items()}
    drawn["seed"] = "of noise and the like, a new one for each flight"
    groups = {
        "Campaign": {name: text for name, text in facts.items() if text},
        "Variants": {side.name: _parts(side) for side in results.sides},
        "Drawn for each flight": drawn,
    }
    listed = {title: {name: (text,) for name, text in each.items()} for title, each in groups.items()}
    return fact_table("The campaign, its variants, and what is drawn.", ["value"], listed)


def _parts(side: Side) -> str:
    names = {
        key: side.rows[key].drop_nulls()
        for key in ("observer", "disturbance_observer", "controller")
        if key in side.rows.columns
    }
    words = {"observer": "fault observer"}
    return ", ".join(
        f"{words.get(key, key.replace('_', ' '))} {each[0]}" for key, each in names.items() if len(each)
    )


def _describe(drawn: Distribution) -> str:
    """How a value is drawn: ``uniform, 0.5 deg to 5 deg, of either sign``."""
    values = [_value_text(value) for value in drawn.values]
    if len(values) == 1:
        text = values[0]
    elif values:
        text = (
            f"each in turn: {listing(values)}"
            if drawn.is_grid
            else f"{listing(values, 'or')}, each as likely"
        )
    else:
        bounds = (f"{plain(bound)} {drawn.unit}".rstrip() for bound in drawn.bounds)
        text = _DISTRIBUTIONS[drawn.kind].format(*bounds)
    return f"{text}{', of either sign' * drawn.signed}{f'; {drawn.size} of them' if drawn.size else ''}"


def _value_text(value: Any) -> str:
    """A value as it was drawn; long numbers with three digits."""
    if isinstance(value, float):
        return plain(value)
    return _LONG_NUMBER.sub(lambda match: plain(float(match[0])), str(value))


def _quantile_tables(results: Results) -> list[Table]:
    """Quantiles of each fault by its kind, and of the whole flights by axis."""
    sides = results.sides
    note = OBSERVED if any(not side.has_observer for side in sides) else ""
    tables = []
    if results.kinds:
        heads = [("faults", ("count", "missed")), *map(_head, (DELAY, *OF_FAULTS))]
        groups = (Group(kind, tuple(_fault_rows(sides, kind))) for kind in results.kinds)
        caption = f"Each fault by itself, by its kind; delays are those of faults that were found.{note}"
        tables.append(Table(caption, two_heads(("variant",), heads), tuple(groups)))
    heads = [*map(_head, OF_FLIGHTS), ("false alarms [1/h]", ("mean",))]
    groups = (Group(axis, tuple(_flight_row(side, axis) for side in sides)) for axis in AXES)
    caption = f"The whole flights, by axis; false alarms in an hour of a healthy axis.{note}"
    return [*tables, Table(caption, two_heads(("variant",), heads), tuple(groups))]


def _head(column: Quantiles) -> tuple[str, Sequence[str]]:
    return column.title, [HEADINGS[name] for name in column.shown]


def _fault_rows(sides: Sequence[Side], kind: str) -> Iterator[Row]:
    for side in sides:
        found = side.summary["faults"].get(kind)
        if found is None:
            continue
        detection = [Cell("no fault observer", "faint", columns=3)]
        if side.has_observer:
            partly = f" of {found['judged']}" if found["judged"] != found["count"] else ""
            detection = [Cell(f"{found['missed']}{partly}", "number"), *_quantiles(found["metrics"], DELAY)]
        rest = [cell for column in OF_FAULTS for cell in _quantiles(found["metrics"], column)]
        yield Cell(side.name), Cell(str(found["count"]), "number run"), *detection, *rest


def _flight_row(side: Side, axis: str) -> Row:
    metrics = side.summary["metrics"]
    cells = [cell for column in OF_FLIGHTS for cell in _quantiles(metrics, column, f".{axis}")]
    rate = side.alarms_per_hour([axis]) if side.has_observer else None
    return Cell(side.name), *cells, Cell(short(rate), "number run")


def _quantiles(metrics: Mapping[str, Any], column: Quantiles, suffix: str = "") -> Iterator[Cell]:
    values = metrics.get(f"{column.metric}{suffix}", {})
    for place, key in enumerate(column.shown):
        value = values.get(key)
        text = NOTHING if value is None else short(column.scale * value)
        yield Cell(text, "number" if place else "number run")


class _Again(NamedTuple):
    """What the command that flies a flight again has to name."""

    results: Results
    directory: Path
    file: str

    def command(self, flight: int, variant: str) -> str:
        campaign = self.results.campaign
        words = ["scripts/quadftc", "campaign", self.file]
        if isinstance(campaign.document.origins.get(("flights",)), str):  # not the file's number
            words += ["--flights", str(campaign.flights)]
        words += ["--out", str(self.directory), "--flight", str(flight), "--variant", variant]
        return shlex.join(words)


def _worst_tables(results: Results, again: _Again) -> list[Table]:
    """The worst flights by tracking, and by the estimate of a fault where there is one."""
    tracking = {side: _by_tracking(side) for side in results.sides}
    estimates = {side: _by_estimate(side) for side in results.sides if side.has_observer}
    found = [
        _worst_table("Largest tracking errors", ("worst axis", "tracking RMSE [deg]"), tracking, again),
        _worst_table("Worst fault estimates", ("fault", "RMSE of the estimate [deg]"), estimates, again),
    ]
    return [table for table in found if table.groups]


Worst = tuple[Mapping[str, Any], str, float]  # row of the table, where, how much [deg]


def _worst_table(
    title: str, heads: tuple[str, str], found: Mapping[Side, list[Worst]], again: _Again
) -> Table:
    vary = again.results.campaign.vary
    units = {path: _unit(drawn) for path, drawn in vary.items()}
    names = [f"{path} [{unit}]" if unit else path for path, unit in units.items()]
    groups = [
        Group(side.name, tuple(row for each in worst for row in _worst_rows(side, each, again)))
        for side, worst in found.items()
        if worst
    ]
    cells = (
        Cell("flight"),
        Cell(heads[0]),
        Cell(heads[1], "number"),
        *(Cell(name.replace(".", ".\u200b")) for name in names),
    )
    caption = (
        f"{title}: the worst of each variant, with the values drawn and the command that flies it again."
    )
    return Table(caption, (cells,), tuple(groups), "worst")


def _worst_rows(side: Side, worst: Worst, again: _Again) -> Iterator[Row]:
    row, where, value = worst
    vary = again.results.campaign.vary
    drawn = (row.get(path) for path in vary)
    texts = (NOTHING if each is None else _value_text(each) for each in drawn)
    size = "not finite" if np.isinf(value) else short(value)
    yield Cell(str(row["flight"])), Cell(where), Cell(size, "number"), *map(Cell, texts)
    yield Cell(""), Cell(again.command(row["flight"], side.name), "command code", columns=2 + len(vary))


def _unit(drawn: Distribution) -> str:
    """Unit of a value in the table; empty: it has none, or not always the same."""
    if drawn.size or not drawn.values:
        return "" if drawn.size else drawn.unit
    units = {unit_of(value) for value in drawn.values}
    return units.pop() if len(units) == 1 else ""


def _by_tracking(side: Side) -> list[Worst]:
    found: list[Worst] = []
    for row, value in _largest(side.flights, side.worst_tracking):
        axes = {axis: row.get(f"tracking_rmse_deg.{axis}") for axis in AXES}
        sizes = {axis: size for axis, size in axes.items() if size is not None and np.isfinite(size)}
        found.append((row, NOTHING if np.isinf(value) else max(sizes, key=lambda name: sizes[name]), value))
    return found


def _by_estimate(side: Side) -> list[Worst]:
    """Faults of flights that did not stay finite are left out: those are among the worst in tracking."""
    values = numbers(side.faults, "fault.estimate_rmse_deg")
    values[np.isinf(side.estimate_errors)] = np.nan
    found: list[Worst] = []
    for row, value in _largest(side.faults, values):
        when = period(row["fault.start"], row["fault.stop"]).removeprefix("from ")
        found.append((row, f"{row['fault.kind']} on {row['fault.axis']}, {when}", value))
    return found


def _largest(frame: pl.DataFrame, values: Floats) -> list[tuple[Mapping[str, Any], float]]:
    """The rows with the largest values, the largest first; of equal ones the first."""
    order = np.argsort(-values, kind="stable")  # NaN last
    chosen = [int(place) for place in order[:LISTED] if not np.isnan(values[place])]
    return [(frame.row(place, named=True), float(values[place])) for place in chosen]
