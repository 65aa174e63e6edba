"""The summary of a run, as `summary.json` holds it, its checks, and the comparison with a stored one."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

from quadftc_flight.flight import Flight
from quadftc_flight.metrics import entries, flight_metrics, look_up
from quadftc_flight.scenario import Check, Scenario, Scheme
from quadftc_model.samples import AXES

ROUNDING = 1e-6  # relative; the same metrics on another processor differ by less
SHOWN = 3  # disagreements named in a warning

_TIMING = ("wall_time_s", "real_time_factor")  # entries that a bag cannot tell


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """What became of a check on one axis."""

    metric: str  # dotted path in ``summary["metrics"]``
    axis: str | None  # None for a metric that has no axes
    value: float | None  # None: the metric has no value here
    bound: str  # what was required, in words
    passed: bool

    def __str__(self) -> str:
        name = self.metric if self.axis is None else f"{self.metric} ({self.axis})"
        value = "no value" if self.value is None else f"{self.value:.4g}"
        return f"{'passed' if self.passed else 'FAILED'}: {name}: {value}, required {self.bound}"


class StoredSummary(NamedTuple):
    """The summary beside a bag."""

    data: dict[str, Any]  # empty if there is none
    problem: str  # what is wrong with the file, if anything


def summary(flight: Flight, scenario: Scenario, scheme: Scheme, wall_time: float | None) -> dict[str, Any]:
    """Summarise a flight, ready for JSON; the caller adds versions and paths.

    Parameters
    ----------
    flight : Flight
    scenario, scheme : Scenario, Scheme
        What was flown.
    wall_time : float, optional
        How long it took [s].
    """
    result: dict[str, Any] = {
        "name": scenario.name,
        "scheme": scheme.name,
        "observer": scheme.observer.kind,
        "disturbance_observer": scheme.disturbance_observer.kind,
        "controller": scheme.controller.kind,
        "vehicle": scenario.vehicle,
        "rate": scenario.rate,
        "duration": scenario.duration,
        "seed": scenario.seed,
        "samples": len(flight),
        "samples_withheld": int((~flight.delivered).sum()),
        "wall_time_s": wall_time,
        "real_time_factor": scenario.duration / wall_time if wall_time else None,
        "metrics": flight_metrics(flight, scenario.fault_windows, scenario.fault_events),
    }
    results = check_results(result, scheme.checks)
    result["checks"] = [dataclasses.asdict(item) for item in results]
    result["passed"] = all(item.passed for item in results)
    return result


def partial_summary(
    flight: Flight, scenario: Scenario, scheme: Scheme, stored: Mapping[str, Any]
) -> dict[str, Any]:
    """Summarise what was recorded of a flight; the checks, made for all of it, do not count."""
    unchecked = scheme.model_copy(update={"checks": ()})
    origin = {key: stored[key] for key in ("mode", "graph") if isinstance(stored.get(key), str)}
    return {**origin, **summary(flight, scenario, unchecked, None), "passed": None}


def check_results(summary: Mapping[str, Any], checks: Iterable[Check]) -> list[CheckResult]:
    """Hold checks against a summary: one result for each check and axis. What has no value fails."""
    return [result for check in checks for result in _results(summary["metrics"], check)]


def read_summary(file: Path) -> StoredSummary:
    """Read the summary beside a bag."""
    if not file.is_file():
        return StoredSummary({}, f"{file}: missing; computed from the bag")
    try:
        data: Any = json.loads(file.read_text("utf-8"), parse_constant=_refuse_constant)
    except (OSError, ValueError, RecursionError) as error:
        return StoredSummary({}, f"{file}: broken ({type(error).__name__}); computed from the bag")
    if not isinstance(data, dict):
        return StoredSummary({}, f"{file}: no mapping; computed from the bag")
    return StoredSummary(cast("dict[str, Any]", data), "")


def compare_summaries(
    computed: dict[str, Any], stored: StoredSummary, path: Path
) -> tuple[dict[str, Any], list[str]]:
    """Return the summary of a whole recording, and warnings.

    Parameters
    ----------
    computed : dict
        From the bag; counts where they differ.
    stored : StoredSummary
        What lies beside the bag; counts where they agree, and has entries of its own.
    path : Path
        Of the bag.
    """
    if not stored.data:
        return computed, [stored.problem] * bool(stored.problem)
    wrong = [
        place
        for key, value in computed.items()
        if key not in _TIMING
        for place in _differences(stored.data.get(key), value, key)
    ]
    if not wrong:
        return dict(stored.data), []
    more = f" and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
    places = ", ".join(wrong[:SHOWN]) + more
    timing = {key: stored.data[key] for key in _TIMING if isinstance(stored.data.get(key), (int, float))}
    warning = f"{path}: summary.json disagrees with the bag, whose numbers count: {places}"
    return {**stored.data, **computed, **timing}, [warning]


def _results(metrics: Any, check: Check) -> Iterator[CheckResult]:
    try:
        found: Any = look_up(metrics, check.metric)
    except KeyError:
        found = None
    if not isinstance(found, dict):
        yield _result(check, check.axis, found)
        return
    values = cast("dict[str, Any]", found)
    for axis in AXES if check.axis is None else (check.axis,):
        yield _result(check, axis, values.get(axis))


def _result(check: Check, axis: str | None, found: Any) -> CheckResult:
    value = float(found) if isinstance(found, (int, float)) else None
    above = -math.inf if check.above is None else check.above
    below = math.inf if check.below is None else check.below
    return CheckResult(check.metric, axis, value, _bound(check), value is not None and above < value < below)


def _bound(check: Check) -> str:
    if check.above is None:
        return f"below {check.below:g}"
    if check.below is None:
        return f"above {check.above:g}"
    return f"between {check.above:g} and {check.below:g}"


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not finite")


def _is_near(stored: float, computed: float) -> bool:
    """Whether two numbers differ by rounding only; an int may be beyond all floats."""
    try:
        return math.isclose(stored, computed, rel_tol=ROUNDING, abs_tol=1e-9)
    except OverflowError:
        return False


def _differences(stored: Any, computed: Any, place: str) -> Iterator[str]:
    """Yield the dotted paths at which two summaries differ by more than rounding."""
    ours, theirs = dict(entries(computed)), dict(entries(stored))
    is_same_kind = type(stored) is type(computed)
    if is_same_kind and (isinstance(computed, dict) or (ours and len(ours) == len(theirs))):
        for key, value in ours.items():
            yield from _differences(theirs.get(key), value, f"{place}.{key}")
    elif isinstance(computed, float) and isinstance(stored, (int, float)):
        if not _is_near(stored, computed):
            yield place
    elif stored != computed:
        yield place
