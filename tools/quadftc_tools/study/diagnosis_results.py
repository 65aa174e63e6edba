"""From the tables of the campaigns to results: metrics, faults, operating characteristics, bound."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from quadftc_campaign.open_loop import AGES, WITHIN
from quadftc_campaign.table import whole_flights
from quadftc_flight.diagnosis_metrics import pool
from quadftc_flight.scenario import Scenario, load_scenario
from quadftc_model.spec import parse_spec
from quadftc_tools.study.bound import fault_bound

if TYPE_CHECKING:
    from jaxtyping import Float

TITLES = {
    "mems": "simulated MEMS IMU",
    "tactical": "simulated tactical IMU",
    "ahrs": "simulated attitude filter",
    "flips": "rolls and loops",
    "recordings": "recordings",
    "mems_one_axis": "simulated MEMS IMU, one axis at a time",
    "recordings_one_axis": "recordings, one axis at a time",
}  # of the campaigns that are judged by their faults
FIGURED = ("mems", "recordings")  # those with figures, and with tables of where they fail
BOUNDED = "supervised"  # whose error and standard deviation are held against the bound
CENTRAL = 68.27  # per cent of the errors of a Gaussian within one standard deviation
OF_FAULT = (
    *("axis", "kind", "start", "detected", "already_declared", "detection_delay_s", "above_threshold"),
    *("above_threshold_already", "above_threshold_delay_s", "estimate_rmse_deg", "estimate_max_deg"),
    *("errors_deg", "std_devs_deg"),
)  # what tables and figures need
SCENARIO = Path(__file__).resolve().parents[3] / "campaigns" / "scenarios" / "diagnosis.yaml"

Floats = NDArray[np.float64]
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


class Criteria(NamedTuple):
    """Bounds that an observer has to reach, None: no bound; no fault may be missed."""

    step_max_s: float | None
    ramp_median_s: float | None
    sine_median_s: float | None
    rmse_median_deg: float | None
    rmse_p95_deg: float | None  # beyond, a fault is badly estimated
    false_alarm_share: float  # of healthy time
    bins: dict[str, tuple[float, ...]] = {}  # kind -> edges of its sizes [deg, deg/s]


SMALL = (0.02, 0.5, 0.12, 0.08, 0.25, 0.0)  # for small faults
LARGE = (0.05, 1.5, 0.6, 0.3, 1.0, 0.005)  # for large ones, where the attitude has slow errors
CRITERIA = {
    "mems": Criteria(
        *SMALL,
        {"step": (0.5, 1.0, 2.0, 5.0), "ramp": (0.05, 0.1, 0.2, 0.5), "sine": (1.0, 1.5, 2.0, 3.0)},
    ),
    "tactical": Criteria(*SMALL),
    "ahrs": Criteria(*LARGE),
    "flips": Criteria(None, None, None, None, None, 0.0),
    "recordings": Criteria(
        *LARGE,
        {"step": (3.0, 5.0, 7.0, 10.0), "ramp": (0.2, 0.4, 0.7, 1.0), "sine": (3.0, 4.0, 5.0, 6.0)},
    ),
}


def setting_results(name: str, frame: pl.DataFrame, levels: pl.DataFrame | None, manifest: Json) -> Json:
    """Sum up one of the campaigns of `TITLES` by its table and its ``campaign.json``.

    ``levels`` is the table of its first flights with other levels of the detectors.
    """
    found = flown(TITLES[name], frame, manifest)
    bags = len(found["bags"])
    observers = found["observers"] = {each: sum_up(part, bags) for each, part in by_observer(frame).items()}
    if bags:
        rows = by_recording(frame.filter(pl.col("variant") == BOUNDED))
        found["each"] = {recording: sum_up(part, bags)["pooled"] for recording, part in rows.items()}
    if name in FIGURED:
        scenario = None if bags else load_scenario(SCENARIO)
        found["roc"] = characteristics(frame, levels)
        found["consistency"] = {
            observer: consistency(each["faults"], scenario) for observer, each in observers.items()
        }
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


def by_recording(frame: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Divide the table of a campaign by recording, in the order of their names."""
    names = frame["recording"].unique().sort()
    return {str(name): frame.filter(pl.col("recording") == name) for name in names}


def sum_up(frame: pl.DataFrame, bags: int = 0) -> dict[str, Any]:
    """Sum up the flights of one observer; ``bags`` is the number of recordings."""
    pooled = pool(diagnoses(frame))
    delays = frame["fault.recovery_delay_s"].drop_nulls().to_numpy()
    late = float(np.percentile(delays, 95.0)) if len(delays) else None
    return {"pooled": {**pooled, "recovery_delay_p95_s": {"all": late}}, "faults": faults_of(frame, bags)}


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


def faults_of(frame: pl.DataFrame, bags: int) -> list[dict[str, Any]]:
    """Return each fault: what was drawn, and how it was diagnosed."""
    found: list[dict[str, Any]] = []
    for row in frame.filter(pl.col("fault").is_not_null()).to_dicts():
        values = parse_spec(row["fault.spec"]).values
        size = next(float(values[key]) for key in ("value", "rate", "amplitude", "sigma") if key in values)
        frequency = float(values["frequency"]) if "frequency" in values else None
        flight = f"{row['recording']}/{row['flight'] // bags}" if bags else f"{row['flight']}"
        drawn = {"flight": flight, "size": float(np.degrees(size)), "frequency": frequency}
        found.append({**drawn, **{name: row[f"fault.{name}"] for name in OF_FAULT}})
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


def consistency(faults: Sequence[Json], scenario: Scenario | None) -> dict[str, list[float | None]]:
    """Error and reported standard deviation of the faults that are declared, at each of `AGES`.

    Returns
    -------
    dict
        ``declared``: share of the faults; ``rms_deg``, ``central_deg`` (within it are 68 % of the errors),
        ``std_dev_deg`` (median). With a scenario, which has a bound: ``bound_deg`` (median), and over the
        bound of each fault ``std_dev_over_bound`` (median), ``rms_over_bound``, ``central_over_bound``.
    """
    errors, std_devs = (
        np.array([fault[name] for fault in faults], np.float64).reshape(len(faults), len(AGES))
        for name in ("errors_deg", "std_devs_deg")
    )
    rows = {"declared": np.isfinite(errors).mean(axis=0).tolist(), **_spreads(errors, "_deg")}
    rows["std_dev_deg"] = _by_age(std_devs, _median)
    if scenario is not None:
        bound = _bounds(faults, scenario)
        rows["bound_deg"] = _by_age(bound, _median)
        rows["std_dev_over_bound"] = _by_age(std_devs / bound, _median)
        rows |= _spreads(errors / bound, "_over_bound")
    return rows


def _bounds(faults: Sequence[Json], scenario: Scenario) -> Float[Floats, "faults ages"]:
    """Bound [deg] of each fault at each age."""
    windows = [(window.start, window.stop) for window in scenario.fault_windows]
    of_windows = np.degrees(fault_bound(scenario.sensor, 1.0 / scenario.rate, windows, AGES))
    starts = [start for start, _ in windows]
    return of_windows[[starts.index(fault["start"]) for fault in faults]]


def _spreads(errors: Float[Floats, "faults ages"], unit: str) -> dict[str, list[float | None]]:
    return {
        f"rms{unit}": _by_age(errors, lambda known: math.sqrt(np.mean(known**2))),
        f"central{unit}": _by_age(np.abs(errors), lambda known: float(np.percentile(known, CENTRAL))),
    }


def _by_age(values: Float[Floats, "faults ages"], figure: Callable[[Floats], float]) -> list[float | None]:
    """A figure of the finite values of each age."""
    known = [column[np.isfinite(column)] for column in values.T]
    return [float(figure(column)) if len(column) else None for column in known]


def _median(values: Floats) -> float:
    return float(np.median(values))
