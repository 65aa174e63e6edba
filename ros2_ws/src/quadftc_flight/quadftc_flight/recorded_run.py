"""A recorded flight: bag, scenario, scheme, parameters, flight and summary, checked against each other.

>>> for path in find_runs([Path("results")]):
...     run = read_run(path)
...     print(run.name, run.summary["metrics"]["tracking_rmse_deg"]["roll"])

A bag that was cut short is read up to the cut. `RecordedRun.warnings` says what was not as it should be.
Replays: `quadftc_replay.recorded_replay`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from quadftc_bags.bag import Bag, BagError, read_bag
from quadftc_flight.fault_schedule import FaultEvent
from quadftc_flight.flight import Flight, flight_from_bag
from quadftc_flight.recorded import Recorded, topics_text, versions_of, without_messages
from quadftc_flight.run_origin import (
    SCENARIO,
    SUMMARY,
    attached_text,
    beside,
    is_replay,
    read_origin,
    run_name,
)
from quadftc_flight.scenario import Fault, Part, Scenario, Scheme
from quadftc_flight.stored_summary import partial_summary, read_summary, whole_summary
from quadftc_flight.summary import summary

NEEDED = ("imu/data", "plant/attitude", "attitude/reference")  # topics; without one there is nothing to say
WANTED = (
    *("plant/rate", "fault/injected", "fault/estimate", "fault/status", "disturbance/applied"),
    *("disturbance/estimate", "torque/command", "control/status"),
)  # topics; without one its numbers are missing
END_SLACK = 0.02  # s; what may be missing at the end of a flight in real time


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRun(Recorded):
    """What is known of one run; in its summary no check counts if the flight ends early.

    Parameters
    ----------
    scenario : Scenario
        From the bag, or from the file beside it.
    scheme : Scheme
        The one that was flown.
    """

    scenario: Scenario
    scheme: Scheme

    @property
    def observer(self) -> str:
        """Name of the fault observer."""
        return self.scheme.observer.kind

    @property
    def disturbance_observer(self) -> str:
        """Name of the disturbance observer."""
        return self.scheme.disturbance_observer.kind

    @property
    def label(self) -> str:
        """Its scheme."""
        return self.scheme.name

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Faults of the scenario."""
        return self.scenario.faults

    @property
    def fault_events(self) -> tuple[FaultEvent, ...]:
        """When which axis of the attitude is faulty."""
        return self.scenario.fault_events

    @property
    def disturbances(self) -> tuple[Part, ...]:
        """Disturbances of the scenario."""
        return self.scenario.disturbances

    @property
    def duration(self) -> float:
        """How much of the flight was recorded [s]."""
        return min(self.scenario.duration, _recorded(self.flight, self.scenario))

    @property
    def is_whole(self) -> bool:
        """Whether the flight was recorded to its end."""
        return _is_whole(self.flight, self.scenario)


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Find runs: each path is a run (directory or ``.mcap`` file), or a directory of run directories.

    Those of one directory come in the order of their names; what else is in it is passed over. No run comes
    twice.

    Raises
    ------
    BagError
        If a path does not exist or holds no run.
    """
    if not paths:
        raise BagError("no runs given; expected bags, or directories of bags")
    found: dict[Path, Path] = {}
    for path in map(Path, paths):
        for run in _runs_at(path):
            found.setdefault(run.resolve(), run)
    return list(found.values())


def read_run(path: Path) -> RecordedRun:
    """Read one run and check its parts against each other.

    Parameters
    ----------
    path : Path
        Directory of the run, or its ``.mcap`` file; scenario, parameters and summary may lie beside it.

    Raises
    ------
    BagError
        If it is no bag, not one of this software's, or holds too little to be judged; one line.
    """
    return run_from_bag(read_bag(path))


def run_from_bag(bag: Bag) -> RecordedRun:
    """Make sense of the bag of a run; see `read_run`."""
    _require_run(bag)
    stored, broken = read_summary(beside(bag.path, SUMMARY))
    scenario, scheme, parameters, warnings = read_origin(bag, stored)
    flight = flight_from_bag(bag)
    warnings += _shortcomings(bag, flight, scenario)
    if _is_whole(flight, scenario):
        result, wrong = whole_summary(summary(flight, scenario, scheme, None), stored)
        disagreement = f"{bag.path}: {SUMMARY} disagrees with the bag, whose numbers count: {wrong}"
        warnings += [broken] * bool(broken) + [disagreement] * bool(wrong)
    else:
        result = partial_summary(flight, scenario, scheme, stored)
    return RecordedRun(
        name=run_name(bag.path),
        path=bag.path,
        bag=bag,
        scenario=scenario,
        scheme=scheme,
        parameters=parameters,
        flight=flight,
        summary=result,
        versions=versions_of(stored, bag),
        warnings=tuple(warnings),
    )


def _runs_at(path: Path) -> list[Path]:
    if not path.exists():
        raise BagError(f"{path}: no such file or directory")
    if path.is_file() or _is_run(path):
        return [path]
    try:
        runs = [entry for entry in sorted(path.iterdir()) if entry.is_dir() and _is_run(entry)]
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None
    if not runs:
        raise BagError(
            f"{path}: no run in this directory; expected metadata.yaml and an .mcap file, here or one below"
        )
    return runs


def _is_run(directory: Path) -> bool:
    return (directory / "metadata.yaml").is_file() or any(directory.glob("*.mcap"))


def _require_run(bag: Bag) -> None:
    """Refuse a bag that lacks what every run has."""
    if is_replay(bag):
        raise BagError(
            f"{bag.path}: a replay of a recording; expected a flight, which has a scenario and a controller"
        )
    topics = without_messages(bag, NEEDED)
    missing = [f"messages on {', '.join(topics)}"] if topics else []
    if attached_text(bag, SCENARIO) is None:
        missing.insert(0, f"{SCENARIO} (attached to the bag, or beside it)")
    if missing:
        what = "cut short before it holds a run" if bag.truncated else "no run or replay of quadftc"
        raise BagError(
            f"{bag.path}: {what}: missing {' and '.join(missing)}; topics with messages there:"
            f" {topics_text(bag)}{bag.remedy}"
        )


def _recorded(flight: Flight, scenario: Scenario) -> float:
    """How long the recorded flight is [s]; the samples still on their way at its end count as recorded."""
    return float(flight.time[-1]) + (1 + scenario.sensor.delay) / scenario.rate


def _is_whole(flight: Flight, scenario: Scenario) -> bool:
    return _recorded(flight, scenario) > scenario.duration - END_SLACK


def _shortcomings(bag: Bag, flight: Flight, scenario: Scenario) -> Iterator[str]:
    """What the recording lacks."""
    end = f"{min(_recorded(flight, scenario), scenario.duration):.1f} s of {scenario.duration:g} s"
    if not _is_whole(flight, scenario):
        what = "cut short" if bag.truncated else "flight ended early,"
        yield f"{bag.path}: {what} at {end}; read up to there{bag.remedy}"
    elif bag.truncated:
        yield f"{bag.path}: cut short behind the end of the flight; {end} are there{bag.remedy}"
    missing = without_messages(bag, WANTED)
    if missing:
        yield f"{bag.path}: no message on {', '.join(missing)}; their numbers are missing"
