"""Runs as if read from a bag, of flights that were flown or made up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from quadftc_bags.bag import Bag
from quadftc_flight.closed_loop import fly
from quadftc_flight.flight import Flight
from quadftc_flight.run_directory import RecordedRun
from quadftc_flight.scenario import Scenario
from quadftc_flight.summary import summary


def recorded_run(scenario: Scenario, scheme: str, flight: Flight | None = None, **known: Any) -> RecordedRun:
    """Return a run of a scheme; without a ``flight`` it is flown. ``known`` are fields of the run."""
    chosen = scenario.scheme(scheme)
    flown = flight or fly(scenario, chosen)
    return RecordedRun(
        name=f"{scenario.name}-{scheme}",
        path=Path(scheme),
        bag=Bag(Path(scheme)),
        scenario=scenario,
        scheme=chosen,
        flight=flown,
        summary=summary(flown, scenario, chosen, None),
        **{"parameters": {}, "versions": {}, **known},
    )
