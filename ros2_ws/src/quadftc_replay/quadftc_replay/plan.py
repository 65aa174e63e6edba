"""A replay before it runs: what is replayed, through which observer, with which faults."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import yaml

from quadftc_bags.bag import BagError
from quadftc_flight.scenario import Fault
from quadftc_replay.bag_input import recording_from_bag
from quadftc_replay.diagnose import Diagnosed, Progress, diagnose
from quadftc_replay.observer import ChosenObserver, choose_observer
from quadftc_replay.overlay import faults_from, injector_of, require_within
from quadftc_replay.recording import Recording
from quadftc_replay.results import replay_name, replay_summary
from quadftc_replay.ulog_input import is_ulog, recording_from_ulog

YAML_WIDTH = 120  # characters


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """What to replay, and how.

    Parameters
    ----------
    topic : str
        Of the IMU (of the gyro in a PX4 log); empty: see `recording_from_bag`.
    observer : str
        Empty: as recorded, see `choose_observer`.
    settings : tuple of str
        ``observer.<parameter>=value``.
    vehicle : str
        Empty: as recorded.
    faults : tuple of str
        Specifications of faults to overlay.
    fault_files : tuple of Path
        YAML files with such; they come first.
    seed : int
        Of the random faults.
    skip_backwards : bool
        Leave out samples whose stamp goes back, instead of refusing the recording.
    """

    topic: str = ""
    observer: str = ""
    settings: tuple[str, ...] = ()
    vehicle: str = ""
    faults: tuple[str, ...] = ()
    fault_files: tuple[Path, ...] = ()
    seed: int = 0
    skip_backwards: bool = False


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Replay:
    """A replay with every part built."""

    recording: Recording
    observer: ChosenObserver
    faults: tuple[Fault, ...]
    seed: int

    @property
    def name(self) -> str:
        """Name of its directory and of its bag."""
        return replay_name(self.recording, self.observer)

    def diagnose(self, progress: Progress | None = None) -> Diagnosed:
        """Run it."""
        return diagnose(self.recording, self.observer.law, injector_of(self.faults, self.seed), progress)

    def summary(self, diagnosed: Diagnosed) -> dict[str, Any]:
        """Summarise what came out."""
        return replay_summary(self.recording, self.observer, self.faults, self.seed, diagnosed)

    def parameter_file(self) -> str:
        """Parameters of the nodes that would do the same in the graph, as a ROS parameter file (YAML)."""
        specs = [fault.spec for fault in self.faults]
        injector = {"seed": self.seed, **({"faults": specs} if specs else {})}
        prefix = f"/{self.recording.namespace.strip('/')}/".replace("//", "/")
        nodes = {
            f"{prefix}fault_injector": {"ros__parameters": injector},
            f"{prefix}fault_observer": {"ros__parameters": dict(self.observer.parameters)},
        }
        return yaml.safe_dump(nodes, sort_keys=False, default_flow_style=None, width=YAML_WIDTH)


def plan_replay(path: Path, options: ReplayOptions) -> Replay:
    """Read a recording and build everything; nothing is written.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, an ``.mcap`` or ``.db3`` file, or a PX4 log (``.ulg``).
    options : ReplayOptions

    Raises
    ------
    ValueError
        If the recording cannot be used (`BagError`), or an option is wrong.
    """
    faults = faults_from(options.fault_files, options.faults)
    if options.seed < 0:
        raise ValueError(f"seed = {options.seed}: must not be negative")
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    read = recording_from_ulog if is_ulog(path) else recording_from_bag
    recording = read(path, options.topic, options.skip_backwards)
    require_within(faults, recording.duration, recording.name)
    observer = choose_observer(recording, options.observer, options.vehicle, options.settings)
    return Replay(recording=recording, observer=observer, faults=faults, seed=options.seed)
