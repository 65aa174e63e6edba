"""From the tables of the campaigns to results: metrics, delays, operating characteristics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from quadftc_campaign.open_loop import WITHIN
from quadftc_campaign.table import whole_flights
from quadftc_flight.diagnosis_metrics import pool

TITLES = {
    "mems": "simulated MEMS IMU",
    "ahrs": "simulated attitude filter",
    "recordings": "recordings",
}  # of the campaigns that are judged by their faults
FIGURED = ("mems", "recordings")  # those with figures
OF_FAULT = ("kind", "detection_delay_s", "above_threshold_delay_s")  # what the figures need

Json = Mapping[str, Any]


class OperatingPoint(NamedTuple):
    """What a detector as it stands costs and finds; None where there is nothing to judge it by."""

    false_alarm_share: float | None  # of the healthy time of all axes
    detection_probability: float | None  # share of the faults that are found in time


def operating_point(diagnoses: Iterable[Mapping[str, Any]], within: float) -> OperatingPoint:
    """Return the point of the curve at which a detector works, by what its states say.

    ``diagnoses`` are ``summary["metrics"]["diagnosis"]`` of each flight, ``within`` is the longest delay that
    counts [s]; an axis that was declared faulty before the onset does not count.
    """
    flights = list(diagnoses)
    judged = [event for flight in flights for event in flight["events"] if event["detected"] is not None]
    delays = [event["detection_delay_s"] for event in judged]
    found = sum(delay is not None and delay <= within for delay in delays)
    share = pool(flights)["total_false_alarm_share"]
    return OperatingPoint(share, found / len(judged) if judged else None)


def setting_results(name: str, frame: pl.DataFrame, levels: pl.DataFrame | None, manifest: Json) -> Json:
    """Sum up one of the campaigns of `TITLES` by its table and its ``campaign.json``.

    ``levels`` is the table of its first flights with other levels of the detectors.
    """
    found = flown(TITLES[name], frame, manifest)
    found["observers"] = {each: sum_up(part) for each, part in by_observer(frame).items()}
    if name in FIGURED:
        found["roc"] = characteristics(frame, levels)
    return found


def flown(title: str, frame: pl.DataFrame, manifest: Json) -> dict[str, Any]:
    """Return what a campaign is called and how much of it was flown."""
    faults = frame.filter(pl.col("variant") == frame["variant"][0])["fault"].count()
    bags = manifest.get("source", ["", ""])[2:]
    counts = {"flights": frame["flight"].n_unique(), "faults": faults}
    return {"title": title, "seed": manifest["seed"], "bags": bags, **counts}


def by_observer(frame: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Divide the table of a campaign by observer."""
    names = frame["variant"].unique(maintain_order=True)
    return {str(name): frame.filter(pl.col("variant") == name) for name in names}


def sum_up(frame: pl.DataFrame) -> dict[str, Any]:
    """Sum up the flights of one observer."""
    pooled = pool(diagnoses(frame))
    delays = frame["fault.recovery_delay_s"].drop_nulls().to_numpy()
    late = float(np.percentile(delays, 95.0)) if len(delays) else None
    faults = frame.filter(pl.col("fault").is_not_null())
    shown = faults.select(pl.col(f"fault.{name}").alias(name) for name in OF_FAULT).to_dicts()
    return {"pooled": {**pooled, "recovery_delay_p95_s": {"all": late}}, "faults": shown}


def diagnoses(frame: pl.DataFrame) -> list[dict[str, Any]]:
    """Return the metrics of the diagnosis of each flight, as ``summary.json`` has them, from the table."""
    scalars = [name for name, kind in frame.schema.items() if kind != pl.List]
    drawn = ("fault.", "faults.")  # of one fault; a fault and its axes may both be drawn
    flights = whole_flights(frame).select(name for name in scalars if not name.startswith(drawn))
    events: dict[tuple[int, str], list[dict[str, Any]]] = {}
    of_fault = ("flight", "variant", *(name for name in scalars if name.startswith("fault.")))
    for row in frame.filter(pl.col("fault").is_not_null()).select(of_fault).to_dicts():
        event = {name.removeprefix("fault."): value for name, value in row.items()}
        events.setdefault((row["flight"], row["variant"]), []).append(event)
    return [
        {**nested(row), "events": events.get((row["flight"], row["variant"]), [])}
        for row in flights.to_dicts()
    ]


def nested(row: Json) -> dict[str, Any]:
    """Return a row with dotted names as nested mappings."""
    found: dict[str, Any] = {}
    for name, value in row.items():
        *path, last = name.split(".")
        place = found
        for word in path:
            place = place.setdefault(word, {})
        place[last] = value
    return found


def characteristics(frame: pl.DataFrame, levels: pl.DataFrame | None) -> dict[str, Any]:
    """Return what each observer costs in false alarms and finds: points as they stand, and curves."""
    count = frame["flight"].max() if levels is None else levels["flight"].max()
    frames = [frame.filter(pl.col("flight") <= count), *([] if levels is None else [levels])]
    points: dict[str, list[dict[str, Any]]] = {}
    for part in frames:
        for name in part["variant"].unique(maintain_order=True):
            observer, _, level = str(name).partition("@")
            point = operating_point(diagnoses(part.filter(pl.col("variant") == name)), WITHIN)
            found = {"level": float(level) if level else None, **point._asdict()}
            points.setdefault(observer, []).append(found)
    flights = whole_flights(frames[0])
    curves = {
        name: _curve(flights.filter(pl.col("variant") == name))
        for name, found in points.items()
        if len(found) == 1
    }
    return {"points": points, "curves": curves}


def _curve(flights: pl.DataFrame) -> dict[str, Any]:
    healthy, faults = flights["roc.healthy"].sum(), flights["roc.faults"].sum()
    alarms, found = (np.sum(flights[name].to_list(), axis=0) for name in ("roc.alarms", "roc.found"))
    return {
        "level": flights["roc.levels"][0].to_list(),
        "false_alarm_share": (alarms / max(healthy, 1)).tolist(),
        "detection_probability": (found / max(faults, 1)).tolist(),
    }
