"""The tables of docs/diagnosis.md; the same results give the same text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from quadftc_tools.study.diagnosis_quiet import QUIET
from quadftc_tools.study.numbers import (
    Values,
    write_band,
    write_bracketed,
    write_degrees,
    write_per_cent,
    write_times,
)
from quadftc_tools.study.page import NOTHING, has_detector, markdown

Json = Mapping[str, Any]

MARK = "¹"  # behind the names of observers without a detector
SAME = "isolating"  # without a torque it says of the attitude what `supervised` says: no column of its own


class Criteria(NamedTuple):
    """Bounds that an observer has to reach; no fault may be missed."""

    step_max_s: float
    ramp_median_s: float
    sine_median_s: float
    rmse_median_deg: float
    rmse_p95_deg: float
    false_alarm_share: float  # of healthy time


LARGE = Criteria(0.05, 1.5, 0.6, 0.3, 1.0, 0.005)  # for large faults, where the attitude has slow errors
CRITERIA = {"mems": Criteria(0.02, 0.5, 0.12, 0.08, 0.25, 0.0), "ahrs": LARGE, "recordings": LARGE}


class _Row(NamedTuple):
    """A metric: its values for an observer, how they are written, and what they must not exceed."""

    label: str
    values: tuple[str, ...]  # names in the view of an observer
    write: Callable[[Values], str]
    limits: Values | None = None
    of_all: bool = False  # reaches its limits only if every fault was found, and none declared before


def tables(results: Json) -> dict[str, str]:
    """Return every table of the settings that were flown."""
    found = {"flown": flown_table(results)}
    for name, result in results.items():
        observers = {each: result["observers"][each] for each in result["observers"] if each != SAME}
        found[name] = QUIET[name][2](observers) if name in QUIET else metric_table(CRITERIA[name], observers)
    return found


def flown_table(results: Json) -> str:
    """How much was flown."""
    rows: list[Sequence[str]] = []
    for result in results.values():
        bags = f"{len(result['bags'])} recordings: {', '.join(result['bags'])}" if result["bags"] else NOTHING
        counts = (str(result[name]) for name in ("flights", "faults"))
        rows.append((result["title"], *counts, str(result["seed"]), bags))
    return markdown(("setting", "flights", "faults", "seed", "made from"), rows)


def metric_table(criteria: Criteria, observers: Json) -> str:
    """Every metric of every observer, beside what is asked for; in bold what reaches it."""
    names = [f"`{name}`{'' if has_detector(name) else MARK}" for name in observers]
    views = [_view(name, result["pooled"]) for name, result in observers.items()]
    rows = [
        (row.label, NOTHING if row.limits is None else row.write(row.limits), *(_cell(row, v) for v in views))
        for row in _rows(criteria)
    ]
    return markdown(("", "target", *names), rows)


def _rows(criteria: Criteria) -> tuple[_Row, ...]:
    rmse = (criteria.rmse_median_deg, criteria.rmse_p95_deg)
    return (
        _Row("missed (declared before the onset)", ("missed", "already"), write_bracketed, (0, 0)),
        _Row("delay, step, max", ("step",), write_times, (criteria.step_max_s,), True),
        _Row("delay, ramp, median", ("ramp",), write_times, (criteria.ramp_median_s,), True),
        _Row("delay, sine, median", ("sine",), write_times, (criteria.sine_median_s,), True),
        _Row("RMSE of the estimate, median / 95 %", ("rmse_median", "rmse_p95"), write_degrees, rmse),
        _Row(
            "false alarms, share of healthy time", ("share",), write_per_cent, (criteria.false_alarm_share,)
        ),
        _Row("NEES [chi-square band, 95 %]", ("nees", "nees_low", "nees_high"), write_band),
    )


def _view(observer: str, pooled: Json) -> dict[str, float | None]:
    """Metrics of an observer, by what its states say or, if it has no detector, its estimate."""
    detector = has_detector(observer)
    said: Json = pooled if detector else pooled["by_estimate"]
    of_all = {
        "rmse_median": "estimate_rmse_median_deg",
        "rmse_p95": "estimate_rmse_p95_deg",
        **{name: name for name in ("nees", "nees_low", "nees_high")},
    }
    return {
        "missed": said["missed"],
        "already": said["already_declared" if detector else "already_above"],
        "step": said["delay_max_s"].get("step"),
        "ramp": said["delay_median_s"].get("ramp"),
        "sine": said["delay_median_s"].get("sine"),
        "share": said["total_false_alarm_share"],
        **{name: pooled[metric]["all"] for name, metric in of_all.items()},
    }


def _cell(row: _Row, view: Json) -> str:
    values = tuple(view[name] for name in row.values)
    text = row.write(values)
    if row.limits is None:
        return text
    met = not (row.of_all and (view["missed"] or view["already"])) and all(
        value is not None and limit is not None and value <= limit
        for value, limit in zip(values, row.limits, strict=True)
    )
    return f"**{text}**" if met else text
