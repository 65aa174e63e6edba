"""Flights without a fault, outliers, and steps that last: what a detector says of them.

Only observers with a detector are in it: the others never say that an axis is faulty.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_model.samples import AXES
from quadftc_tools.study.diagnosis_results import by_observer, by_recording, flown
from quadftc_tools.study.numbers import write_count, write_degrees, write_per_cent, write_times
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
    """Return the false alarms of flights without a fault: of each recording, and of all flights."""
    flights = whole_flights(frame)
    groups = {**by_recording(flights), "all": flights}
    return {name: _alarms(part) for name, part in groups.items() if name != "simulated"}


def _alarms(flights: pl.DataFrame) -> dict[str, float]:
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
    rows = next(iter(observers.values()))
    lines = [
        (name, *(_healthy_cell(each[name]) for each in observers.values()))
        for name in rows
        if len(rows) > 1 or name == "all"
    ]
    return markdown(("", *(f"`{name}`" for name in observers)), lines)


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


def sum_up_long(frame: pl.DataFrame) -> dict[str, Any]:
    """Return how long a step that lasts stays declared, and how well it is estimated."""
    faults = frame.filter(pl.col("fault.detected").is_not_null())
    figures: dict[str, Callable[[Any], Any]] = {
        "mean": np.mean,
        "min": np.min,
        "median": np.median,
        "max": np.max,
    }
    wanted = {
        "declared_share": ("mean", "min"),
        "estimate_rmse_deg": ("median", "max"),
        "estimate_max_deg": ("max",),
        "coverage_2_sigma": ("mean", "min"),
    }
    found: dict[str, Any] = {"count": faults.height, "missed": int((~faults["fault.detected"]).sum())}
    for column, names in wanted.items():
        values = faults[f"fault.{column}"].drop_nulls().to_numpy()
        found |= {f"{column}_{name}": float(figures[name](values)) if len(values) else None for name in names}
    return found


def long_table(observers: Json) -> str:
    """How long a step that lasts stays declared, and how well it is estimated."""
    rows = (
        ("steps", ("count",), write_count),
        ("missed", ("missed",), write_count),
        (
            "declared, share of the step, mean / least",
            ("declared_share_mean", "declared_share_min"),
            write_per_cent,
        ),
        (
            "RMSE of the estimate, median / largest",
            ("estimate_rmse_deg_median", "estimate_rmse_deg_max"),
            write_degrees,
        ),
        ("error of the estimate, max", ("estimate_max_deg_max",), write_degrees),
        (
            "errors within 2 standard deviations while declared, mean / least",
            ("coverage_2_sigma_mean", "coverage_2_sigma_min"),
            write_per_cent,
        ),
    )
    lines = [
        (label, *(write(tuple(each[name] for name in names)) for each in observers.values()))
        for label, names, write in rows
    ]
    return markdown(("", *(f"`{name}`" for name in observers)), lines)


QUIET: dict[str, tuple[str, Callable[[pl.DataFrame], dict[str, Any]], Callable[[Json], str]]] = {
    "healthy_recordings": ("recordings as they are", sum_up_healthy, healthy_table),
    "healthy_flips": ("rolls and loops without a fault", sum_up_healthy, healthy_table),
    "outliers": ("outliers, simulated MEMS IMU", sum_up_outliers, outlier_table),
    "long": ("steps of 1 deg for 60 s, simulated MEMS IMU", sum_up_long, long_table),
}  # campaign -> title, how it is summed up, and its table
