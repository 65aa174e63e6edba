"""What a replay was worth, ready for ``summary.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from quadftc_flight.fault_schedule import (
    FaultEvent,
    FaultWindow,
    events_of_windows,
    fault_events,
    fault_windows,
    merge_events,
    merge_windows,
)
from quadftc_flight.flight import Flight
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.scenario import Fault
from quadftc_replay.diagnose import Diagnosed, flight_of
from quadftc_replay.observer import ChosenObserver
from quadftc_replay.recording import Recording

DIAGNOSIS = ("fault_", "diagnosis")  # how the metrics begin that make sense without a closed loop


def replay_windows(recording: Recording, faults: Sequence[Fault]) -> tuple[FaultWindow, ...]:
    """When the attitude is faulty, by what was recorded and by what was overlaid."""
    return merge_windows([*recording.fault_windows, *fault_windows(faults, recording.duration)])


def replay_events(recording: Recording, faults: Sequence[Fault]) -> tuple[FaultEvent, ...]:
    """Faults of the attitude axis by axis, by what was recorded and by what was overlaid."""
    recorded = recording.fault_events or events_of_windows(recording.fault_windows)
    return merge_events([*recorded, *fault_events(faults, recording.duration)])


def replay_metrics(
    flight: Flight, windows: Sequence[FaultWindow], events: Sequence[FaultEvent]
) -> dict[str, Any]:
    """Metrics of the diagnosis, as `flight_metrics` gives them; what takes a closed loop is None or gone."""
    found = flight_metrics(flight, windows, events)
    metrics = {name: value for name, value in found.items() if name.startswith(DIAGNOSIS)}
    metrics["fault_windows"] = [
        {name: value for name, value in window.items() if not name.startswith("tracking_")}
        for window in found["fault_windows"]
    ]
    return metrics


def replay_summary(
    recording: Recording,
    observer: ChosenObserver,
    faults: Sequence[Fault],
    seed: int,
    diagnosed: Diagnosed,
) -> dict[str, Any]:
    """Summarise a replay; the caller adds versions, times and warnings."""
    flight = flight_of(recording, diagnosed)
    imu = recording.imu
    return {
        "name": replay_name(recording, observer),
        "recording": recording.name,
        "topic": recording.topic,
        "observer": observer.name,
        "vehicle": observer.parameters["vehicle"],
        "parameters": observer.parameters,
        "faults": [fault.spec for fault in faults],
        "seed": seed,
        "truth": truth_text(recording, faults),
        "torque": recording.torque_topic or "zero: none recorded",
        "rate": recording.rate,
        "duration": recording.duration,
        "samples": len(recording),
        "samples_left_out": dict(recording.rejected),
        "samples_withheld": int((~diagnosed.delivered).sum()),
        "samples_without_attitude": int((~imu.attitude_valid).sum()),
        "samples_without_body_rate": int((~imu.rate_valid).sum()),
        "samples_without_estimate": diagnosed.no_number,
        "metrics": replay_metrics(
            flight, replay_windows(recording, faults), replay_events(recording, faults)
        ),
    }


def replay_name(recording: Recording, observer: ChosenObserver) -> str:
    """Name of a replay, of its directory and of its bag."""
    return f"{recording.name}-{observer.name}"


def truth_text(recording: Recording, faults: Sequence[Fault]) -> str:
    """Tell what the estimates are compared with."""
    parts = ["recorded"] * ("attitude" in recording.faults) + ["overlaid"] * bool(faults)
    return f"{' and '.join(parts)} faults" if parts else "no fault: the recording counts as healthy"
