"""Flights without a control loop: IMU samples with faults on them, through a fault observer alone.

The samples are simulated (`quadftc_campaign.open_motion`), or those of a recording whose IMU is healthy. The
faults are those of the scenario; on a recording that is too short for one of them, this one is left out.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import cast

import numpy as np

from quadftc_campaign.batch.engine import Progress
from quadftc_campaign.campaign_file import Campaign
from quadftc_campaign.flights import generator_of
from quadftc_campaign.open_motion import Alone, MovedImu, simulate
from quadftc_campaign.table import Row, Rows
from quadftc_fdi.observation import Observation
from quadftc_flight.diagnosis_metrics import GRACE_TIME
from quadftc_flight.diagnosis_metrics.columns import Metrics
from quadftc_flight.diagnosis_metrics.which_sensor import summed_confusion
from quadftc_flight.fault_schedule import attitude_events
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import Fault, Scenario
from quadftc_model.composition import Composition
from quadftc_model.guarded import Guarded
from quadftc_model.units import quantity
from quadftc_replay.diagnose import diagnose, flight_of
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_recording import Recording
from quadftc_replay.open_loop import OpenLoop
from quadftc_replay.overlay import replay_events

DELAY = "source.delay"
# those of tracking have no value here, but the reader looks for them
WHOLE_METRICS = ("tracking_rmse_deg", "tracking_max_deg", "fault_estimate_rmse_deg", "fault_estimate_max_deg")

_read_recording = functools.lru_cache(maxsize=2)(recording_from_bag)


def fly_open(
    campaign: Campaign, numbers: Sequence[int], scenarios: Sequence[Scenario], progress: Progress
) -> Iterator[tuple[Row, Rows]]:
    """Diagnose some flights of a campaign; yield the metrics of each flight and of its faults."""
    for number, scenario in zip(numbers, scenarios, strict=True):
        recording, faults, delay = prepare(campaign, number, scenario)
        law, injections = scenario.scheme(None).observer.law, [fault.injection for fault in faults]
        diagnosed = diagnose(recording, law, injections, scenario.seed, campaign.engine)
        flight = flight_of(recording, diagnosed)
        every = replay_events(recording, faults)
        metrics = flight_metrics(flight, (), every)
        diagnosis: Metrics = metrics["diagnosis"]
        records: Rows = diagnosis.pop("events")
        specs = {(axis, fault.injection.start): fault.spec for fault in faults for axis in fault.axes}
        for event, record in zip(attitude_events(every), records, strict=True) if records else ():
            record["spec"] = specs.get((event.axis, event.start))
        whole: Row = {
            DELAY: delay,
            "recording": recording.name,
            "finite": bool(np.isfinite(flight.fault_estimate[flight.delivered]).all()),
            **flatten({name: metrics[name] for name in WHOLE_METRICS}),
            **flatten(diagnosis),
            **summed_confusion(metrics["sensors"]),
        }
        progress(len(recording))
        yield whole, records


def loops_of(scenario: Scenario) -> list[Composition]:
    """Return what simulates and diagnoses the samples of a scenario."""
    injections = tuple(fault.injection.for_period(1.0 / scenario.rate) for fault in scenario.faults)
    observer = Guarded(Observation(scenario.scheme(None).observer.law))
    return [Alone(MovedImu.of(scenario)), OpenLoop(injections=injections, observer=observer)]


def prepare(campaign: Campaign, number: int, scenario: Scenario) -> tuple[Recording, list[Fault], float]:
    """Return samples without faults of flight ``number``, the faults to put on them, and their delay [s]."""
    delay, delays, bags = 0.0, campaign.source.delay, campaign.recordings
    if delays is not None:
        delay = quantity(delays.draw(generator_of(campaign, number, DELAY)), "s")
    recording = _read_recording(bags[number % len(bags)]) if bags else simulate(scenario, campaign.engine)
    end = recording.duration - GRACE_TIME if bags else scenario.duration
    faults: list[Fault] = []
    for injection, given in ((fault.injection, fault.given) for fault in scenario.faults):
        start, stop = (round(time + delay, 9) for time in (injection.start, injection.stop))
        if stop <= end:  # what the samples are too short for is left out
            faults.append(Fault(dataclasses.replace(injection, start=start, stop=stop), given))
    return recording, faults, delay


def flatten(nested: Mapping[str, object], prefix: str = "") -> Row:
    """Return nested mappings as one, with dotted names."""
    flat: Row = {}
    for name, value in nested.items():
        inside = cast("Mapping[str, object]", value) if isinstance(value, Mapping) else None
        flat |= {f"{prefix}{name}": value} if inside is None else flatten(inside, f"{prefix}{name}.")
    return flat
