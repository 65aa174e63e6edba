# pyright: basic
"""The study of which sensor is named, from the campaigns ``which_sensor*``; tables of docs/diagnosis.md.

python3 -m quadftc_tools.study.which_sensor --results results --docs docs
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from quadftc_campaign.table import CONFUSION, ERRORS, whole_flights, with_ratios
from quadftc_flight.diagnosis_metrics.which_sensor import NOTHING, SAID, TIME, TRUE
from quadftc_tools.study.numbers import (
    write_count,
    write_degrees,
    write_number,
    write_numbers,
    write_per_cent,
    write_times,
)
from quadftc_tools.study.page import RESULTS, Tables, markdown, read_campaigns, run_study

FAULTS = ("which_sensor", "which_sensor_observers")  # the second: some of these flights, by other observers
NAMES = (*FAULTS, "which_sensor_healthy")
JUDGED = "isolating"  # the observer of which the tables say more
DELAY = "fault.naming_delay_s"
KINDS = ("fault.named", "fault.ambiguous_share")
ERROR, RATIO = "attitude_error_max_deg", "attitude_error_max_deg_ratio"
OVERVIEW = (
    *("", "flights", "lost", "attitude faults named", "gyro faults named", "of them misnamed at some time"),
    *("named after, median / 95 %", "largest error, 95 % / worst"),
    "over that without diagnosis, 95 % / worst",
)
SENSORS = ("attitude", "gyro", "accelerometer")
HEALTHY = ("", "flights", "any sensor declared", "lost", "largest error, 95 % / worst")


def read_all(results: Path) -> dict[str, pl.DataFrame]:
    """Read the tables of the campaigns that are there; ValueError if there is none."""
    frames = read_campaigns(results, NAMES)
    if all(name in frames for name in FAULTS):
        frames[FAULTS[1]] = side_by_side(*(frames[name] for name in FAULTS))
    return frames


def side_by_side(all_flights: pl.DataFrame, others: pl.DataFrame) -> pl.DataFrame:
    """Join other observers with the same flights of those that flew all of them."""
    same = all_flights.filter(pl.col("flight").is_in(others["flight"].unique().implode()))
    frame = pl.concat([same, others], how="diagonal_relaxed")
    return with_ratios(frame.drop(f"{name}_ratio" for name in ERRORS if f"{name}_ratio" in frame.columns))


def make(frames: Mapping[str, pl.DataFrame]) -> Tables:
    """Return the tables of the campaigns, by the names of their places."""
    tables: dict[str, str] = {}
    flown: dict[str, pl.DataFrame] = {}  # by variant: all flights of those that flew all, some of the others
    for name, frame in frames.items():
        place = name.replace("_", "-")
        variants = frame["variant"].unique(maintain_order=True).to_list()
        parts = {variant: frame.filter(pl.col("variant") == variant) for variant in variants}
        if name in FAULTS:
            flown = parts | flown
        if name == FAULTS[0]:
            judged = frame.filter(pl.col("observer") == JUDGED)
            tables[f"{place}-kinds"] = kinds_table(judged)
            tables[f"{place}-confusion"] = confusion_table(judged)
        elif name == "which_sensor_healthy":
            tables[place] = markdown(HEALTHY, (_healthy(*part) for part in parts.items()))
    if flown:
        tables["which-sensor"] = markdown(OVERVIEW, (_overview(*part) for part in flown.items()))
    return tables


def kinds_table(faults: pl.DataFrame) -> str:
    """Named [%], ambiguous [%] and worst error [deg] of each kind of fault; a column for each sensor."""
    groups = faults.partition_by("fault.kind", "fault.component", as_dict=True)
    kinds = sorted({kind for kind, _ in groups})
    rows = [(kind, *(_kind_cell(groups.get((kind, sensor))) for sensor in SENSORS)) for kind in kinds]
    return markdown(("fault", *SENSORS), rows)


def _kind_cell(part: pl.DataFrame | None) -> str:
    if part is None:
        return "-"
    named, ambiguous = (part[name].cast(pl.Float64) * 100.0 for name in KINDS)
    return write_numbers((_number(named.mean()), _number(ambiguous.mean()), _max(whole_flights(part), ERROR)))


def confusion_table(faults: pl.DataFrame) -> str:
    """Table of what is said of an axis while a sensor of it is faulty, as shares of the time."""
    flights, rows = whole_flights(faults), []
    for true in TRUE:
        times = {said: float(flights[f"{CONFUSION}.{true}.{said}"].sum()) for said in SAID}
        shares = (write_per_cent((times[said] / times[TIME],)) for said in SAID[:-1])
        rows.append((true, *shares, f"{times[TIME]:.0f} s"))
    return markdown(("faulty", *(f"said: {said}" for said in SAID[:-1]), "time of all axes"), rows)


def _overview(name: str, faults: pl.DataFrame) -> tuple[str, ...]:
    flights = whole_flights(faults)
    of = {sensor: faults.filter(pl.col("fault.component") == sensor) for sensor in ("attitude", "gyro")}
    both = pl.concat(of.values())
    return (
        f"`{name}`",
        str(flights.height),
        write_count((float(flights["lost"].sum()),)),
        *(write_per_cent((_mean(part, "fault.named"),)) for part in of.values()),
        write_per_cent((_misnamed(both),)),
        write_times(tuple(_quantile(both, DELAY, each) for each in (0.5, 0.95))),
        write_degrees((_quantile(flights, ERROR, 0.95), _max(flights, ERROR))),
        " / ".join(write_number(each) for each in (_quantile(flights, RATIO, 0.95), _max(flights, RATIO))),
    )


def _healthy(name: str, flights: pl.DataFrame) -> tuple[str, ...]:
    silent, time = (float(flights[f"{CONFUSION}.{NOTHING}.{each}"].sum()) for each in (NOTHING, TIME))
    return (
        f"`{name}`",
        str(flights.height),
        write_per_cent((1.0 - silent / time,)),
        write_count((float(flights["lost"].sum()),)),
        write_degrees((_quantile(flights, ERROR, 0.95), _max(flights, ERROR))),
    )


def _misnamed(faults: pl.DataFrame) -> float | None:
    return _mean(faults.with_columns(wrong=pl.col("fault.misnamed_share") > 0.0), "wrong")


def _mean(frame: pl.DataFrame, name: str) -> float | None:
    return _number(frame[name].cast(pl.Float64).mean())


def _quantile(frame: pl.DataFrame, name: str, share: float) -> float | None:
    return frame[name].quantile(share, "linear") if name in frame.columns else None


def _max(frame: pl.DataFrame, name: str) -> float | None:
    return _number(frame[name].max()) if name in frame.columns else None


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


if __name__ == "__main__":
    page, found = "diagnosis.md", {"--results": RESULTS}
    sys.exit(run_study(page, lambda options: make(read_all(options.results)), found))
