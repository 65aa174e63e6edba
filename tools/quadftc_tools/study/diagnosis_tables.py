"""The tables of docs/diagnosis.md; the same results give the same text."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from quadftc_campaign.open_loop import AGES
from quadftc_model.samples import AXES
from quadftc_tools.study.diagnosis_quiet import QUIET
from quadftc_tools.study.diagnosis_results import BOUNDED, CRITERIA, FIGURED, Criteria
from quadftc_tools.study.numbers import (
    Values,
    write_band,
    write_bracketed,
    write_count,
    write_degrees,
    write_number,
    write_numbers,
    write_per_cent,
    write_times,
)
from quadftc_tools.study.page import NOTHING, has_detector, markdown

Json = Mapping[str, Any]

MARK = "¹"  # behind the names of observers without a detector
SHOWN_AGES = (1.0, 5.0, 10.0, 20.0)  # s, of the table of the bound
WORST = 8  # faults in the table of the worst
BESIDE = "isolating"  # does all that `BOUNDED` does
COMPARED = ("missed", "step", "ramp", "sine", "rmse_median", "share", "nees")  # metrics of the two
UNITS = {"step": "deg", "ramp": "deg/s", "sine": "deg"}


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
    both = {name: results[name] for name in CRITERIA if _has_both(results.get(name))}
    found |= {"beside": beside_table(both)} if both else {}
    for name, result in results.items():
        observers = result["observers"]
        if name in QUIET:
            found[name] = QUIET[name][2](observers)
        if name.endswith("_one_axis"):
            found[f"isolation-{name.removesuffix('_one_axis')}"] = isolation_table(observers[BOUNDED])
        if name in CRITERIA:
            found[name] = metric_table(CRITERIA[name], observers)
        if name in CRITERIA and result.get("each"):
            found[f"{name}-each"] = recording_table(result["each"])
        if name not in FIGURED:
            continue
        found[f"faults-{name}"] = fault_table(CRITERIA[name], observers)
        if BOUNDED in observers:
            found[f"worst-{name}"] = worst_table(observers[BOUNDED]["faults"])
        consistency = result["consistency"].get(BOUNDED, {})
        if "bound_deg" in consistency:
            found["bound"] = bound_table(consistency)
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


def _has_both(result: Json | None) -> bool:
    return result is not None and {BESIDE, BOUNDED} <= result["observers"].keys()


def beside_table(results: Json) -> str:
    """Metrics of `BOUNDED` and of `BESIDE`, setting by setting."""
    lines = [row for row in _rows(CRITERIA["mems"]) if row.values[0] in COMPARED]
    rows: list[Sequence[str]] = []
    for result in results.values():
        views = [_view(each, result["observers"][each]["pooled"]) for each in (BOUNDED, BESIDE)]
        cells = (
            " → ".join(row.write(tuple(view[name] for name in row.values)) for view in views) for row in lines
        )
        rows.append((result["title"], write_count((views[0]["faults"],)), *cells))
    return markdown(("", "faults", *(row.label for row in lines)), rows)


def _rows(criteria: Criteria) -> tuple[_Row, ...]:
    rmse = (criteria.rmse_median_deg, criteria.rmse_p95_deg)
    return (
        _Row("faults", ("faults",), write_count),
        _Row("missed (declared before the onset)", ("missed", "already"), write_bracketed, (0, 0)),
        _Row("delay, step, max", ("step",), write_times, (criteria.step_max_s,), True),
        _Row("delay, step, median", ("step_median",), write_times),
        _Row("delay, ramp, median", ("ramp",), write_times, (criteria.ramp_median_s,), True),
        _Row("delay, sine, median", ("sine",), write_times, (criteria.sine_median_s,), True),
        _Row("RMSE of the estimate, median / 95 %", ("rmse_median", "rmse_p95"), write_degrees, rmse),
        _Row("error of the estimate, max", ("max",), write_degrees),
        _Row(
            "false alarms, share of healthy time", ("share",), write_per_cent, (criteria.false_alarm_share,)
        ),
        _Row("false alarms per hour", ("per_hour",), write_numbers),
        _Row("longest false alarm", ("longest",), write_times),
        _Row("recovery delay, median / 95 %", ("recovery", "recovery_p95"), write_times),
        _Row("not recovered", ("not_recovered",), write_count),
        _Row("NEES [chi-square band, 95 %]", ("nees", "nees_low", "nees_high"), write_band),
        _Row("errors within 2 standard deviations", ("coverage_2_sigma",), write_per_cent),
    )


def _view(observer: str, pooled: Json) -> dict[str, float | None]:
    """Metrics of an observer, by what its states say or, if it has no detector, its estimate."""
    detector = has_detector(observer)
    said: Json = pooled if detector else pooled["by_estimate"]
    of_all = {
        "rmse_median": "estimate_rmse_median_deg",
        "rmse_p95": "estimate_rmse_p95_deg",
        "max": "estimate_max_deg",
        "recovery": "recovery_delay_median_s",
        "recovery_p95": "recovery_delay_p95_s",
        **{name: name for name in ("nees", "nees_low", "nees_high", "coverage_2_sigma")},
    }
    return {
        "faults": pooled["fault_count"],
        "missed": said["missed"],
        "already": said["already_declared" if detector else "already_above"],
        "step": said["delay_max_s"].get("step"),
        "step_median": said["delay_median_s"].get("step"),
        "ramp": said["delay_median_s"].get("ramp"),
        "sine": said["delay_median_s"].get("sine"),
        "share": said["total_false_alarm_share"],
        "per_hour": pooled["total_false_alarms_per_hour"] if detector else None,
        "longest": max(pooled["longest_false_alarm_s"].values()) if detector else None,
        "not_recovered": pooled["not_recovered"] if detector else None,
        **{name: pooled[metric]["all"] for name, metric in of_all.items()},
    }


def recording_table(recordings: Json) -> str:
    """Every metric of `BOUNDED` on each recording."""
    views = [_view(BOUNDED, pooled) for pooled in recordings.values()]
    rows = [
        (row.label, *(_cell(row._replace(limits=None), view) for view in views))
        for row in _rows(CRITERIA["recordings"])
    ]
    return markdown((f"`{BOUNDED}`", *(name.partition("_")[0] for name in recordings)), rows)


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


def fault_table(criteria: Criteria, observers: Json) -> str:
    """Missed and badly estimated faults by kind and size."""
    rows: list[Sequence[str]] = []
    for kind, edges in criteria.bins.items():
        for low, high in itertools.pairwise(edges):
            within = (low, high, high == edges[-1])
            members = {
                name: [fault for fault in result["faults"] if _is_within(fault, kind, *within)]
                for name, result in observers.items()
            }
            cells = [_failures(name, found, criteria) for name, found in members.items()]
            count = max(map(len, members.values()))
            rows.append((kind, f"{low:g} to {high:g} {UNITS[kind]}", str(count), *cells))
    return markdown(("fault", "size", "faults", *(f"`{name}`" for name in observers)), rows)


def _is_within(fault: Json, kind: str, low: float, high: float, last: bool) -> bool:
    size = abs(fault["size"])
    return fault["kind"] == kind and low <= size and (size < high or (last and size <= high * (1.0 + 1e-12)))


def _failures(observer: str, faults: Sequence[Json], criteria: Criteria) -> str:
    judged, already = ("detected", "already_declared")
    if not has_detector(observer):
        judged, already = ("above_threshold", "above_threshold_already")
    missed = sum(fault[judged] is False or bool(fault[already]) for fault in faults)
    worst = math.inf if criteria.rmse_p95_deg is None else criteria.rmse_p95_deg
    bad = sum((fault["estimate_rmse_deg"] or 0.0) > worst for fault in faults)
    return f"{missed}, {bad}"


def worst_table(faults: Sequence[Json]) -> str:
    """The faults with the largest error of the estimate."""
    ordered = sorted(faults, key=lambda fault: -(fault["estimate_rmse_deg"] or 0.0))[:WORST]
    rows = [
        (
            fault["flight"],
            f"{fault['axis']}, {write_number(fault['start'])} s",
            _words(fault),
            _found(fault),
            write_degrees((fault["estimate_rmse_deg"],)),
            write_degrees((fault["estimate_max_deg"],)),
        )
        for fault in ordered
    ]
    return markdown(("flight", "axis, onset", "fault", "found after", "RMSE", "max error"), rows)


def _words(fault: Json) -> str:
    at = "" if fault["frequency"] is None else f" at {write_number(fault['frequency'])} rad/s"
    return f"{fault['kind']} of {write_number(fault['size'])} {UNITS[fault['kind']]}{at}"


def _found(fault: Json) -> str:
    if fault["detected"] is False:
        return "missed"
    return "declared before" if fault["already_declared"] else write_times((fault["detection_delay_s"],))


def isolation_table(result: Json) -> str:
    """Which axis is declared where one is faulty, and for each kind of fault whether it is the right one."""
    pooled = result["pooled"]
    axes = [
        (f"{truth} faulty" if truth != "none" else "no axis faulty", *_shares(line, (*AXES, "none")))
        for truth, line in pooled["confusion_single_s"].items()
    ]
    kinds = [
        (kind, *_shares(line, ("own", "other", "none")))
        for kind, line in pooled["confusion_by_kind_s"].items()
    ]
    accuracy, tested = (
        write_per_cent((pooled["isolation_accuracy"],)),
        write_times((pooled["isolation_tested_s"],)),
    )
    return "\n\n".join(
        (
            markdown(("truth", *(f"{axis} declared" for axis in AXES), "none declared", "time"), axes),
            markdown(("fault", "its axis declared", "another one, too", "none declared", "time"), kinds),
            f"Isolation accuracy of `{BOUNDED}`: {accuracy} of {tested}.",
        )
    )


def _shares(line: Json, columns: Iterable[str]) -> tuple[str, ...]:
    time = line["time"]
    shares = [write_per_cent((line[column] / time,)) if time else NOTHING for column in columns]
    return (*shares, write_times((time,)))


def bound_table(consistency: Json) -> str:
    """Error and standard deviation over the bound."""
    columns: dict[str, tuple[str, Callable[[Values], str]]] = {
        "declared": ("declared", write_per_cent),
        "bound_deg": ("bound", write_degrees),
        "std_dev_deg": ("reported std dev, median", write_degrees),
        "std_dev_over_bound": ("over the bound, median", write_numbers),
        "rms_deg": ("error, RMS", write_degrees),
        "rms_over_bound": ("RMS over the bound", write_numbers),
        "central_over_bound": ("68 % of the errors within, over it", write_numbers),
    }
    rows = [
        (
            write_times((age,)),
            *(write((consistency[name][AGES.index(age)],)) for name, (_, write) in columns.items()),
        )
        for age in SHOWN_AGES
    ]
    return markdown(("since onset", *(head for head, _ in columns.values())), rows)
