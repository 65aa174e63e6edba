"""From the records of all flights to the results: metrics, faults, operating characteristics, bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.diagnosis_metrics.columns import median, number, percentile_95
from quadftc_flight.diagnosis_metrics.roc import operating_point
from quadftc_tools.diagnosis_study.bound import fault_bound
from quadftc_tools.diagnosis_study.campaign import Study, stored
from quadftc_tools.diagnosis_study.flights import study_sensor
from quadftc_tools.diagnosis_study.runs import AGES, WITHIN, Record
from quadftc_tools.diagnosis_study.settings import RATE, SETTINGS, Setting
from quadftc_tools.diagnosis_study.store import Store

Floats = NDArray[np.float64]

OF_FAULT = (
    *("axis", "kind", "start", "fault_max_deg", "detected", "already_declared", "detection_delay_s"),
    *("above_threshold", "above_threshold_already", "above_threshold_delay_s"),
    *("estimate_rmse_deg", "estimate_max_deg", "recovered", "recovery_delay_s", "nees"),
)  # of the record of a fault, what tables and figures need
OF_DRAW = ("size", "frequency", "errors_deg", "std_devs_deg")
BOUNDED = "supervised"  # whose error and standard deviation are held against the bound
CENTRAL = 68.27  # per cent of the errors of a Gaussian within one standard deviation


def gather(study: Study, store: Store, any_code: bool = False) -> dict[str, Any]:
    """Return the results of the flights that are stored, ready for JSON.

    Parameters
    ----------
    study : Study
    store : Store
    any_code : bool
        Take flights of other code, too.

    Raises
    ------
    ValueError
        If not one flight is stored.
    """
    found = {setting.name: _setting(study, store, setting, any_code) for setting in SETTINGS}
    settings = {name: result for name, result in found.items() if result["observers"]}
    if not settings:
        raise ValueError(f"{store.path}: holds no flight of this study")
    return {"seed": study.seed, "within_s": WITHIN, "ages_s": list(AGES), "settings": settings}


def _setting(study: Study, store: Store, setting: Setting, any_code: bool) -> dict[str, Any]:
    records: dict[str, list[Record]] = {}
    curves: dict[str, list[Record]] = {}
    for plan in study.plans(setting):
        task = study.task(plan)
        for variant in task.variants:
            record = stored(store, task, variant, any_code)
            if record is not None:
                records.setdefault(variant.name, []).append(record)
                if study.in_roc(plan):
                    curves.setdefault(variant.name, []).append(record)
    observers = {name: observed(found) for name, found in records.items() if "@" not in name}
    result: dict[str, Any] = {
        "title": setting.title,
        "bags": [bag.name for bag in study.bags] if setting.recorded else [],
        "observers": observers,
    }
    if observers and not setting.one_axis:
        result["roc"] = characteristics(curves)
        result["consistency"] = {
            name: consistency(each["faults"], None if setting.recorded else study.windows)
            for name, each in observers.items()
        }
    return result


def observed(records: Sequence[Record]) -> dict[str, Any]:
    """Sum up the flights of one observer."""
    diagnoses = [record["diagnosis"] for record in records]
    faults = [fault for record in records for fault in _faults(record)]
    delays = [fault["recovery_delay_s"] for fault in faults if fault["recovery_delay_s"] is not None]
    pooled = pool(diagnoses)
    pooled["recovery_delay_p95_s"] = {"all": percentile_95(delays)}
    return {"pooled": pooled, "faults": faults}


def _faults(record: Record) -> list[dict[str, Any]]:
    """Faults of a flight: what was drawn, and how it was diagnosed."""
    drawn = {(fault["axis"], fault["start"]): fault for fault in record["faults"]}
    return [
        {
            "flight": record["flight"],
            **{name: event[name] for name in OF_FAULT},
            **{name: drawn[event["axis"], event["start"]][name] for name in OF_DRAW},
        }
        for event in record["diagnosis"]["events"]
    ]


def characteristics(records: Mapping[str, Sequence[Record]]) -> dict[str, Any]:
    """Return what each observer costs in false alarms and finds: points as they stand, and curves."""
    points: dict[str, Any] = {}
    for name, found in records.items():
        observer, _, value = name.partition("@")
        point = operating_point([record["diagnosis"] for record in found], WITHIN)
        points.setdefault(observer, []).append({"level": float(value) if value else None, **point._asdict()})
    scored = {
        name: [record["score"] for record in found if record["score"] is not None]
        for name, found in records.items()
    }
    curves = {name: _curve(scores) for name, scores in scored.items() if scores}
    return {"flights": max(len(found) for found in records.values()), "points": points, "curves": curves}


def _curve(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    healthy, faults = (sum(score[name] for score in scores) for name in ("healthy", "faults"))
    alarms, found = (_sums([score[name] for score in scores]) for name in ("alarms", "found"))
    return {
        "level": scores[0]["levels"],
        "false_alarm_share": [number(count / healthy) if healthy else None for count in alarms],
        "detection_probability": [number(count / faults) if faults else None for count in found],
    }


def _sums(rows: Sequence[Sequence[int]]) -> list[int]:
    return [sum(column) for column in zip(*rows, strict=True)]


def consistency(
    faults: Sequence[Mapping[str, Any]], windows: Sequence[tuple[float, float]] | None
) -> dict[str, list[float | None]]:
    """Error and reported standard deviation of the faults that are declared, at each of ``AGES``.

    Parameters
    ----------
    faults : sequence of mapping
    windows : sequence of (float, float), optional
        When faults are, if there is a bound.

    Returns
    -------
    dict
        ``declared``: share of the faults; ``rms_deg``, ``central_deg`` (within it are 68 % of the errors),
        ``std_dev_deg`` (median). With a bound: ``bound_deg`` (median), and over the bound of each
        fault ``std_dev_over_bound`` (median), ``rms_over_bound``, ``central_over_bound``.
    """
    bounds = _bounds(faults, windows) if windows else None
    rows: list[dict[str, float | None]] = []
    for place in range(len(AGES)):
        errors = np.array([_or_nan(fault["errors_deg"][place]) for fault in faults])
        std_devs = np.array([_or_nan(fault["std_devs_deg"][place]) for fault in faults])
        row = {
            "declared": number(np.mean(np.isfinite(errors))) if len(errors) else None,
            **_spread(errors, "_deg"),
            "std_dev_deg": _median(std_devs),
        }
        if bounds is not None:
            bound = bounds[:, place]
            row |= {
                "bound_deg": _median(bound),
                "std_dev_over_bound": _median(std_devs / bound),
                **_spread(errors / bound, "_over_bound"),
            }
        rows.append(row)
    return {name: [row[name] for row in rows] for name in rows[0]}


def _bounds(faults: Sequence[Mapping[str, Any]], windows: Sequence[tuple[float, float]]) -> Floats:
    """Bound [deg] of each fault at each age (f, a)."""
    of_windows = np.degrees(fault_bound(study_sensor(), 1.0 / RATE, windows, AGES))
    starts = [start for start, _ in windows]
    return of_windows[[starts.index(fault["start"]) for fault in faults]]


def _spread(errors: Floats, unit: str) -> dict[str, float | None]:
    known = np.abs(errors[np.isfinite(errors)])
    if not len(known):
        return {f"rms{unit}": None, f"central{unit}": None}
    return {
        f"rms{unit}": number(np.sqrt(np.mean(known**2))),
        f"central{unit}": number(np.percentile(known, CENTRAL)),
    }


def _median(values: Floats) -> float | None:
    return median(values[np.isfinite(values)].tolist())


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
