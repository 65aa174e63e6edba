"""The directory of a replay: bag, what was replayed, estimates and summary, checked against each other.

A replay has no scenario, no reference and no controller: what there is to say is about the diagnosis.
Directories of flights: `quadftc_flight.run_directory`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import Annotated, Any, ClassVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_serializer

from quadftc_bags.bag import Bag, BagError
from quadftc_flight import run_directory
from quadftc_flight.fault_schedule import FaultEvent, FaultWindow, Time
from quadftc_flight.flight import Flight, ImuReadings, flight_from_bag, imu_readings_from_bag
from quadftc_flight.metrics import flight_metrics
from quadftc_flight.run_directory import DESCRIPTION, PARAMETERS, SUMMARY, RecordedRun, RunDirectory
from quadftc_flight.scenario import Fault, Part
from quadftc_flight.summary import NO_OBSERVER, compare_summaries, read_summary
from quadftc_replay.imu_recording import sampling_rate
from quadftc_replay.overlay import faults_from

NEEDED = ("imu/data", "fault/injected", "fault/estimate", "fault/status")  # topics
WANTED = ("imu/corrected",)  # topics; without one its figures are missing
MIN_SAMPLES = 2  # as many as a recording that is replayed has
DIAGNOSIS = ("fault_", "diagnosis", "sensors")  # how the metrics begin that make sense without a closed loop
YAML_WIDTH = 120  # characters


Count = Annotated[int, Field(ge=0, strict=True)]


class ReplayOrigin(BaseModel):
    """What was replayed, and through which observer; the bag holds it as YAML."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    recording: str  # its name
    topic: str  # full name of that of its IMU
    observer: str
    faults: list[str]  # specifications of the overlaid ones
    seed: Annotated[int, Field(strict=True)]  # of the overlaid faults
    torque: str  # which one the observer was told, in words
    truth: str  # what the estimates are compared with, in words
    duration: Time  # of the recording [s]
    samples: Count  # that were replayed, withheld ones among them
    samples_left_out: dict[str, Count]  # reason to the number of recorded samples that were not replayed
    fault_windows: tuple[FaultWindow, ...]  # when the attitude is faulty, recorded and overlaid
    fault_events: tuple[FaultEvent, ...]  # the same axis by axis, with the kind of fault

    @field_serializer("fault_windows", "fault_events")
    def _as_mappings(self, items: tuple[FaultWindow | FaultEvent, ...]) -> list[dict[str, object]]:
        return [item._asdict() for item in items]

    def description(self) -> str:
        """Write it as YAML."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False, width=YAML_WIDTH)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordedReplay(RunDirectory):
    """What is known of one replay."""

    origin: ReplayOrigin
    faults: tuple[Fault, ...]  # overlaid
    measured: ImuReadings  # what the observer saw, overlaid faults included; a row for each of the flight
    corrected: ImuReadings  # what it passed on

    disturbance_observer: ClassVar[str] = NO_OBSERVER
    disturbances: ClassVar[tuple[Part, ...]] = ()  # none is known

    observer = label = property(attrgetter("origin.observer"))  # tells it from those that it is compared with
    fault_events = property(attrgetter("origin.fault_events"))  # when which axis of the attitude is faulty

    @property
    def own_name(self) -> str:
        """Its name, without that of the recording."""
        return self.name.removeprefix(f"{self.origin.recording}-")

    @property
    def duration(self) -> float:
        """How much of the replay is there [s]."""
        return self.origin.duration if self.is_whole else float(self.flight.time[-1])

    @property
    def is_whole(self) -> bool:
        """Whether every sample that was replayed is there."""
        return len(self.flight) >= self.origin.samples


Recorded = RecordedRun | RecordedReplay


def replay_from_bag(bag: Bag) -> RecordedReplay:
    """Make sense of the bag of a replay, and hold the summary beside it against it.

    If it is none, or holds too little to be judged, BagError is raised; one line.
    """
    origin, faults = _read_origin(bag)
    if (text := run_directory.attached_text(bag, PARAMETERS)) is None:
        raise BagError(f"{bag.path}: a replay without {PARAMETERS} (attached to the bag, or beside it)")
    try:
        parameters = run_directory.parse_parameters(text)
    except run_directory.NO_PARAMETERS:
        raise BagError(f"{bag.path}: {PARAMETERS} makes no sense; expected a ROS parameter file") from None
    if missing := run_directory.without_messages(bag, NEEDED):
        what = "cut short before its first estimate" if bag.truncated else "without its data"
        there = f"topics with messages there: {run_directory.topics_text(bag)}{bag.remedy}"
        raise BagError(f"{bag.path}: a replay {what}: missing messages on {', '.join(missing)}; {there}")
    stored = read_summary(run_directory.beside(bag.path, SUMMARY))
    flight = flight_from_bag(bag)
    if len(flight) < MIN_SAMPLES:
        raise BagError(f"{bag.path}: a replay of {len(flight)} samples; expected at least {MIN_SAMPLES}")
    replay = RecordedReplay(
        name=run_directory.run_name(bag.path),
        path=bag.path,
        bag=bag,
        parameters=parameters,
        flight=flight,
        summary=replay_summary(origin, parameters.get("fault_observer", {}), flight),
        versions=run_directory.versions_of(stored.data, bag),
        origin=origin,
        faults=faults,
        measured=imu_readings_from_bag(bag, "imu/data", flight.stamp_ns),
        corrected=imu_readings_from_bag(bag, "imu/corrected", flight.stamp_ns),
    )
    # figures of a part are not those of the whole, which are stored
    summary, wrong = replay.summary, list[str]()
    if replay.is_whole:
        summary, wrong = compare_summaries(summary, stored, bag.path)
    return dataclasses.replace(replay, summary=summary, warnings=(*_shortcomings(replay), *wrong))


def replay_summary(origin: ReplayOrigin, observer: Mapping[str, object], flight: Flight) -> dict[str, Any]:
    """Summarise a replay, ready for JSON; of one that was cut short, what is there.

    ``observer`` are the parameters of the node that runs it.
    """
    duration, events = origin.duration, origin.fault_events
    if len(flight) < origin.samples:
        end = duration = float(flight.time[-1])
        events = tuple(each._replace(stop=min(each.stop, end)) for each in events if each.start < end)
    return {
        **origin.model_dump(exclude={"fault_windows", "fault_events"}),
        "vehicle": observer.get("vehicle"),
        "parameters": dict(observer),
        "rate": sampling_rate(flight.stamp_ns),
        "duration": duration,
        "samples": len(flight),
        "samples_withheld": int((~flight.delivered).sum()),
        "metrics": replay_metrics(flight, origin.fault_windows, events),
    }


def replay_metrics(
    flight: Flight, windows: Sequence[FaultWindow], events: Sequence[FaultEvent]
) -> dict[str, Any]:
    """Metrics of the diagnosis, as `flight_metrics` gives them; what takes a closed loop is None or gone."""
    found = flight_metrics(flight, windows, events)
    for window in found["fault_windows"]:
        for name in [name for name in window if name.startswith("tracking_")]:
            del window[name]
    return {name: value for name, value in found.items() if name.startswith(DIAGNOSIS)}


def _read_origin(bag: Bag) -> tuple[ReplayOrigin, tuple[Fault, ...]]:
    where, text = f"{bag.path}: {DESCRIPTION}", run_directory.attached_text(bag, DESCRIPTION) or ""
    try:
        origin = ReplayOrigin.model_validate(yaml.safe_load(text))
        return origin, faults_from((), origin.faults)
    except (yaml.YAMLError, RecursionError):
        raise BagError(f"{where} is no YAML") from None
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the file"
        raise BagError(f"{where}: {place}: {first['msg']}") from None
    except ValueError as error:
        raise BagError(f"{where}: {error}") from None


def _shortcomings(replay: RecordedReplay) -> Iterator[str]:
    whole = f"{replay.origin.duration:.1f} s"
    if not replay.is_whole:
        end = f"{replay.duration:.1f} s of {whole}"
        yield f"{replay.path}: cut short at {end}; read up to there{replay.bag.remedy}"
    elif replay.bag.truncated:
        yield f"{replay.path}: cut short behind the last sample; {whole} are there{replay.bag.remedy}"
    if missing := run_directory.without_messages(replay.bag, WANTED):
        yield f"{replay.path}: no message on {', '.join(missing)}; their figures are missing"
