"""Recordings without a fault, and outliers: what a detector says of them.

Only observers with a detector are in it: the others never say that an axis is faulty.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_model.samples import AXES
from quadftc_tools.study.diagnosis_results import by_observer, flown
from quadftc_tools.study.numbers import write_per_cent, write_times
from quadftc_tools.study.page import has_detector, markdown

Json = Mapping[str, Any]

SINGLE = 0.005  # s; what is shorter is a single sample
GROUPS = ("single sample", "burst of 20 to 200 ms", "flicker of 0.5 deg for 0.8 s")


def quiet_results(name: str, frame: pl.DataFrame, manifest: Json) -> dict[str, Any]:
    """Sum up one of the campaigns of `QUIET` by its table and its ``campaign.json``."""
    title, sum_up, _ = QUIET[name]
    parts = {each: part for each, part in by_observer(frame).items() if has_detector(each)}
    observers = {observer: sum_up(part) for observer, part in parts.items()}
    return {**flown(title, frame, manifest), "observers": observers}


def sum_up_healthy(frame: pl.DataFrame) -> dict[str, Any]:
    """Return the false alarms of flights without a fault."""
    flights = whole_flights(frame)
    total = {
        name: sum(float(flights[f"{name}.{axis}"].sum()) for axis in AXES)
        for name in ("false_alarm_time_s", "healthy_time_s", "false_alarms")
    }
    longest = np.array([flights[f"longest_false_alarm_s.{axis}"].max() for axis in AXES], np.float64)
    return {
        "share": total["false_alarm_time_s"] / total["healthy_time_s"],
        "alarms": total["false_alarms"],
        "longest_s": float(np.max(longest)),
    }


def healthy_table(observers: Json) -> str:
    """Share of the time in which an axis is declared, alarms, and the longest of them."""
    line = ("all recordings", *(_healthy_cell(each) for each in observers.values()))
    return markdown(("", *(f"`{name}`" for name in observers)), [line])


def _healthy_cell(row: Json) -> str:
    share = write_per_cent((row["share"],))
    return (
        f"{share} ({row['alarms']:.0f}, longest {write_times((row['longest_s'],))})"
        if row["alarms"]
        else share
    )


def sum_up_outliers(frame: pl.DataFrame) -> dict[str, Any]:
    """Return how many outliers are declared, and for how long after their end, by `GROUPS`."""
    length = pl.col("fault.stop") - pl.col("fault.start")
    flicker = pl.col("fault.kind") == "noise"
    masks = (length < SINGLE, (length >= SINGLE) & ~flicker, flicker)
    judged = frame.filter(pl.col("fault.detected").is_not_null() & ~pl.col("fault.already_declared"))
    return {name: _outliers(judged.filter(mask)) for name, mask in zip(GROUPS, masks, strict=True)}


def _outliers(faults: pl.DataFrame) -> dict[str, Any]:
    after = faults["fault.declared_after_s"].to_numpy()
    declared = faults["fault.detected"].to_numpy() | (after > 0.0)
    known = after[declared]
    return {
        "count": faults.height,
        "declared": int(np.sum(declared)),
        "after_median_s": float(np.median(known)) if len(known) else None,
        "after_max_s": float(np.max(known)) if len(known) else None,
    }


def outlier_table(observers: Json) -> str:
    """How many outliers are declared, and how long after the last bad sample the axis is."""
    counts = {name: max(each[name]["count"] for each in observers.values()) for name in GROUPS}
    lines = [
        (name, str(count), *(_outlier_cell(each[name]) for each in observers.values()))
        for name, count in counts.items()
    ]
    return markdown(("", "number", *(f"`{name}`" for name in observers)), lines)


def _outlier_cell(row: Json) -> str:
    after = write_times((row["after_median_s"], row["after_max_s"]))
    return f"{row['declared']}, after the end {after}" if row["declared"] else "0"


QUIET: dict[str, tuple[str, Callable[[pl.DataFrame], dict[str, Any]], Callable[[Json], str]]] = {
    "healthy_recordings": ("recordings as they are", sum_up_healthy, healthy_table),
    "outliers": ("outliers, simulated MEMS IMU", sum_up_outliers, outlier_table),
}  # campaign -> title, how it is summed up, and its table
