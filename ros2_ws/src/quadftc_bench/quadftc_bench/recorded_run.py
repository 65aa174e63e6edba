"""A recorded run: bag, scenario, scheme, parameters, flight and summary, checked against each other.

>>> for path in find_runs([Path("results")]):
...     run = read_run(path)
...     print(run.name, run.summary["metrics"]["tracking_rmse_deg"]["roll"])

A bag that was cut short is read up to the cut. `RecordedRun.warnings` says what was not as it should be.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from quadftc_bench.bags import Bag, BagError, read_bag
from quadftc_bench.flight import Flight, flight_from_bag
from quadftc_bench.run_origin import SCENARIO, SUMMARY, attached_text, beside, read_origin, run_name
from quadftc_bench.scenario import Scenario, Scheme
from quadftc_bench.stored_summary import partial_summary, read_summary, whole_summary

NEEDED = ("imu/data", "plant/attitude", "attitude/reference")  # topics; without one there is nothing to say
WANTED = (
    *("plant/rate", "fault/injected", "fault/estimate", "fault/status", "disturbance/applied"),
    *("disturbance/estimate", "torque/command", "control/status"),
)  # topics; without one its numbers are missing
END_SLACK = 0.02  # s; what may be missing at the end of a flight in real time


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRun:
    """What is known of one run.

    Parameters
    ----------
    name : str
        Of its directory, or of its file.
    path : Path
        As it was given.
    bag : Bag
    scenario : Scenario
        From the bag, or from the file beside it.
    scheme : Scheme
        The one that was flown.
    parameters : dict
        Node name to its parameters: what the closed loop was made of.
    flight : Flight
    summary : dict
        As in ``summary.json``. Of a flight that ends early it is about what was recorded; no check counts
        then: ``checks`` is empty and ``passed`` None.
    versions : dict
        What the run was made with.
    warnings : tuple of str
        One line each.
    """

    name: str
    path: Path
    bag: Bag
    scenario: Scenario
    scheme: Scheme
    parameters: dict[str, dict[str, Any]]
    flight: Flight
    summary: dict[str, Any]
    versions: dict[str, str]
    warnings: tuple[str, ...] = ()

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
    bag = read_bag(path)
    _require_run(bag)
    stored, broken = read_summary(beside(bag.path, SUMMARY))
    scenario, scheme, parameters, warnings = read_origin(bag, stored)
    flight = flight_from_bag(bag)
    warnings += _shortcomings(bag, flight, scenario)
    if _is_whole(flight, scenario):
        result, wrong = whole_summary(flight, scenario, scheme, stored)
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
        versions=_versions(stored, bag),
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
    topics = _without_messages(bag, NEEDED)
    missing = [f"messages on {', '.join(topics)}"] if topics else []
    if attached_text(bag, SCENARIO) is None:
        missing.insert(0, f"{SCENARIO} (attached to the bag, or beside it)")
    if missing:
        what = "cut short before it holds a run" if bag.truncated else "no run of quadftc"
        there = ", ".join(sorted(name for name, topic in bag.topics.items() if topic.count)) or "none"
        raise BagError(
            f"{bag.path}: {what}: missing {' and '.join(missing)}; topics with messages there: {there}"
        )


def _without_messages(bag: Bag, topics: Iterable[str]) -> list[str]:
    full = [f"/{name.strip('/')}" for name, topic in bag.topics.items() if topic.count]
    return [topic for topic in topics if not any(name.endswith(f"/{topic}") for name in full)]


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
        yield f"{bag.path}: {what} at {end}; read up to there"
    elif bag.truncated:
        yield f"{bag.path}: cut short behind the end of the flight; {end} are there"
    missing = _without_messages(bag, WANTED)
    if missing:
        yield f"{bag.path}: no message on {', '.join(missing)}; their numbers are missing"


def _versions(stored: Mapping[str, Any], bag: Bag) -> dict[str, str]:
    given: Any = stored.get("versions")
    if not isinstance(given, dict):
        given = bag.metadata.get("quadftc", {})
    return {str(key): str(value) for key, value in cast("dict[Any, Any]", given).items() if key != "mode"}
