"""What a diagnosis was worth, in the words of the field; ``summary["metrics"]["diagnosis"]``.

A *fault event* is a time in which one axis of the attitude is faulty by schedule. An axis is *declared*
faulty in the states FAULTY and RECOVERING, *trusted* in HEALTHY and SUSPECT. It is *healthy* outside its
events and the grace after each (``GRACE_TIME``). Rows without a state do not count; a row stands for the
median time between two. What the size of the estimate alone would say is under ``by_estimate``, for observers
without a detector. Every metric: docs/diagnosis.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from quadftc_flight.diagnosis_metrics.columns import Columns
from quadftc_flight.diagnosis_metrics.faults import ESTIMATE_THRESHOLD_DEG, fault_record
from quadftc_flight.diagnosis_metrics.healthy import GRACE_TIME, alarm_metrics, estimate_alarm_metrics, truth
from quadftc_flight.diagnosis_metrics.isolation import isolation_metrics
from quadftc_flight.diagnosis_metrics.pooling import estimate_fault_metrics, fault_metrics, pool
from quadftc_flight.diagnosis_metrics.show import show_row, show_table
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight

__all__ = [
    "ESTIMATE_THRESHOLD_DEG",
    "GRACE_TIME",
    "diagnosis_metrics",
    "pool",
    "show_row",
    "show_table",
]


def diagnosis_metrics(flight: Flight, events: Sequence[FaultEvent]) -> dict[str, Any]:
    """Judge the diagnosis of a flight.

    Parameters
    ----------
    flight : Flight
    events : sequence of FaultEvent
        As `quadftc_flight.fault_schedule.fault_events` gives them: of one axis, none overlaps another.

    Returns
    -------
    dict
        Ready for JSON. ``events`` holds a record of each fault; the metrics of all faults have a value for
        each kind of fault and for ``all``; those of healthy time and isolation a value for each axis.
    """
    columns = Columns(flight)
    following = _following(events)
    records = [
        fault_record(columns, event, next_start) for event, next_start in zip(events, following, strict=True)
    ]
    by_state = truth(columns, events, [record["detected"] is not None for record in records])
    by_estimate = truth(columns, events, [record["above_threshold"] is not None for record in records])
    return {
        **fault_metrics(records),
        **alarm_metrics(columns, by_state),
        **isolation_metrics(columns, by_state, events),
        "by_estimate": {
            **estimate_fault_metrics(records),
            **estimate_alarm_metrics(columns, by_estimate),
        },
        "starting_share": columns.starting_share,
        "events": records,
    }


def _following(events: Sequence[FaultEvent]) -> list[float]:
    """When the next fault on the axis of each event begins [s]."""
    return [
        min(
            (other.start for other in events if other.axis == event.axis and other.start >= event.stop),
            default=math.inf,
        )
        for event in events
    ]
