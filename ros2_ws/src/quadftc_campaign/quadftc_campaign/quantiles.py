"""What a campaign says in numbers: quantiles of every metric, for each variant and kind of fault."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import polars as pl

from quadftc_campaign.campaign_file import Campaign

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
NOT_METRICS = ("flight", "variant", "observer", "disturbance_observer", "controller", "seed", "fault")


def summary_of(campaign: Campaign, frame: pl.DataFrame) -> dict[str, Any]:
    """Summarise the table of a campaign, ready for JSON.

    The same for the same table: it says nothing of when or where it was flown.
    """
    return {
        "name": campaign.name,
        "description": campaign.description,
        "flights": campaign.flights,
        "seed": campaign.seed,
        "precision": "float32" if campaign.float32 else "float64",
        "varied": {path: each.unit for path, each in campaign.vary.items()},
        "variants": {
            variant.name: _variant(campaign, frame.filter(pl.col("variant") == variant.name))
            for variant in campaign.variants
        },
    }


def flight_metrics_of(campaign: Campaign, frame: pl.DataFrame) -> list[str]:
    """Names of the metrics of whole flights that are numbers."""
    left_out = {*NOT_METRICS, *campaign.vary}
    return [
        name
        for name, kind in frame.schema.items()
        if name not in left_out and not name.startswith("fault.") and kind.is_numeric()
    ]


def fault_metrics_of(frame: pl.DataFrame) -> list[str]:
    """Names of the metrics of faults that are numbers."""
    times = ("fault.start", "fault.stop")
    return [
        name
        for name, kind in frame.schema.items()
        if name.startswith("fault.") and name not in times and kind.is_numeric()
    ]


def whole_flights(frame: pl.DataFrame) -> pl.DataFrame:
    """One row for each flight and variant."""
    return frame.unique(["flight", "variant"], keep="first", maintain_order=True)


def _variant(campaign: Campaign, frame: pl.DataFrame) -> dict[str, Any]:
    flights = whole_flights(frame)
    faults = frame.filter(pl.col("fault").is_not_null())
    kinds: list[str] = faults["fault.kind"].unique().sort().to_list() if "fault.kind" in frame.columns else []
    return {
        "flights": flights.height,
        "not_finite": int((~flights["finite"]).sum()),
        "metrics": quantiles(flights, flight_metrics_of(campaign, frame)),
        "faults": {
            kind: _faults(faults if kind == "all" else faults.filter(pl.col("fault.kind") == kind))
            for kind in (*kinds, "all")
            if kinds
        },
    }


def _faults(frame: pl.DataFrame) -> dict[str, Any]:
    return {
        "count": frame.height,
        "judged": int(frame["fault.detected"].is_not_null().sum()),
        "missed": int((frame["fault.detected"] == False).sum()),  # noqa: E712
        "metrics": quantiles(frame, fault_metrics_of(frame)),
    }


def quantiles(frame: pl.DataFrame, names: Iterable[str]) -> dict[str, Any]:
    """Quantiles, mean and extremes of columns; null where no row has a value."""
    found: dict[str, Any] = {}
    for name in names:
        column = frame[name].drop_nulls().drop_nans()
        values: dict[str, Any] = {"count": len(column)}
        if len(column):
            values |= {"mean": column.mean(), "min": column.min(), "max": column.max()}
            values |= {f"q{100 * q:g}": column.quantile(q, "linear") for q in QUANTILES}
        found[name] = {
            key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in values.items()
        }
    return found
