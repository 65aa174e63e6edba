"""The figures of a campaign."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from quadftc_report.campaign import campaign_captions as captions
from quadftc_report.campaign.detector import detector_of
from quadftc_report.campaign.draw import Spec
from quadftc_report.campaign.draw_curves import ecdf_spec, roc_spec
from quadftc_report.campaign.draw_map import map_spec
from quadftc_report.campaign.ecdf import ecdf
from quadftc_report.campaign.heat_map import FEWEST, mapped_paths, maps_of, metric_columns
from quadftc_report.campaign.results import Floats, Results, Side
from quadftc_report.campaign.scale import scale_of


class Plot(NamedTuple):
    """What is drawn by itself; ``title`` is empty where a figure has a single one."""

    key: str
    title: str
    spec: Spec


@dataclasses.dataclass(frozen=True, eq=False)
class Picture:
    """A figure on the page."""

    key: str
    title: str
    caption: str
    plots: tuple[Plot, ...]  # none: the caption says why


def pictures(results: Results) -> dict[str, list[Picture]]:
    """Return the figures of a campaign, by section: distributions, maps, detection."""
    return {
        "distributions": list(_distributions(results)),
        "maps": list(_maps(results)),
        "detection": list(_roc(results)),
    }


def _distributions(results: Results) -> Iterator[Picture]:
    sides, observed = results.sides, results.with_observer
    tracking = [(side, side.worst_tracking) for side in sides]
    what = "tracking RMSE of the worst axis", "deg", "flight"
    yield from _spread(("ecdf-tracking", "Tracking"), what, tracking, [captions.unfinished(sides)])
    if not results.kinds:
        return
    estimates = [(side, side.estimate_errors) for side in sides]
    what = "RMSE of the estimate", "deg", "fault"
    yield from _spread(
        ("ecdf-estimate", "Fault estimate"), what, estimates, [captions.unobserved(results, True)]
    )
    delays = [(side, side.detection_delays) for side in observed]
    notes = [captions.missed(observed), captions.unobserved(results, False)]
    yield from _spread(("ecdf-delay", "Detection delay"), ("detection delay", "s", "fault"), delays, notes)


def _spread(
    names: tuple[str, str],
    what: tuple[str, str, str],
    parts: Sequence[tuple[Side, Floats]],
    notes: Sequence[str],
) -> Iterator[Picture]:
    """A figure of distributions; none if there is not a value."""
    curves = [
        (side, curve) for side, curve in ((side, ecdf(values)) for side, values in parts) if curve.total
    ]
    if not any(len(curve.values) for _, curve in curves):
        return
    key, title = names
    value, unit, thing = what
    scale = scale_of([curve.values for _, curve in curves])
    caption = captions.spread(value, thing, curves, scale.zeros)
    spec = ecdf_spec(key, curves, scale, (f"{value} [{unit}]", f"share of the {thing}s", unit))
    yield Picture(key, title, " ".join(filter(None, [caption, *notes])), (Plot(key, "", spec),))


def _roc(results: Results) -> Iterator[Picture]:
    found = [(side, detector_of(side)) for side in results.sides]
    shown = [(side, each) for side, each in found if each.curve is not None]
    if shown:
        caption = " ".join(captions.roc(results, shown))
        title = "Detection by the size of the estimate"
        yield Picture("roc", title, caption, (Plot("roc", "", roc_spec("roc", shown)),))


def _maps(results: Results) -> Iterator[Picture]:
    paths = mapped_paths(results.campaign)
    if len(paths) < 2:
        return
    metric = results.campaign.metric
    if not metric_columns(results.frame, metric):
        yield Picture("map", "No map", f"The campaign's table has no numbers '{metric}'.", ())
        return
    maps = maps_of(results)
    if maps is None or maps.span is None:
        yield Picture("map", "No map", f"No cell holds {FEWEST} flights with a '{metric}'.", ())
        return
    plots = tuple(
        Plot(f"map-{index}", name, map_spec(f"map-{index}", maps, cells))
        for index, (name, cells) in enumerate(maps.cells.items())
    )
    yield Picture("map", f"Over {paths[0]} and {paths[1]}", captions.heat_map(maps), plots)
