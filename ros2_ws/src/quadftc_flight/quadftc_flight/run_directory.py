"""The directory of a run: bag, scenario, parameters, flight and summary, checked against each other.

>>> for path in find_runs([Path("results")]):
...     run = read_run(path)
...     print(run.name, run.summary["metrics"]["tracking_rmse_deg"]["roll"])

A bag that was cut short is read up to the cut. `RunDirectory.warnings` says what was not as it should be.
The directory of a replay holds the same, but for a scenario: `quadftc_replay.replay_directory`.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

import yaml

from quadftc_bags.bag import Bag, BagError, read_bag
from quadftc_flight.flight import Flight, flight_from_bag, has_messages
from quadftc_flight.scenario import Scenario, ScenarioError, Scheme, node_parameters, parse_scenario
from quadftc_flight.summary import Summary, compare_summaries, partial_summary, read_summary, summary

SCENARIO, PARAMETERS, SUMMARY = "scenario.yaml", "parameters.yaml", "summary.json"
DESCRIPTION = "replay.yaml"  # in place of the scenario: what was replayed
NEEDED = ("imu/data", "plant/attitude", "attitude/reference")  # topics; without one there is nothing to say
WANTED = (
    *("plant/rate", "fault/injected", "fault/estimate", "fault/status", "disturbance/applied"),
    *("disturbance/estimate", "torque/command", "control/status"),
)  # topics; without one its numbers are missing
END_SLACK = 0.02  # s; what may be missing at the end of a flight in real time

# what `parse_parameters` raises for a text that is no ROS parameter file
NO_PARAMETERS = (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError, RecursionError)

# node of a part of a scheme -> the parameter that names the component
_SELECTORS = {"fault_observer": "observer", "disturbance_observer": "observer", "controller": "controller"}

_MISSING = re.compile(r": no [a-z ]+ '\w+'.*; there are: ")  # how a registry refuses a name
_MISSING_OBSERVER = re.compile(
    r": schemes\.(?P<scheme>[^.:]+)\.(?P<role>(disturbance_)?observer)(\.kind)?: no [a-z ]+ '(?P<kind>\w+)'"
)

Parameters = dict[str, dict[str, object]]  # node, without its namespace, to its parameters


class MissingPartError(BagError):
    """A run with a component that is not installed here."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RunDirectory:
    """What a run or a replay leaves behind."""

    name: str  # of its directory, or of its file
    path: Path  # as it was given
    bag: Bag
    parameters: Parameters
    flight: Flight
    summary: Summary  # as in summary.json; of a recording that ends early it is about what is there
    versions: dict[str, str]  # what it was made with
    warnings: tuple[str, ...] = ()  # one line each

    @property
    def own_name(self) -> str:
        """What tells it from another with the same label."""
        return self.name


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RecordedRun(RunDirectory):
    """What is known of one run; in its summary no check counts if the flight ends early."""

    scenario: Scenario  # from the bag, or from the file beside it
    scheme: Scheme  # the one that was flown

    label = property(attrgetter("scheme.name"))  # tells it from those that it is compared with
    observer = property(attrgetter("scheme.observer.kind"))
    disturbance_observer = property(attrgetter("scheme.disturbance_observer.kind"))
    faults = property(attrgetter("scenario.faults"))  # on any channel
    fault_events = property(attrgetter("scenario.fault_events"))  # when which axis of which sensor is faulty
    disturbances = property(attrgetter("scenario.disturbances"))

    @property
    def duration(self) -> float:
        """How much of the flight was recorded [s]."""
        return min(self.scenario.duration, self._recorded_time)

    @property
    def is_whole(self) -> bool:
        """Whether the flight was recorded to its end."""
        return self._recorded_time > self.scenario.duration - END_SLACK

    @property
    def _recorded_time(self) -> float:
        """How long the flight is [s]; the samples still on their way at its end count as recorded."""
        return float(self.flight.time[-1]) + (1 + self.scenario.sensor.delay) / self.scenario.rate


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Find runs, each once: a path is a run (directory or ``.mcap`` file), or a directory of run directories.

    Those of one directory come in the order of their names. A path without any is a BagError.
    """
    if not paths:
        raise BagError("no runs given; expected bags, or directories of bags")
    found: dict[Path, Path] = {}
    for run in (run for path in paths for run in _runs_at(Path(path))):
        found.setdefault(run.resolve(), run)
    return list(found.values())


def read_run(path: Path) -> RecordedRun:
    """Read one run, its directory or its ``.mcap`` file; see `run_from_bag`."""
    return run_from_bag(read_bag(path))


def run_from_bag(bag: Bag) -> RecordedRun:
    """Check the parts of a run's bag and the files beside it against each other; BagError if it is no run."""
    _require_run(bag)
    stored = read_summary(beside(bag.path, SUMMARY))
    name, warnings = run_name(bag.path), list[str]()
    # what was flown: parameters that are lost are compiled from the scenario
    parameters: Parameters = read_parameters(bag, "took the parameters that the scenario gives", warnings)
    scenario = _read_scenario(bag, parameters, warnings)
    scheme = _find_scheme(scenario, parameters, (str(stored.data.get("scheme", "")), name), bag.path)
    if "name" not in scenario.raw:  # then it was the file's
        scenario = scenario.model_copy(update={"name": name.removesuffix(f"-{scheme.name}")})
    if not parameters:
        parameters = {node: dict(values) for node, values in node_parameters(scenario, scheme).items()}
    # the flight; the summary follows when it is known whether the flight is whole
    run = RecordedRun(
        name=name,
        path=bag.path,
        bag=bag,
        scenario=scenario,
        scheme=scheme,
        parameters=parameters,
        flight=flight_from_bag(bag),
        summary={},
        versions=versions_of(stored.data, bag),
    )
    warnings += _shortcomings(run)
    if run.is_whole:
        result, wrong = compare_summaries(summary(run.flight, scenario, scheme, None), stored, bag.path)
        warnings += wrong
    else:
        result = partial_summary(run.flight, scenario, scheme, stored.data)
    return dataclasses.replace(run, summary=result, warnings=tuple(warnings))


def run_name(path: Path) -> str:
    """Name of a run: its directory's, or its file's."""
    return path.stem.removesuffix("_0") if path.is_file() else path.resolve().name


def beside(path: Path, name: str) -> Path:
    """Return the file of that name beside a bag (directory or file)."""
    return (path if path.is_dir() else path.parent) / name


def attached_text(bag: Bag, name: str) -> str | None:
    """Return an attachment, else the file beside the bag; None without both, BagError if it is unreadable."""
    file = beside(bag.path, name)
    try:
        data = bag.attachments.get(name) or (file.read_bytes() if file.is_file() else b"")
        return data.decode("utf-8") or None
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{bag.path}: {name} cannot be read: {error}") from None


def is_replay(bag: Bag) -> bool:
    """Whether a bag, or a file beside it, says that it is a replay of a recording, not a flight."""
    return attached_text(bag, DESCRIPTION) is not None


def parse_parameters(text: str) -> Parameters:
    """Read a ROS parameter file; raises one of `NO_PARAMETERS` if it is none."""
    data: Any = yaml.safe_load(text)
    return {
        str(node).rpartition("/")[2]: dict(entry["ros__parameters"])
        for node, entry in cast("dict[str, Any]", data).items()
    }


def read_parameters(bag: Bag, instead: str, warnings: list[str]) -> Parameters:
    """Read the parameters of a bag; without any, a warning says what was done ``instead``."""
    text, problem = attached_text(bag, PARAMETERS), "is missing"
    try:
        if text is not None:
            return parse_parameters(text)
    except NO_PARAMETERS:
        problem = "makes no sense"
    warnings.append(f"{bag.path}: {PARAMETERS} {problem}; {instead}")
    return {}


def without_messages(bag: Bag, topics: Iterable[str]) -> list[str]:
    """Return those of the topics, relative to a namespace, that have no message."""
    return [topic for topic in topics if not has_messages(bag, topic)]


def topics_text(bag: Bag) -> str:
    """List the topics that have messages."""
    return ", ".join(sorted(name for name, topic in bag.topics.items() if topic.count)) or "none"


def versions_of(stored: Mapping[str, object], bag: Bag) -> dict[str, str]:
    """Return what a recording was made with: by its summary, else by the bag."""
    told = stored.get("versions")
    given = cast("dict[object, object]", told) if isinstance(told, dict) else bag.metadata.get("quadftc", {})
    return {str(key): str(value) for key, value in given.items() if key != "mode"}


def find_run(path: Path) -> Path:
    """Find the only run at a path; BagError if there are several, or as `find_runs`."""
    found = find_runs([path])
    if len(found) > 1:
        raise BagError(f"{path}: holds {len(found)} flights; give one of them, such as {found[0]}")
    return found[0]


def _runs_at(path: Path) -> list[Path]:
    if not path.exists():
        raise BagError(f"{path}: no such file or directory")
    if path.is_file() or _is_run(path):
        return [path]
    try:
        runs = [entry for entry in sorted(path.iterdir()) if entry.is_dir() and _is_run(entry)]
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from None
    if not runs and (path / "campaign.json").is_file():
        raise BagError(f"{path}: a campaign, whose report is {path / 'report.html'}; expected runs")
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
        wanted = "expected a flight, which has a scenario and a controller"
        raise BagError(f"{bag.path}: a replay of a recording; {wanted}")
    topics = without_messages(bag, NEEDED)
    missing = [f"messages on {', '.join(topics)}"] if topics else []
    if attached_text(bag, SCENARIO) is None:
        missing.insert(0, f"{SCENARIO} (attached to the bag, or beside it)")
    if missing:
        what = "cut short before it holds a run" if bag.truncated else "no run or replay of quadftc"
        there = f"topics with messages there: {topics_text(bag)}{bag.remedy}"
        raise BagError(f"{bag.path}: {what}: missing {' and '.join(missing)}; {there}")


def _read_scenario(bag: Bag, parameters: Parameters, warnings: list[str]) -> Scenario:
    """Parse the scenario; a vehicle's file, which it names from where it lay, is found by the parameters.

    Of an observer that is not installed here the name is all that is known: what it said is in the bag.
    """
    vehicle = parameters.get("plant", {}).get("vehicle")
    overrides = [f"vehicle={vehicle}"] if isinstance(vehicle, str) and vehicle.endswith(".toml") else []
    text, source = attached_text(bag, SCENARIO) or "", str(bag.path / SCENARIO)
    try:
        return parse_scenario(text, source, overrides)
    except ScenarioError as error:
        first, *others = lines = str(error).splitlines()
        words = f"{first} (and {len(others)} more)" if others else first
        if not all(_MISSING.search(line) for line in lines):
            raise BagError(words) from None
        missing = [found for line in lines if (found := _MISSING_OBSERVER.search(line))]
        if len(missing) < len(lines):
            raise MissingPartError(f"{words}; is the package installed that has it?") from None
    others = [f"schemes.{found['scheme']}.{found['role']}=none" for found in missing]
    scenario = parse_scenario(text, source, [*overrides, *others])
    schemes = dict(scenario.schemes)
    for found in missing:
        scheme, role = schemes[found["scheme"]], found["role"]
        named = dataclasses.replace(getattr(scheme, role), kind=found["kind"])
        schemes[found["scheme"]] = scheme.model_copy(update={role: named})
    kinds = ", ".join(sorted({found["kind"] for found in missing}))
    warnings.append(f"{bag.path}: {kinds}: not installed here; what it said is in the bag")
    return scenario.model_copy(update={"schemes": schemes})


def _find_scheme(scenario: Scenario, parameters: Parameters, names: tuple[str, str], path: Path) -> Scheme:
    """Tell which scheme was flown: the parameters name its components; the summary or the run names it."""
    by_summary, by_run = names
    ranks: dict[str, tuple[bool, ...]] = {}  # whether each hint fits, from the strongest to the weakest
    for name in scenario.schemes:
        compiled = node_parameters(scenario, name)
        wrong = {
            key
            for node in _SELECTORS
            for key, value in compiled[node].items()
            if parameters.get(node, {}).get(key, value) != value
        }
        is_flown = wrong.isdisjoint(_SELECTORS.values())
        ranks[name] = (is_flown, not wrong, name == by_summary, by_run.endswith(f"-{name}"))
    best = max(ranks.values())
    if not best[0]:
        raise BagError(f"{path}: {PARAMETERS} fits none of the schemes {', '.join(scenario.schemes)}")
    fitting = [name for name, rank in ranks.items() if rank == best]
    if len(fitting) > 1:
        wanted = f"expected {PARAMETERS}, 'scheme' in {SUMMARY}, or a name that ends with it"
        raise BagError(f"{path}: which of the schemes {', '.join(fitting)} was flown is not known; {wanted}")
    return scenario.schemes[fitting[0]]


def _shortcomings(run: RecordedRun) -> Iterator[str]:
    """Say what the recording lacks."""
    bag, end = run.bag, f"{run.duration:.1f} s of {run.scenario.duration:g} s"
    if not run.is_whole:
        what = "cut short" if bag.truncated else "flight ended early,"
        yield f"{bag.path}: {what} at {end}; read up to there{bag.remedy}"
    elif bag.truncated:
        yield f"{bag.path}: cut short behind the end of the flight; {end} are there{bag.remedy}"
    missing = without_messages(bag, WANTED)
    if missing:
        yield f"{bag.path}: no message on {', '.join(missing)}; their numbers are missing"
