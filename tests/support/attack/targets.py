"""What can be fed bad input: how an input is drawn for each, and which program gets it."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from rclpy.node import Node

from attack.case import Case, Program
from attack.inputs import Draw, bad_argument, bad_bytes, bad_command_line, bad_text, bad_yaml, pick
from attack.seeds import CAMPAIGN, FAULTS, GAINS, NODES, SCENARIO, Seeds, with_vehicle
from quadftc_cli.commands import GOOD
from quadftc_cli.main import app, guarded
from quadftc_control.controller_node import ControllerNode
from quadftc_control.reference_node import ReferenceNode
from quadftc_fdi.disturbance_observer_node import DisturbanceObserverNode
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_flight.checks import refuse_wrong_checks
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import load_scenario
from quadftc_ros.executor import STOPPING, run_node
from quadftc_sim.assembly import sample_count
from quadftc_sim.fault_injector_node import FaultInjectorNode
from quadftc_sim.plant_node import PlantNode

DIVERGED = 1e3  # rad/s; a vehicle that turns faster
FLOWN = 25  # samples of a scenario that is flown
SPECS = (
    "bias axis=roll value=3deg start=0.1s stop=0.2s",
    "noise channel=gyro sigma=0.1 start=0.05s",
    "dropout channel=imu probability=0.5",
    "delay channel=attitude delay=0.02s",
)
SETTINGS = (
    *("faults.0.value=2 deg", "seed=3", "schemes.proposed.observer.delta=0.002", "rate=500 Hz"),
    *("plant.substeps=2", "faults[0].axes=[roll, pitch]", "references=[]", "sensors.grade=ideal"),
    *("schemes.proposed.controller=pid", "vehicle=crazyflie_2x"),
    *("disturbances.0={kind: sine, amplitude: 0.1}", "schemes.proposed.checks.0.below=1"),
)
NODE_CLASSES: dict[str, Callable[[], Node]] = {
    "plant": PlantNode,
    "fault_injector": FaultInjectorNode,
    "fault_observer": FaultObserverNode,
    "disturbance_observer": DisturbanceObserverNode,
    "controller": ControllerNode,
    "reference": ReferenceNode,
}
Input = tuple[dict[str, bytes], list[str]]  # files, arguments


@dataclass(frozen=True)
class Target:
    """Something that takes input: what draws files and arguments, and what gets them."""

    name: str
    draw: Callable[[Draw, Seeds], Input]
    program: Program

    def cases(self, seeds: Seeds) -> st.SearchStrategy[Case]:
        """Return the strategy that draws inputs."""
        return st.composite(lambda draw: Case(self.name, *self.draw(draw, seeds)))()


def _quadftc(arguments: Sequence[str]) -> int:
    return guarded(list(arguments))


def _program(action: Callable[[Path], None]) -> Program:
    """Make a program that acts on a file and answers errors as ``quadftc`` does."""

    def command(arguments: Sequence[str], standalone_mode: bool) -> int:
        action(Path(arguments[0]))
        return GOOD

    return lambda arguments: guarded(list(arguments), command)  # type: ignore[arg-type]


def _fly(path: Path) -> None:
    """Fly the beginning of every scheme; values must be finite until the vehicle diverges."""
    scenario = load_scenario(path)
    refuse_wrong_checks(scenario)
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
    from quadftc_campaign.flights import flight_scenario
    from quadftc_campaign.tune.tuning import checked

    campaign = load_campaign(path)
    for number in range(min(3, campaign.flights)):
        for variant in campaign.variants[:4]:
            flight_scenario(campaign, number, variant)
    if campaign.tune is not None:
        checked(campaign)


def _start_node(arguments: Sequence[str]) -> int:
    """Start a node as its executable does, and end it."""

    def make() -> Node:
        node = NODE_CLASSES[arguments[0]]()
        signal.raise_signal(signal.SIGTERM)
        return node

    before, sys.argv = sys.argv, list(arguments)
    handlers = {number: signal.getsignal(number) for number in STOPPING}
    try:
        return run_node(make)
    finally:
        sys.argv = before
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _scenario(draw: Draw, seeds: Seeds) -> Input:
    return {"s.yaml": bad_yaml(draw, pick(draw, seeds.scenarios))}, ["check", "s.yaml"]


def _flight(draw: Draw, seeds: Seeds) -> Input:
    return _scenario(draw, seeds)[0], ["s.yaml"]


def _campaign(draw: Draw, seeds: Seeds) -> Input:
    files = {"c.yaml": CAMPAIGN, "tiny.yaml": SCENARIO, "gains.yaml": GAINS}
    name = pick(draw, ("c.yaml", "c.yaml", "c.yaml", "c.yaml", "tiny.yaml", "gains.yaml"))
    files[name] = bad_yaml(draw, files[name])
    return files, ["c.yaml"]


def _gains(draw: Draw, seeds: Seeds) -> Input:
    files = {"s.yaml": SCENARIO, "g.yaml": bad_yaml(draw, GAINS)}
    return files, ["check", "s.yaml", "--gains", "g.yaml"]


def _settings(draw: Draw, seeds: Seeds) -> Input:
    arguments = ["check", "s.yaml"]
    for _ in range(pick(draw, (1, 1, 2, 4))):
        setting = pick(draw, SETTINGS)
        arguments += ["--set", setting if pick(draw, range(3)) == 0 else bad_argument(draw, setting)]
    return {"s.yaml": pick(draw, seeds.scenarios)}, arguments


def _vehicle(draw: Draw, seeds: Seeds) -> Input:
    files = {"s.yaml": with_vehicle("v.toml"), "v.toml": bad_text(draw, pick(draw, seeds.vehicles))}
    return files, ["check", "s.yaml", *pick(draw, ([], ["--isolability"]))]


def _flown_vehicle(draw: Draw, seeds: Seeds) -> Input:
    return _vehicle(draw, seeds)[0], ["s.yaml"]


def _parameters(draw: Draw, seeds: Seeds) -> Input:
    node = pick(draw, NODES)
    files = {"p.yaml": bad_yaml(draw, seeds.parameters[node])}
    return files, [node, "--ros-args", "--params-file", "p.yaml"]


def _bag(draw: Draw, seeds: Seeds) -> Input:
    """A bag with bytes overwritten, or the files beside it changed."""
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    storage = f"bag/{seeds.mcap}"
    damage = pick(draw, ("compressed", "loose", "both", "beside"))
    if damage != "compressed":
        files[storage] = seeds.loose
    if damage != "beside":
        files[storage] = bad_bytes(draw, files[storage])
    if damage in ("both", "beside"):
        name = pick(draw, [name for name in files if name != storage])
        files[name] = (bad_text if name.endswith("json") else bad_yaml)(draw, files[name])
        if pick(draw, range(5)) == 4:
            del files[pick(draw, list(files))]
    commands = (
        *(["replay", "bag", "--out", "out"], ["replay", "bag", "--out", "out", "--observer", "supervised"]),
        *(["replay", storage, "--out", "out", "--skip-backwards"], ["check", "bag"], ["check", storage]),
        *(["repair", "bag", "--out", "out/x"], ["repair", "bag"], ["repair", "bag", "--force"]),
        *(["repair", storage, "--out", "out/x"], ["report", "bag", "--out", "out.html"]),
    )
    return files, list(pick(draw, commands))


def _sqlite(draw: Draw, seeds: Seeds) -> Input:
    files = {f"bag/{name}": data for name, data in seeds.sqlite.items()}
    name = pick(draw, list(files))
    files[name] = (bad_yaml if name.endswith("yaml") else bad_bytes)(draw, files[name])
    database = next(name for name in files if name.endswith(".db3"))
    return files, ["replay", pick(draw, ("bag", database)), "--out", "out"]


def _faults(draw: Draw, seeds: Seeds) -> Input:
    files = {"log.ulg": seeds.ulog, "f.yaml": bad_yaml(draw, FAULTS)}
    spec = bad_argument(draw, pick(draw, SPECS))
    overlay = pick(draw, (["--faults", "f.yaml"], ["--fault", spec]))
    return files, ["replay", "log.ulg", "--out", "out", *overlay]


def _arguments(draw: Draw, seeds: Seeds) -> Input:
    files = {f"bag/{name}": data for name, data in seeds.bag.items()}
    files |= {"s.yaml": SCENARIO, "c.yaml": CAMPAIGN, "g.yaml": GAINS, "log.ulg": seeds.ulog}
    return {**files, "link->": b"../../outside"}, bad_command_line(draw, app)


TARGETS = {
    target.name: target
    for target in (
        Target("scenario", _scenario, _quadftc),
        Target("flight", _flight, _program(_fly)),
        Target("campaign", _campaign, _program(_open_campaign)),
        Target("gains", _gains, _quadftc),
        Target("set", _settings, _quadftc),
        Target("vehicle", _vehicle, _quadftc),
        Target("vehicle flown", _flown_vehicle, _program(_fly)),
        Target("ROS parameters", _parameters, _start_node),
        Target("bag", _bag, _quadftc),
        Target("SQLite bag", _sqlite, _quadftc),
        Target("faults overlaid", _faults, _quadftc),
        Target("arguments", _arguments, _quadftc),
    )
}
