# pyright: basic
"""What can be fed bad input: how an input is drawn for each, and which program gets it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from rclpy.node import Node

from quadftc_cli.commands import GOOD
from quadftc_cli.main import app, guarded
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import load_scenario
from quadftc_ros.executor import run_node
from quadftc_sim.assembly import sample_count
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode
from quadftc_tools.soak.bad_values import TEXTS, WRITTEN
from quadftc_tools.soak.fuzz_arguments import draw_arguments
from quadftc_tools.soak.fuzz_case import Case, Program
from quadftc_tools.soak.fuzz_seeds import CAMPAIGN, FAULTS, GAINS, NODES, SCENARIO, Seeds, with_vehicle
from quadftc_tools.soak.mutations import mutated_bytes, mutated_text, mutated_yaml

DIVERGED = 1e3  # rad/s; a vehicle that turns faster
FLOWN = 25  # samples of a scenario that is flown
SPECS = (
    "bias axis=roll value=3deg start=0.1s stop=0.2s",
    "noise channel=gyro sigma=0.1 start=0.05s",
    "dropout channel=imu probability=0.5",
    "delay channel=attitude delay=0.02s",
)
SETTINGS = (
    *(
        "faults.0.value=2 deg",
        "seed=3",
        "schemes.proposed.observer.delta=0.002",
        "rate=500 Hz",
        "plant.substeps=2",
    ),
    *(
        "faults[0].axes=[roll, pitch]",
        "references=[]",
        "sensors.grade=ideal",
        "schemes.proposed.controller=pid",
    ),
    *(
        "vehicle=crazyflie_2x",
        "disturbances.0={kind: sine, amplitude: 0.1}",
        "schemes.proposed.checks.0.below=1",
    ),
)
_NODES: dict[str, Callable[[], Node]] = {
    "plant": PlantNode,
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "controller": ControllerNode,
    "reference": ReferenceNode,
}


@dataclass(frozen=True)
class Target:
    """Something that takes input.

    Parameters
    ----------
    name : str
    draw : callable
        ``draw(seeds, random)`` returns files and arguments.
    program : callable
        Takes the arguments, returns an exit code.
    share : float
        Of the time, in proportion to the others'.
    """

    name: str
    draw: Callable[[Seeds, Random], tuple[Mapping[str, bytes], Sequence[str]]]
    program: Program
    share: float = 1.0

    def case(self, seeds: Seeds, random: Random) -> Case:
        """Draw an input."""
        files, arguments = self.draw(seeds, random)
        return Case(self.name, dict(files), list(arguments))


def _quadftc(arguments: Sequence[str]) -> int:
    return guarded(app, list(arguments))


def _doing(what: Callable[[Path], None]) -> Program:
    """Make a program that does something with a file, with the errors of ``quadftc``."""

    def command(arguments: Sequence[str], standalone_mode: bool) -> int:
        what(Path(arguments[0]))
        return GOOD

    return lambda arguments: guarded(command, list(arguments))  # type: ignore[arg-type]


def _fly(path: Path) -> None:
    """Fly the beginning of every scheme of a scenario; as long as the vehicle does, all is to be finite."""
    scenario = load_scenario(path)
    for scheme in scenario.schemes:
        count = min(FLOWN, sample_count(scenario.duration, scenario.rate))
        flight = fly(scenario.model_copy(update={"duration": count / scenario.rate}), scheme)
        sane = np.cumsum(~(np.abs(flight.body_rate).max(axis=1) < DIVERGED)) == 0
        rows = flight.delivered & sane
        for name in ("torque", "error", "fault_estimate", "disturbance_estimate", "sliding_variable"):
            if not np.all(np.isfinite(getattr(flight, name)[rows])):
                raise FloatingPointError(f"scheme {scheme}: {name} is not finite")


def _open_campaign(path: Path) -> None:
    """Do what ``quadftc campaign`` and ``tune`` do before they fly."""
    from quadftc_campaign.campaign_file import load_campaign
    from quadftc_campaign.flights import flight
    from quadftc_campaign.tune.tuning import checked

    campaign = load_campaign(path)
    for number in range(min(3, campaign.flights)):
        for variant in campaign.variants[:4]:
            flight(campaign, number, variant)
    if campaign.tune is not None:
        checked(campaign)


def _start_node(arguments: Sequence[str]) -> int:
    """Start a node as its executable does, and end it."""
    import sys

    made = _NODES[arguments[0]]

    def make() -> Node:
        node = made()
        signal.raise_signal(signal.SIGTERM)
        return node

    before, sys.argv = sys.argv, list(arguments)
    try:
        return run_node(make)
    finally:
        sys.argv = before


def _scenario(seeds: Seeds, random: Random) -> Any:
    return {"s.yaml": mutated_yaml(random.choice(seeds.scenarios), random)}, ["check", "s.yaml"]


def _flight(seeds: Seeds, random: Random) -> Any:
    return {"s.yaml": mutated_yaml(random.choice(seeds.scenarios), random)}, ["s.yaml"]


def _campaign(seeds: Seeds, random: Random) -> Any:
    files = {"c.yaml": CAMPAIGN, "tiny.yaml": SCENARIO, "gains.yaml": GAINS}
    name = random.choice(("c.yaml", "c.yaml", "c.yaml", "c.yaml", "tiny.yaml", "gains.yaml"))
    files[name] = mutated_yaml(files[name], random)
    return files, ["c.yaml"]


def _gains(seeds: Seeds, random: Random) -> Any:
    files = {"s.yaml": SCENARIO, "g.yaml": mutated_yaml(GAINS, random)}
    return files, ["check", "s.yaml", "--gains", "g.yaml"]


def _settings(seeds: Seeds, random: Random) -> Any:
    arguments = ["check", "s.yaml"]
    for _ in range(random.choice((1, 1, 2, 4))):
        setting = random.choice(SETTINGS)
        arguments += ["--set", setting if random.random() < 0.3 else _changed(setting, random)]
    return {"s.yaml": random.choice(seeds.scenarios)}, arguments


def _vehicle(seeds: Seeds, random: Random) -> Any:
    files = {"s.yaml": with_vehicle("v.toml"), "v.toml": mutated_text(random.choice(seeds.vehicles), random)}
    return files, random.choice((["check", "s.yaml"], ["check", "s.yaml", "--isolability"]))


def _flown_vehicle(seeds: Seeds, random: Random) -> Any:
    return _vehicle(seeds, random)[0], ["s.yaml"]


def _parameters(seeds: Seeds, random: Random) -> Any:
    node = random.choice(NODES)
    files = {"p.yaml": mutated_yaml(seeds.parameters[node], random)}
    return files, [node, "--ros-args", "--params-file", "p.yaml"]


def _bag(seeds: Seeds, random: Random) -> Any:
    """A bag with bytes overwritten, or the files beside it changed."""
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    storage = f"bag/{seeds.mcap}"
    kind = random.randrange(4)
    if kind:
        files[storage] = seeds.loose
    if kind != 3:
        files[storage] = mutated_bytes(files[storage], random)
    if kind >= 2:
        name = random.choice([name for name in files if name != storage])
        files[name] = (
            mutated_text(files[name], random) if name.endswith("json") else mutated_yaml(files[name], random)
        )
        if random.random() < 0.2:
            del files[random.choice(list(files))]
    return files, random.choice(
        (
            *(
                ["replay", "bag", "--out", "out"],
                ["replay", "bag", "--out", "out", "--observer", "supervised"],
            ),
            *(["replay", storage, "--out", "out", "--skip-backwards"], ["check", "bag"], ["check", storage]),
            *(["repair", "bag", "--out", "out/x"], ["repair", "bag"], ["repair", "bag", "--force"]),
            *(["repair", storage, "--out", "out/x"], ["report", "bag", "--out", "out.html", "--no-figures"]),
        )
    )


def _sqlite(seeds: Seeds, random: Random) -> Any:
    files = {f"bag/{name}": data for name, data in seeds.sqlite.items()}
    name = random.choice(list(files))
    files[name] = (
        mutated_yaml(files[name], random) if name.endswith("yaml") else mutated_bytes(files[name], random)
    )
    database = next(name for name in files if name.endswith(".db3"))
    return files, random.choice((["replay", "bag", "--out", "out"], ["replay", database, "--out", "out"]))


def _ulog(seeds: Seeds, random: Random) -> Any:
    return {"log.ulg": mutated_bytes(seeds.ulog, random)}, ["replay", "log.ulg", "--out", "out"]


def _faults(seeds: Seeds, random: Random) -> Any:
    files = {"log.ulg": seeds.ulog, "f.yaml": mutated_yaml(FAULTS, random)}
    spec = _changed(random.choice(SPECS), random)
    given = random.choice((["--faults", "f.yaml"], ["--fault", spec]))
    return files, ["replay", "log.ulg", "--out", "out", *given]


def _arguments(seeds: Seeds, random: Random) -> Any:
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    files |= {
        "s.yaml": SCENARIO,
        "c.yaml": CAMPAIGN,
        "g.yaml": GAINS,
        "log.ulg": seeds.ulog,
        "link->": b"../../outside",
    }
    return files, draw_arguments(app, random)


def _changed(text: str, random: Random) -> str:
    """Change one word, or some characters, of an argument."""
    kind = random.randrange(4)
    if kind == 0:
        at = random.randrange(len(text) + 1)
        text = text[:at] + str(random.choice(TEXTS)) + text[at + random.randrange(3) :]
    elif kind == 1 and "=" in text:
        key, _, _ = text.rpartition("=")
        value = random.choice((*TEXTS, *(written.decode() for written in WRITTEN)))
        text = f"{key}={value}"
    elif kind == 2:
        words = text.split(".")
        words[random.randrange(len(words))] = str(random.choice((*TEXTS, "-1", "99", "9" * 30, "٣", "²")))
        text = ".".join(words)
    else:
        text = mutated_text(text.encode(), random).decode("utf-8", "replace")
    return text.replace("\0", "")[:3000]  # no argument of a process can have NUL


TARGETS = {
    target.name: target
    for target in (
        Target("scenario", _scenario, _quadftc, 2.0),
        Target("flight", _flight, _doing(_fly)),
        Target("campaign", _campaign, _doing(_open_campaign), 2.0),
        Target("gains", _gains, _quadftc),
        Target("set", _settings, _quadftc),
        Target("vehicle", _vehicle, _quadftc),
        Target("vehicle flown", _flown_vehicle, _doing(_fly)),
        Target("ROS parameters", _parameters, _start_node),
        Target("bag", _bag, _quadftc, 3.0),
        Target("SQLite bag", _sqlite, _quadftc),
        Target("PX4 log", _ulog, _quadftc),
        Target("faults overlaid", _faults, _quadftc, 0.5),
        Target("arguments", _arguments, _quadftc, 1.5),
    )
}
