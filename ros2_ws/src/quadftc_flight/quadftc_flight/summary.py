"""The summary of a run, as `summary.json` holds it, and the verdict on the checks of its scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, cast

from quadftc_flight.flight import Flight
from quadftc_flight.metrics import flight_metrics, look_up
from quadftc_flight.scenario.types import Check, Scenario, Scheme
from quadftc_model.samples import AXES


@dataclasses.dataclass(frozen=True)
class CheckResult:
    """What became of a check on one axis.

    Parameters
    ----------
    metric : str
        Dotted path in ``summary["metrics"]``.
    axis : str, optional
        None for a metric that has no axes.
    value : float, optional
        None: the metric has no value here.
    bound : str
        What was required, in words.
    passed : bool
    """

    metric: str
    axis: str | None
    value: float | None
    bound: str
    passed: bool

    def __str__(self) -> str:
        name = self.metric if self.axis is None else f"{self.metric} ({self.axis})"
        value = "no value" if self.value is None else f"{self.value:.4g}"
        return f"{'passed' if self.passed else 'FAILED'}: {name}: {value}, required {self.bound}"


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


def check_results(summary: Mapping[str, Any], checks: Iterable[Check]) -> list[CheckResult]:
    """Hold checks against a summary: one result for each check and axis. What has no value fails."""
    return [result for check in checks for result in _results(summary["metrics"], check)]


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
    passed = value is not None and _above(value, check.above) and _below(value, check.below)
    return CheckResult(check.metric, axis, value, _bound(check), passed)


def _above(value: float, bound: float | None) -> bool:
    return bound is None or value > bound


def _below(value: float, bound: float | None) -> bool:
    return bound is None or value < bound


def _bound(check: Check) -> str:
    if check.above is None:
        return f"below {check.below:g}"
    if check.below is None:
        return f"above {check.above:g}"
    return f"between {check.above:g} and {check.below:g}"
