"""Checks: bounds on metrics that a flight, a replay or a campaign has to keep, and what became of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from pydantic import ValidationError

from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.metrics import entries, known_metrics, look_up
from quadftc_flight.scenario import Check, Problem, Scenario
from quadftc_model.samples import AXES
from quadftc_model.spec import parse_spec

BOUNDS = ("above", "below")


class CheckResult(NamedTuple):
    """What became of a check on one axis."""

    metric: str  # dotted path in ``summary["metrics"]``
    axis: str | None  # None for a metric that has no axes
    value: float | None  # None: the metric has no value here
    bound: str  # what was required, in words
    passed: bool


def parse_check(spec: str) -> Check:
    """Read a check such as ``tracking_rmse_deg axis=roll below=0.1``; a ValueError says what is wrong."""
    metric, values = parse_spec(spec)
    try:
        given = {key: float(str(value)) if key in BOUNDS else value for key, value in values.items()}
        return Check.model_validate({"metric": metric, **given})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        said = first["msg"].removeprefix("Value error, ")
        raise ValueError(f"check '{spec}': {place}{': ' if place else ''}{said}") from None
    except (TypeError, ValueError):
        raise ValueError(f"check '{spec}': expected numbers as {' and '.join(BOUNDS)}") from None


def refuse_wrong_checks(scenario: Scenario) -> None:
    """Raise a ScenarioError if there are checks on metrics that no flight of a scenario has."""
    if problems := list(_wrong_checks(scenario)):
        raise scenario.document.error(problems)


def _wrong_checks(scenario: Scenario) -> Iterator[Problem]:
    """Find the checks on metrics that no flight of this scenario has."""
    checks = [
        (("schemes", name, "checks", index), check)
        for name, scheme in scenario.schemes.items()
        for index, check in enumerate(scheme.checks)
    ]
    events = scenario.fault_events, scenario.rotor_events
    known = len(scenario.fault_windows), *events, scenario.rotors
    metrics = known_metrics(*known) if checks else {}
    for path, check in checks:
        if (problem := problem_of(check, metrics)) is not None:
            key, message = problem
            yield Problem((*path, key), message)


def problem_of(check: Check, metrics: Metrics) -> tuple[str, str] | None:
    """Return the wrong key of a check and what is wrong with it, held against the metrics that there are."""
    try:
        found = look_up(metrics, check.metric)
    except KeyError as error:
        return "metric", str(error.args[0])
    has_axes = isinstance(found, dict) and set(found) == set(AXES)
    if check.axis is not None and not has_axes:
        return "axis", f"'{check.metric}' has no axes"
    if not has_axes and found is not None and not isinstance(found, (int, float)):
        return "metric", f"'{check.metric}' is no number"
    return None


def check_results(metrics: Metrics, checks: Iterable[Check]) -> list[CheckResult]:
    """Hold checks against metrics: one result for each check and axis. What has no value fails."""
    results: list[CheckResult] = []
    for check in checks:
        try:
            found = look_up(metrics, check.metric)
        except KeyError:
            found = None
        low = -math.inf if check.above is None else check.above
        high = math.inf if check.below is None else check.below
        bound = f"between {low:g} and {high:g}"
        if math.isinf(low) or math.isinf(high):
            bound = f"below {high:g}" if math.isinf(low) else f"above {low:g}"
        values = dict(entries(found))
        for axis in AXES if values and check.axis is None else (check.axis,):
            raw = values.get(str(axis)) if values else found
            value = float(raw) if isinstance(raw, (int, float)) else None
            passed = value is not None and low < value < high
            results.append(CheckResult(check.metric, axis, value, bound, passed))
    return results
