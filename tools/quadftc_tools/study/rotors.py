# pyright: basic
"""The study of weak rotors, from the campaigns ``rotor_faults*``; tables of docs/rotors.md.

python3 -m quadftc_tools.study.rotors --results results --docs docs
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import polars as pl

from quadftc_campaign.table import whole_flights
from quadftc_tools.study.numbers import write_number, write_per_cent, write_times
from quadftc_tools.study.page import NOTHING, RESULTS, Tables, markdown, read_campaigns, run_study

NAMES = ("rotor_faults", "rotor_faults_healthy")
JUDGED, PLAIN = "bank", "undiagnosed"  # variants
WRONG_ROTORS = "rotors.false_namings"
WRONG_SENSORS = pl.sum_horizontal(pl.col("^sensors.false_namings.*$"))
HEAD = (
    *("fault", "flights", "named", "something healthy named at some time", "named after, median / largest"),
    *("error of the loss 1 s later, median / largest", "lost", "furthest from its place, median / worst"),
    *("lost without diagnosis", "furthest then"),
)
HEALTHY_HEAD = ("flights of 80 s", "hours", "flights in which a rotor is named", "a sensor")


class Row(NamedTuple):
    """Some of the faults: what the specification of each begins with or has in it, and how large it is."""

    label: str
    kind: str
    channel: str = "rotor"
    low: float = 0.0  # %
    high: float = 100.0
    rise: str = ""  # s


ROWS = (
    *(Row(f"rotor: {size:g} % lost", "loss", low=size, high=size) for size in (5.0, 7.5, 10.0)),
    Row("rotor: 15 to 40 % lost", "loss", low=15.0, high=40.0),
    Row("rotor: 40 to 60 % lost", "loss", low=40.0, high=60.0),
    *(Row(f"rotor: 30 % lost over {rise} s", "loss", rise=rise) for rise in ("0.5", "2", "8")),
    Row("rotor: off, for 0.7 s", "off"),
    Row("attitude: bias of 1 to 8 deg", "bias", "attitude"),
    Row("gyro: bias of 0.1 to 0.5 rad/s", "bias", "gyro"),
    Row("gyro: stuck", "stuck", "gyro"),
    Row("accelerometer: bias of 1 to 3 m/s²", "bias", "accelerometer"),
)


def choose(row: Row) -> pl.Expr:
    """Whether a fault belongs to a row."""
    spec = pl.col("faults.0")
    value = spec.str.extract(r"value=([0-9.]+)%").cast(pl.Float64)
    rise = spec.str.extract(r"rise=([0-9.]+)").fill_null("")
    chosen = spec.str.starts_with(f"{row.kind} ") & spec.str.contains(f"channel={row.channel} ")
    if row.kind != "loss":
        return chosen
    return chosen & (rise == row.rise) & value.is_between(row.low, row.high)


def fault_table(frame: pl.DataFrame) -> str:
    """What is named in flights with one fault, and how they go with and without a diagnosis."""
    found = ((row, frame.filter(choose(row))) for row in ROWS)
    return markdown(HEAD, (_cells(row, faults) for row, faults in found if faults.height))


def _cells(row: Row, faults: pl.DataFrame) -> tuple[str, ...]:
    judged = faults.filter(variant=JUDGED)
    flights = whole_flights(judged)
    wrong = flights.select((pl.col(WRONG_ROTORS) > 0.0) | (WRONG_SENSORS > 0.0)).to_series()
    named = judged.filter(pl.col("fault.named"))
    delays, errors = (named[f"fault.{name}"].drop_nulls() for name in ("naming_delay_s", "size_error_mean"))
    return (
        row.label,
        str(flights.height),
        write_per_cent((_mean(judged["fault.named"]),)),
        write_per_cent((_mean(wrong),)),
        write_times(_spread(delays)) if len(delays) else NOTHING,
        write_per_cent(_spread(errors)) if len(errors) else NOTHING,
        *_held(judged),
        *_held(faults.filter(variant=PLAIN)),
    )


def _held(rows: pl.DataFrame) -> tuple[str, str]:
    """Return the share of flights that are lost, and how far the others get from their place."""
    flights = whole_flights(rows)
    far = flights.filter(~pl.col("lost"))["position_max_m"]
    spread = f"{far.median():.2f}/{far.max():.2f} m" if len(far) else NOTHING
    return write_per_cent((_mean(flights["lost"]),)), spread


def _spread(values: pl.Series) -> tuple[float, float]:
    return float(values.median()), float(values.max())  # type: ignore[arg-type]


def _mean(values: pl.Series) -> float:
    return float(values.cast(pl.Float64).mean())  # type: ignore[arg-type]


def healthy_table(frame: pl.DataFrame) -> str:
    """How often something is named in flights without a fault."""
    flights = whole_flights(frame.filter(variant=JUDGED))
    named = (int((flights.select(each).to_series() > 0.0).sum()) for each in (WRONG_ROTORS, WRONG_SENSORS))
    hours = float(flights["healthy_time_s.roll"].sum()) / 3600.0
    return markdown(HEALTHY_HEAD, [(str(flights.height), write_number(hours), *map(str, named))])


def make(results: Path) -> Tables:
    """Return the tables of the campaigns that are there; ValueError if there is none."""
    frames, tables = read_campaigns(results, NAMES), dict[str, str]()
    for name, write in zip(NAMES, (fault_table, healthy_table), strict=True):
        if name in frames:
            tables[name.replace("_", "-")] = write(frames[name])
    return tables


if __name__ == "__main__":
    sys.exit(run_study("rotors.md", lambda options: make(options.results), {"--results": RESULTS}))
