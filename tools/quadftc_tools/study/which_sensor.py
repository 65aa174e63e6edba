# pyright: basic
"""Which sensor is named: from ``which_sensor*`` and ``two_faults*``, the tables of docs/diagnosis.md.

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
from quadftc_tools.study.numbers import write_count, write_degrees, write_numbers, write_per_cent, write_times
from quadftc_tools.study.page import RESULTS, Tables, markdown, read_campaigns, run_study

FAULTS = ("which_sensor", "which_sensor_observers")  # the second: some of these flights, by other observers
TWO = ("two_faults", "two_faults_stand")
NAMES = (*FAULTS, "which_sensor_healthy", *TWO)
JUDGED = ("isolating", "bank")  # the observers of which the tables say more
DELAY = "fault.naming_delay_s"
KINDS = ("fault.named", "fault.ambiguous_share")
ERROR, RATIO = "attitude_error_max_deg", "attitude_error_max_deg_ratio"
OVERVIEW = (
    *("", "flights", "lost", "attitude faults named", "gyro faults named", "of them misnamed at some time"),
    *("named after, median / 95 %", "largest error, 95 % / worst"),
    "over that without diagnosis, 95 % / worst",
)
SENSORS = ("attitude", "gyro", "accelerometer")
COSTS = (
    *("", "all faults named", "more than 1.5 e0 and e0 + 0.3 deg", "of these, error / e0 of the worst"),
    *("not all named", "more than e0 + 5 deg", "of these, error / e0 of the worst"),
)
TWO_HEAD = (
    *("flights", "by", "number", "lost", "both named", "of faults, misnamed at some time"),
    "largest error, 95 % / worst",
)
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
    two: list[tuple[str, ...]] = []
    for name, frame in frames.items():
        place = name.replace("_", "-")
        parts = parts_of(frame)
        if name in FAULTS:
            flown = parts | flown
        if name == FAULTS[0]:
            judged = {observer: parts[observer] for observer in JUDGED if observer in parts}
            tables[f"{place}-kinds"] = kinds_table(judged)
            tables[f"{place}-confusion"] = confusion_table(judged)
            if RATIO in frame.columns:
                tables[f"{place}-costs"] = markdown(COSTS, (_costs(*part) for part in judged.items()))
        elif name == "which_sensor_healthy":
            tables[place] = markdown(HEALTHY, (_healthy(*part) for part in parts.items()))
        elif name in TWO:
            two += two_faults_rows(name, parts)
    if flown:
        tables["which-sensor"] = markdown(OVERVIEW, (_overview(*part) for part in flown.items()))
    return {**tables, "two-faults": markdown(TWO_HEAD, two)} if two else tables


def parts_of(frame: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Return the rows of each variant, in the order flown."""
    variants = frame["variant"].unique(maintain_order=True).to_list()
    return {variant: frame.filter(pl.col("variant") == variant) for variant in variants}


def kinds_table(judged: Mapping[str, pl.DataFrame]) -> str:
    """Named [%], ambiguous [%] and worst error [deg] of each kind of fault; columns are sensors."""
    groups = {
        (kind, sensor, by): part
        for by, faults in judged.items()
        for (kind, sensor), part in faults.partition_by("fault.kind", "fault.component", as_dict=True).items()
    }
    pairs = [(sensor, by) for sensor in SENSORS for by in judged]
    kinds = sorted({kind for kind, _, _ in groups})
    rows = [(kind, *(_kind_cell(groups.get((kind, *pair))) for pair in pairs)) for kind in kinds]
    return markdown(("fault", *(f"{sensor}: `{by}`" for sensor, by in pairs)), rows)


def _kind_cell(part: pl.DataFrame | None) -> str:
    if part is None:
        return "-"
    named, ambiguous = (part[name].cast(pl.Float64) * 100.0 for name in KINDS)
    return write_numbers((_number(named.mean()), _number(ambiguous.mean()), _max(whole_flights(part), ERROR)))


def _costs(name: str, faults: pl.DataFrame) -> tuple[str, ...]:
    """What faults cost beside e0, the largest error of the same flight without diagnosis."""
    flights = faults.group_by("flight").agg(
        pl.col(ERROR).first(), e0=(pl.col(ERROR) / pl.col(RATIO)).first(), named=pl.col("fault.named").all()
    )
    bounds = pl.max_horizontal(1.5 * pl.col("e0"), pl.col("e0") + 0.3), pl.col("e0") + 5.0
    cells: list[str] = []
    for bound, are_named in zip(bounds, (True, False), strict=True):
        part = flights.filter(pl.col("named") == are_named)
        over = part.filter(pl.col(ERROR) > bound).sort(ERROR)
        worst = write_degrees((over[ERROR][-1], over["e0"][-1])) if over.height else "-"
        cells += [str(part.height), str(over.height), worst]
    return f"`{name}`", *cells


def two_faults_rows(name: str, parts: Mapping[str, pl.DataFrame]) -> list[tuple[str, ...]]:
    """Rows of flights with two faults, on different axes and the same one apart."""
    rows: list[tuple[str, ...]] = []
    for by, faults in parts.items():
        same = (pl.len() > 1) & (pl.col("fault.axis").n_unique() == 1)
        with_same = faults.with_columns(same=same.over("flight"))
        for is_same, part in with_same.partition_by("same", as_dict=True, maintain_order=True).items():
            flights = whole_flights(part)
            both = part.group_by("flight").agg(pl.col("fault.named").all())
            rows.append(
                (
                    f"`{name}`{', one axis' if is_same[0] else ''}",
                    f"`{by}`",
                    str(flights.height),
                    write_count((float(flights["lost"].sum()),)),
                    *(write_per_cent((each,)) for each in (_mean(both, "fault.named"), _misnamed(part))),
                    write_degrees((_quantile(flights, ERROR, 0.95), _max(flights, ERROR))),
                )
            )
    return sorted(rows, key=lambda row: row[0])


def confusion_table(judged: Mapping[str, pl.DataFrame]) -> str:
    """Table of what is said of an axis while a sensor of it is faulty, as shares of the time."""
    flights, rows = {by: whole_flights(faults) for by, faults in judged.items()}, []
    for true in TRUE:
        for by, part in flights.items():
            times = {said: float(part[f"{CONFUSION}.{true}.{said}"].sum()) for said in SAID}
            shares = (write_per_cent((times[said] / times[TIME],)) for said in SAID[:-1])
            rows.append((true, f"`{by}`", *shares))
    return markdown(("faulty", "by", *SAID[:-1]), rows)


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
        write_numbers((_quantile(flights, RATIO, 0.95), _max(flights, RATIO))),
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
