"""Checks of a campaign: bounds on what came out over all flights.

| metric | is |
|---|---|
| ``flights``, ``not_finite``, ``lost`` | how many flights there were, and how many of them ended so |
| ``<metric>.<statistic>`` | of the flights, by axis where there are axes: ``tracking_rmse_deg.q95`` |
| ``faults.<kind>.<count>`` | ``count``, ``judged``, ``missed``, ``unnamed``, ``misnamed``, ``missed_share`` |
| ``faults.<kind>.<metric>.<statistic>`` | of single faults: ``faults.all.detection_delay_s.q95`` |

Statistics are ``mean``, ``min``, ``max`` and the quantiles ``q5`` to ``q99`` of `quadftc_campaign.table`; the
kind ``all`` is every fault.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from pydantic import Field

from quadftc_campaign.table import QUANTILES
from quadftc_flight.checks import check_results
from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.metrics import known_metrics
from quadftc_flight.scenario import Check, Problem
from quadftc_flight.summary import Summary
from quadftc_model.hints import nearest
from quadftc_model.samples import AXES

COUNTS = ("flights", "not_finite", "lost")
FAULT_COUNTS = ("count", "judged", "missed", "unnamed", "misnamed", "missed_share")
STATISTICS = ("mean", "min", "max", *(f"q{100 * q:g}" for q in QUANTILES))
FAULTS = "faults"


class CampaignCheck(Check):
    """A check of a campaign; without variants it holds for each."""

    variants: tuple[str, ...] = Field(default=(), strict=False)


def wrong_checks(checks: Sequence[CampaignCheck], variants: Iterable[str]) -> Iterator[Problem]:
    """Find checks on metrics or variants that no campaign has; which columns there are is known later."""
    names, known = list(variants), [*known_metrics(0), *COUNTS, FAULTS]
    for index, check in enumerate(checks):
        first, *rest = check.metric.split(".")
        last = rest[-1] if rest else ""
        ends = (*STATISTICS, *FAULT_COUNTS) if first == FAULTS else STATISTICS
        if first not in known:
            yield Problem(("checks", index, "metric"), f"no metric '{first}'{nearest(first, known)}")
        elif first not in COUNTS and last not in ends:
            said = f"'{check.metric}': expected one of {', '.join(ends)} at its end{nearest(last, ends)}"
            yield Problem(("checks", index, "metric"), said)
        for name in check.variants:
            if name not in names:
                yield Problem(("checks", index, "variants"), f"no '{name}'; there are: {', '.join(names)}")


def campaign_results(
    checks: Sequence[CampaignCheck], variants: Mapping[str, Summary]
) -> list[dict[str, object]]:
    """Hold checks against the summaries of variants; one result for each check, variant and axis."""
    return [
        {"variant": name, **result._asdict()}
        for name, summary in variants.items()
        for result in check_results(
            metrics_of(summary), [check for check in checks if not check.variants or name in check.variants]
        )
    ]


def metrics_of(summary: Summary) -> Metrics:
    """Return what checks see of the summary of a variant, as nested mappings."""
    faults = {
        kind: {
            **{name: part[name] for name in FAULT_COUNTS if name in part},
            "missed_share": part["missed"] / part["judged"] if part["judged"] else None,
            **_nested(part["metrics"], "fault."),
        }
        for kind, part in summary["faults"].items()
    }
    return {**{name: summary[name] for name in COUNTS}, **_nested(summary["metrics"]), FAULTS: faults}


def _nested(columns: Mapping[str, Metrics], prefix: str = "") -> Metrics:
    """Nest columns such as ``tracking_rmse_deg.roll``: words, statistic, axis."""
    found: Metrics = {}
    for column, values in columns.items():
        *words, last = column.removeprefix(prefix).split(".")
        axis = [last] if last in AXES else []
        for statistic, value in values.items():
            place = found
            *path, end = [*words, *([] if axis else [last]), statistic, *axis]
            for word in path:
                place = place.setdefault(word, {})
            place[end] = value
    return found
