"""A replay before it runs: what is replayed, through which observer, with which faults."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import yaml

from quadftc_bags.bag import BagError
from quadftc_fdi.fault_observer import FaultObserver, fault_observer_from, fault_observers
from quadftc_flight.checks import check_results, problem_of
from quadftc_flight.metrics import flight_of_nothing
from quadftc_flight.scenario import Check, Fault, parse_value
from quadftc_model.assembly import get, node_values
from quadftc_model.vehicle import load_vehicle
from quadftc_replay.diagnose import Diagnosed, Progress, diagnose, flight_of
from quadftc_replay.imu_from_bag import recording_from_bag
from quadftc_replay.imu_from_log import recording_from_log
from quadftc_replay.imu_recording import Recording
from quadftc_replay.overlay import faults_from, replay_events, replay_windows
from quadftc_replay.readers import ONLY_ONE, LogChoice
from quadftc_replay.replay_directory import YAML_WIDTH, ReplayOrigin, replay_metrics, replay_summary

BAGS = (".mcap", ".db3", ".bag")
DEFAULT_OBSERVER = "supervised"
DEFAULT_VEHICLE = "qball_x4"
# parameters of observers to which they matter
FROM_GYRO, LAG, FEELS = "attitude_from_gyro", "rotor_lag", "feels_gravity"
PREFIX = "observer."  # of a parameter that is set


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """What to replay, and how."""

    topic: str = ""  # of the IMU (of a log: its gyro); empty: see `recording_from_bag`
    choice: LogChoice = ONLY_ONE  # which log of a file, and how it is read
    observer: str = ""  # empty: as recorded, see `choose_observer`
    settings: tuple[str, ...] = ()  # ``observer.<parameter>=value``
    vehicle: str = ""  # empty: as recorded
    faults: tuple[str, ...] = ()  # specifications of faults to overlay
    fault_files: tuple[Path, ...] = ()  # YAML files with such; they come first
    seed: int = 0  # of the random faults
    skip_backwards: bool = False  # leave out samples whose stamp goes back, instead of refusing the recording
    checks: tuple[Check, ...] = ()  # on the metrics of the replay
    engine: str = "c"  # what runs the laws: "c" or "numpy"


class ChosenObserver(NamedTuple):
    """A fault observer, and the parameters of the node that would run it: all of them, in SI."""

    name: str
    law: FaultObserver
    parameters: dict[str, object]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Replay:
    """A replay with every part built."""

    recording: Recording
    observer: ChosenObserver
    faults: tuple[Fault, ...]
    seed: int
    checks: tuple[Check, ...] = ()
    engine: str = "c"  # what runs the laws: "c" or "numpy"

    @property
    def name(self) -> str:
        """Name of its directory and of its bag."""
        return f"{self.recording.name}-{self.observer.name}"

    @functools.cached_property
    def origin(self) -> ReplayOrigin:
        """What is replayed, as the bag will tell it."""
        recording, faults = self.recording, self.faults
        truth = ["recorded"] * ("attitude" in recording.faults) + ["overlaid"] * bool(faults)
        return ReplayOrigin(
            recording=recording.name,
            topic=recording.topic,
            observer=self.observer.name,
            faults=[fault.spec for fault in faults],
            seed=self.seed,
            torque=recording.torque_topic or "unknown: none recorded",
            truth=f"{' and '.join(truth)} faults" if truth else "no fault: the recording counts as healthy",
            duration=recording.duration,
            samples=len(recording),
            samples_left_out=dict(recording.rejected),
            fault_windows=replay_windows(recording, faults),
            fault_events=replay_events(recording, faults),
        )

    def diagnose(self, progress: Progress | None = None) -> Diagnosed:
        """Run it."""
        injections = tuple(fault.injection for fault in self.faults)
        return diagnose(self.recording, self.observer.law, injections, self.seed, self.engine, progress)

    def summary(self, diagnosed: Diagnosed) -> dict[str, object]:
        """Summarise what came out, ready for ``summary.json``; the caller adds versions and times."""
        flight, imu = flight_of(self.recording, diagnosed), self.recording.imu
        result = replay_summary(self.origin, self.observer.parameters, flight)
        metrics = result.pop("metrics")
        without = {
            "samples_without_attitude": int((~imu.attitude_valid).sum()),
            "samples_without_body_rate": int((~imu.rate_valid).sum()),
            "samples_without_estimate": diagnosed.unusable,
        }
        checks = check_results(metrics, self.checks)
        judged = {
            "checks": [each._asdict() for each in checks],
            "passed": all(each.passed for each in checks),
        }
        return {"name": self.name, **result, **without, "metrics": metrics, **judged}

    def parameter_file(self) -> str:
        """Write the parameters of the nodes that would do the same in the graph, as YAML for ROS."""
        faults = {"faults": self.origin.faults} if self.faults else {}
        nodes = {"fault_injector": {"seed": self.seed, **faults}, "fault_observer": self.observer.parameters}
        namespace = self.recording.namespace
        entries = {f"{namespace}{node}": {"ros__parameters": values} for node, values in nodes.items()}
        return yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, width=YAML_WIDTH)


def plan_replay(path: Path, options: ReplayOptions) -> Replay:
    """Read a recording and build everything; nothing is written.

    It is a bag of ROS 2 or ROS 1 or a log of any format that `readers` knows. A ValueError says why it cannot
    be used (`BagError`), or which option is wrong.
    """
    faults = faults_from(options.fault_files, options.faults)
    if options.seed < 0:
        raise ValueError(f"seed = {options.seed}: must not be negative")
    recording = read_recording(path, options.topic, options.skip_backwards, options.choice)
    for fault in faults:  # one that starts after the end would not act
        if (start := fault.injection.start) >= recording.duration:
            bound = f"must be before the end of {recording.name}, {recording.duration:.3f} s"
            raise ValueError(f"fault '{fault.said}': start = {start:g} s: {bound}")
    observer = choose_observer(recording, options.observer, options.vehicle, options.settings)
    plan = Replay(
        recording=recording,
        observer=observer,
        faults=faults,
        seed=options.seed,
        checks=options.checks,
        engine=options.engine,
    )
    known = replay_metrics(flight_of_nothing(), plan.origin.fault_windows, plan.origin.fault_events)
    for check in options.checks:
        if (problem := problem_of(check, known)) is not None:
            raise ValueError(f"check: {problem[1]}")
    return plan


def read_recording(
    path: Path, topic: str = "", skip_backwards: bool = False, choice: LogChoice = ONLY_ONE
) -> Recording:
    """Read a recording of any kind; BagError says why it cannot be used. See `ReplayOptions`."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_dir() or path.suffix in BAGS:
        return recording_from_bag(path, topic, skip_backwards)
    return recording_from_log(path, topic, choice)


def choose_observer(
    recording: Recording, name: str = "", vehicle: str = "", settings: Sequence[str] = ()
) -> ChosenObserver:
    """Build the fault observer: that asked for, with its defaults, or that of the recording.

    ``vehicle`` is a name or the path of a TOML file, a setting ``observer.<parameter>=value``. What neither
    caller nor recording says is `DEFAULT_OBSERVER`, `DEFAULT_VEHICLE`. Real rotors follow a logged command by
    the lag of the vehicle's file; their accelerometer does not feel gravity.
    """
    if recording.observer is None and not name:
        raise BagError(f"{recording.path}: parameters.yaml makes no sense; choose with --observer")
    recorded: Mapping[str, object] = recording.observer or {}
    parameters: dict[str, object] = {
        "vehicle": recording.vehicle or DEFAULT_VEHICLE,
        "observer": DEFAULT_OBSERVER,
    }
    parameters |= {key: recorded[key] for key in parameters if key in recorded}
    kind = name or get(parameters, "observer", str)
    parameters["observer"] = kind
    if vehicle:
        parameters["vehicle"] = str(Path(vehicle).resolve()) if vehicle.endswith(".toml") else vehicle
    if recording.attitude_from_gyro and hasattr(fault_observers.get(kind), FROM_GYRO):
        parameters[f"{kind}.{FROM_GYRO}"] = True
    if recording.torque_is_command and hasattr(fault_observers.get(kind), LAG):
        parameters[f"{kind}.{LAG}"] = load_vehicle(get(parameters, "vehicle", str)).rotors.time_constant
    if recording.torque_is_command and hasattr(fault_observers.get(kind), FEELS):
        parameters[f"{kind}.{FEELS}"] = False  # in flight it feels the thrust
    if not name:
        parameters |= {key: value for key, value in recorded.items() if key.startswith(f"{kind}.")}
    for setting in settings:
        target, equals, value = setting.partition("=")
        parameter = target.strip().removeprefix(PREFIX)
        if not equals or not target.strip().startswith(PREFIX) or not parameter:
            raise ValueError(f"--set {setting!r}: expected {PREFIX}<parameter>=value")
        parameters[f"{kind}.{parameter}"] = parse_value(value, f"--set {setting!r}")
    try:
        law = fault_observer_from(parameters)
    except ValueError as error:
        is_as_recorded = recorded and not (name or vehicle or settings)
        where = f"{recording.path}: parameters.yaml: " if is_as_recorded else ""
        raise ValueError(f"{where}{error}") from None
    full = {"vehicle": parameters["vehicle"], "observer": kind, **node_values(law, kind)}
    return ChosenObserver(kind, law, full)
