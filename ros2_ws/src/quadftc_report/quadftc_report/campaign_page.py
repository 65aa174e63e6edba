# pyright: basic
"""The report of a campaign as one HTML page: a sentence for each variant, tables, figures, worst flights.

A figure has the curves of all variants: distributions.
"""

from __future__ import annotations

import functools
import html
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.distributions import Distribution, unit_of
from quadftc_model.samples import AXES
from quadftc_report.campaign_results import Floats, Results, Side, known, numbers
from quadftc_report.confusion import confusion_tables
from quadftc_report.draw_plotly import TOP, Look, axis, empty_figure, line_look, spec_of
from quadftc_report.page import render_template
from quadftc_report.wording import NOTHING, counted, duration, period, plain, short

HEIGHT = 380  # px
LEGEND_ROW = 23  # px
IN_A_ROW = 3  # entries of a legend, about
POINTS = 500  # of a curve
RATIO = 8.0  # between the largest and the smallest value, from which on a scale is logarithmic
DECADES = 3.5  # longest logarithmic scale with ticks at 2 and 5
escape = functools.partial(html.escape, quote=False)  # so that Plotly finds no markup
SHARES = {"range": [-0.02, 1.03], "tickformat": ".0%"}  # axis
LISTED = 5  # worst flights of each variant
_Worst = tuple[Mapping[str, Any], str, float]  # row of the table, where, size [deg]; infinite: not finite
_LONG_NUMBER = re.compile(r"[-+]?\d+\.\d{4,}(?:[eE][-+]?\d+)?")
HEADINGS = {"q50": "median", "q95": "95 %", "max": "largest"}
WITH_LARGEST = ("q50", "q95", "max")


class Picture(NamedTuple):
    """A figure on the page."""

    key: str
    title: str
    caption: str
    spec: Look  # data, layout and config


def log_ticks(low: float, high: float) -> Look:
    """Return the ticks of a logarithmic scale, for Plotly."""
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) <= DECADES else (1.0,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [step * 10.0**power for power in powers for step in steps]
    values = [value for value in values if low <= value <= high]
    return {"tickvals": values, "ticktext": [plain(value) for value in values]}


class Ecdf(NamedTuple):
    """An empirical distribution: rising arrays (m,), and the count of all values, infinite ones included."""

    values: Floats
    shares: Floats  # of all, that are at most the value
    total: int


def ecdf(values: Floats) -> Ecdf:
    """Return the distribution of values (n,), thinned to ``POINTS``.

    NaN is left out. Infinite values, such as the delay of a fault that was never found, keep the curve
    below 1.
    """
    given = values[~np.isnan(values)]
    ordered = np.sort(given[np.isfinite(given)])
    ranks = _thin(len(ordered))
    return Ecdf(ordered[ranks], (ranks + 1) / max(len(given), 1), len(given))


def _thin(count: int) -> NDArray[np.intp]:
    """Which of so many points of a curve are drawn."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, POINTS))).astype(np.intp))


def distributions(results: Results) -> Iterator[Picture]:
    """Yield the distributions of tracking, fault estimate and detection delay."""
    sides, note = results.sides, "A flight that did not stay finite is worse than all others."
    tracking = [(side, side.worst_tracking) for side in sides]
    yield from _distribution("tracking", "tracking RMSE of the worst axis", "deg", "flight", tracking, note)
    note = "Without a fault observer the error is the fault itself."
    estimates = [(side, side.estimate_errors) for side in sides]
    yield from _distribution("estimate", "RMSE of the estimate", "deg", "fault", estimates, note)
    note = "Where faults were missed, the curve ends below 100 %."
    delays = [(side, side.detection_delays) for side in sides if side.has_observer]
    yield from _distribution("delay", "detection delay", "s", "fault", delays, note)


def _distribution(
    key: str, value: str, unit: str, thing: str, parts: Sequence[tuple[Side, Floats]], note: str
) -> Iterator[Picture]:
    """A figure of distributions; none if there is not a value."""
    curves = [(side, curve) for side, values in parts if (curve := ecdf(values)).total]
    finite = np.concatenate([np.zeros(0), *(curve.values for _, curve in curves)])
    if not len(finite):
        return
    positive = finite[finite > 0.0] if np.any(finite > 0.0) else np.ones(1)
    low, high = float(positive.min()), float(positive.max())
    start, end, x_axis = 0.0, 1.05 * high, {"range": [0.0, 1.05 * high]}
    if high > RATIO * low:
        start, end = low / 2.0, 1.1 * high
        note += " Zeros stand at the left end." if np.any(finite <= 0.0) else ""
        x_axis = {"type": "log", "range": [math.log10(start), math.log10(end)], **log_ticks(start, end)}
    drawing = variant_figure(len(curves), (f"{value} [{unit}]", f"share of the {thing}s"))
    drawing.update_layout(xaxis=x_axis, yaxis=SHARES)
    for side, curve in curves:
        # from below the first step to the end of the axis
        x = np.concatenate([[start], curve.values, [end]])
        final = curve.shares[-1] if len(curve.shares) else 0.0
        drawing.add_scatter(
            x=np.maximum(x, start).astype(np.float32),
            y=np.concatenate([[0.0], curve.shares, [final]]).astype(np.float32),
            name=escape(side.name),
            line_shape="hv",
            customdata=[short(each) for each in x.tolist()],
            hovertemplate=f"{escape(side.name)}: %{{y:.1%}} at most %{{customdata}} {unit}<extra></extra>",
            **line_look(side.role, side.rank),
        )
    caption, key = f"Share of the {thing}s whose {value} is at most so much. {note}", f"ecdf-{key}"
    yield Picture(key, f"{value[0].upper()}{value[1:]}", caption, spec_of(drawing, key))


def variant_figure(entries: int, titles: tuple[str, str]) -> go.Figure:
    """Return an empty figure with room for the entries of its legend."""
    more = LEGEND_ROW * max(-(-entries // IN_A_ROW) - 1, 0)
    x, y = (axis(escape(title)) for title in titles)
    others = {"showlegend": entries > 0, "hovermode": "closest", "xaxis": x, "yaxis": y}
    return empty_figure(HEIGHT + more, TOP + more, **others)


class Quantiles(NamedTuple):
    """A metric whose quantiles are columns of a table."""

    title: str
    metric: str
    shown: tuple[str, ...] = ("q50", "q95")
    scale: float = 1.0


OF_FAULTS = (
    Quantiles("detection delay [s]", "fault.detection_delay_s"),
    Quantiles("sensor named after [s]", "fault.naming_delay_s", WITH_LARGEST),
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
    """Return the page, HTML that needs no other file.

    It names the ``directory`` of the campaign and the ``command_file``, as the user does, in the commands
    that fly a flight again.
    """
    campaign, sides = results.campaign, results.sides
    worst = (
        ("Largest tracking errors", ("worst axis", "tracking RMSE [deg]"), map(_worst_flights, sides)),
        ("Worst fault estimates", ("fault", "RMSE of the estimate [deg]"), map(_worst_faults, sides)),
    )
    shown = [(title, heads, dict(zip(sides, found, strict=True))) for title, heads, found in worst]

    def again(flight: int, variant: str) -> str:
        """The command that flies a flight again."""
        words = ["scripts/quadftc", "campaign", command_file]
        for key, number in {"flights": campaign.flights, "seed": campaign.seed}.items():
            if isinstance(campaign.document.origins.get((key,)), str):  # not the file's
                words += [f"--{key}", str(number)]
        words += ["--out", str(directory), "--flight", str(flight), "--variant", variant]
        return shlex.join(words)

    return render_template(
        "campaign.html",
        campaign=campaign,
        sides=sides,
        checks=results.checks,
        tell=_tell,
        kinds=results.kinds,
        axes=AXES,
        headings=HEADINGS,
        of_faults=OF_FAULTS,
        of_flights=OF_FLIGHTS,
        confusion_tables=confusion_tables(
            (side.name, side.summary.get("confusion_s", {}), side.summary.get("rotor_confusion_s", {}))
            for side in sides
        ),
        figures=list(distributions(results)),
        spec=attrgetter("spec"),
        worst=[each for each in shown if any(each[2].values())],
        drawn_heads=[_drawn_head(path, drawn, results.frame) for path, drawn in campaign.vary.items()],
        drawn_text=_drawn_text,
        again=again,
    )


def _tell(side: Side) -> str:
    """One sentence on a variant: whether it stayed finite, how it tracked, what it found."""
    flights, broken = side.summary["flights"], side.summary["not_finite"]
    said = [f"{broken} of {counted(flights, 'flight')} did NOT stay finite"] if broken else []
    tracking = known(side.worst_tracking)
    if len(tracking):
        sizes = [f"{short(each)} deg" for each in np.quantile(tracking, (0.5, 0.95))]
        said.append(f"tracks its worst axis with a median RMSE of {sizes[0]}, 95 % {sizes[1]}")
    if lost := side.summary.get("lost"):
        said.append(f"LOSES the vehicle in {lost} of {counted(flights, 'flight')}")
    worst = known(numbers(side.flights, "attitude_error_max_deg_ratio"))
    if side.has_observer and len(worst):
        said.append(f"is off by at most {short(float(np.max(worst)))} times as much as without a diagnosis")
    judged = known(numbers(side.faults, "fault.detected"))
    delays = known(numbers(side.faults, "fault.detection_delay_s"))
    if not side.has_observer:
        said.append("has no fault observer")
    elif len(judged):
        # an axis that is declared before the onset has not found the fault
        before = int(np.sum(known(numbers(side.faults, "fault.already_declared"))))
        after = f", the median after {duration(float(np.median(delays)))}" if len(delays) else ""
        early = f", {before} declared before their onset" if before else ""
        rate = f", {short(side.alarms_per_hour())} false alarms an hour"
        found = int(np.sum(judged)) - before
        said.append(f"finds {found} of {counted(len(judged), 'fault')}{after}{early}{rate}")
    return f"'{side.name}' ({side.parts}): {'; '.join(said)}."


def _worst_flights(side: Side) -> list[_Worst]:
    """The flights with the largest tracking errors."""
    found: list[_Worst] = []
    for row, value in _largest(side.flights, side.worst_tracking):
        sizes = ((row.get(f"tracking_rmse_deg.{axis}"), axis) for axis in AXES)
        there = [each for each in sizes if each[0] is not None and np.isfinite(value)]
        found.append((row, max(there, key=itemgetter(0), default=(0.0, NOTHING))[1], value))
    return found


def _worst_faults(side: Side) -> list[_Worst]:
    """The faults with the worst estimates, but for flights that did not stay finite."""
    errors = side.estimate_errors if side.has_observer else np.zeros(0)
    worst = _largest(side.faults, np.where(np.isinf(errors), np.nan, errors))
    where = "{0[fault.kind]} on {0[fault.axis]}, {1}"
    return [
        (row, where.format(row, period(row["fault.start"], row["fault.stop"])), value) for row, value in worst
    ]


def _largest(frame: pl.DataFrame, values: Floats) -> list[tuple[Mapping[str, Any], float]]:
    """The rows with the largest values, the largest first; of equal ones the first."""
    order = np.argsort(-values, kind="stable")  # NaN last
    chosen = [int(place) for place in order[:LISTED] if not np.isnan(values[place])]
    return [(frame.row(place, named=True), float(values[place])) for place in chosen]


def _drawn_head(path: str, drawn: Distribution, frame: pl.DataFrame) -> tuple[str, str]:
    """The path of a drawn value, with its unit if it always has the same; and the look of its column."""
    units = {unit_of(value) for value in drawn.values} or {drawn.unit}
    unit = units.pop() if len(units) == 1 and not drawn.size else ""
    name = path.replace(".", ".\u200b")
    is_number = path in frame.columns and frame.schema[path].is_numeric()
    return f"{name} [{unit}]" if unit else name, "number" if is_number else ""


def _drawn_text(value: object) -> str:
    """A value as it was drawn; long numbers with three digits."""
    if value is None or isinstance(value, float):
        return NOTHING if value is None else plain(value)
    return _LONG_NUMBER.sub(lambda match: plain(float(match[0])), str(value))
