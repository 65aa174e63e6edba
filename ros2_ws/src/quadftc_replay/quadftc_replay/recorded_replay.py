"""A replay of a recording: bag, what was replayed, estimates and summary, checked against each other.

It has no scenario, no reference and no controller: what there is to say is about the diagnosis. Bags of
flights: `quadftc_flight.recorded_run`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from quadftc_bags.bag import Bag, BagError
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight, Reading, flight_from_bag, reading_from_bag
from quadftc_flight.recorded import NO_OBSERVER, Recorded, topics_text, versions_of, without_messages
from quadftc_flight.run_origin import SUMMARY, beside, run_name
from quadftc_flight.scenario import Fault, Part
from quadftc_flight.stored_summary import read_summary, whole_summary
from quadftc_model.stepper import NANOSECONDS_PER_SECOND
from quadftc_replay.replay_origin import ReplayOrigin, read_replay_origin
from quadftc_replay.results import replay_metrics

NEEDED = ("imu/data", "fault/injected", "fault/estimate", "fault/status")  # topics
WANTED = ("imu/corrected",)  # topics; without one its figures are missing
MIN_SAMPLES = 2  # as many as a recording that is replayed has


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordedReplay(Recorded):
    """What is known of one replay.

    Parameters
    ----------
    origin : ReplayOrigin
        What was replayed.
    measured, corrected : Reading
        What the observer saw, overlaid faults included, and what it passed on; a row for each of the flight.
    """

    origin: ReplayOrigin
    measured: Reading
    corrected: Reading

    @property
    def observer(self) -> str:
        """Name of the fault observer."""
        return self.origin.observer

    @property
    def disturbance_observer(self) -> str:
        """None: a replay has no use for it."""
        return NO_OBSERVER

    @property
    def label(self) -> str:
        """Its observer."""
        return self.origin.observer

    @property
    def own_name(self) -> str:
        """Its name, without that of the recording."""
        return self.name.removeprefix(f"{self.origin.recording}-")

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults that were overlaid."""
        return self.origin.faults

    @property
    def fault_events(self) -> tuple[FaultEvent, ...]:
        """When which axis of the attitude is faulty, by what was recorded and by what was overlaid."""
        return self.origin.fault_events

    @property
    def disturbances(self) -> tuple[Part, ...]:
        """None is known."""
        return ()

    @property
    def duration(self) -> float:
        """How much of the replay is there [s]."""
        return self.origin.duration if self.is_whole else float(self.flight.time[-1])

    @property
    def is_whole(self) -> bool:
        """Whether every sample that was replayed is there."""
        return len(self.flight) >= self.origin.samples


def replay_from_bag(bag: Bag) -> RecordedReplay:
    """Make sense of the bag of a replay, and hold the summary beside it against it.

    Raises
    ------
    BagError
        If it is none, or holds too little to be judged; one line.
    """
    origin = read_replay_origin(bag)
    _require_replay(bag)
    stored, broken = read_summary(beside(bag.path, SUMMARY))
    flight = flight_from_bag(bag)
    if len(flight) < MIN_SAMPLES:
        raise BagError(f"{bag.path}: a replay of {len(flight)} samples; expected at least {MIN_SAMPLES}")
    replay = RecordedReplay(
        name=run_name(bag.path),
        path=bag.path,
        bag=bag,
        parameters=origin.parameters,
        flight=flight,
        summary={},
        versions=versions_of(stored, bag),
        origin=origin,
        measured=reading_from_bag(bag, "imu/data", flight.stamp_ns),
        corrected=reading_from_bag(bag, "imu/corrected", flight.stamp_ns),
    )
    warnings = [*_shortcomings(replay)]
    result = _summary(replay)
    if replay.is_whole:
        result, wrong = whole_summary(result, stored)
        disagreement = f"{bag.path}: {SUMMARY} disagrees with the bag, whose numbers count: {wrong}"
        warnings += [broken] * bool(broken) + [disagreement] * bool(wrong)
    return dataclasses.replace(replay, summary=result, warnings=tuple(warnings))


def _require_replay(bag: Bag) -> None:
    missing = without_messages(bag, NEEDED)
    if missing:
        what = "cut short before its first estimate" if bag.truncated else "without its data"
        raise BagError(
            f"{bag.path}: a replay {what}: missing messages on {', '.join(missing)}; topics with messages"
            f" there: {topics_text(bag)}{bag.remedy}"
        )


def _shortcomings(replay: RecordedReplay) -> Iterator[str]:
    """What the bag lacks."""
    whole = f"{replay.origin.duration:.1f} s"
    if not replay.is_whole:
        end = f"{replay.duration:.1f} s of {whole}"
        yield f"{replay.path}: cut short at {end}; read up to there{replay.bag.remedy}"
    elif replay.bag.truncated:
        yield f"{replay.path}: cut short behind the last sample; {whole} are there{replay.bag.remedy}"
    missing = without_messages(replay.bag, WANTED)
    if missing:
        yield f"{replay.path}: no message on {', '.join(missing)}; their figures are missing"


def _summary(replay: RecordedReplay) -> dict[str, Any]:
    """What ``summary.json`` says of a replay, as far as the bag tells it."""
    origin, flight = replay.origin, replay.flight
    observer: Mapping[str, Any] = replay.parameters.get("fault_observer", {})
    return {
        "recording": origin.recording,
        "topic": origin.topic,
        "observer": origin.observer,
        "vehicle": observer.get("vehicle"),
        "parameters": dict(observer),
        "faults": [fault.spec for fault in origin.faults],
        "seed": origin.seed,
        "truth": origin.truth,
        "torque": origin.torque,
        "rate": _rate(flight),
        "duration": replay.duration,
        "samples": len(flight),
        "samples_left_out": dict(origin.left_out),
        "samples_withheld": int((~flight.delivered).sum()),
        "metrics": replay_metrics(flight, origin.fault_windows, _events(replay)),
    }


def _rate(flight: Flight) -> float:
    """One over the median time between two samples [Hz]."""
    return NANOSECONDS_PER_SECOND / float(np.median(np.diff(flight.stamp_ns)))


def _events(replay: RecordedReplay) -> list[FaultEvent]:
    """The events that the replay reaches; the last is cut where the replay is."""
    if replay.is_whole:
        return list(replay.fault_events)
    end = replay.duration
    return [event._replace(stop=min(event.stop, end)) for event in replay.fault_events if event.start < end]
