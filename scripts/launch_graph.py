#!/usr/bin/env python3
"""Start the node graph, in one process or a process for each node, and run it until it ends or Ctrl-C.

    scripts/launch_graph.py --scenario paper_faults --scheme proposed --graph processes --mode realtime
    scripts/launch_graph.py --graph processes --respawn
    scripts/launch_graph.py --params my_graph.yaml --namespace drone1 --record results/drone1
    scripts/launch_graph.py --onboard --vehicle my_drone.toml --remap imu/data:=/mavros/imu/data

Without a scenario it flies level with the recommended observer and follows live setpoints, until Ctrl-C.
With --onboard, plant and fault injector stay out: a vehicle that exists publishes imu/data and reads
torque/command.

It waits until all nodes are connected, passes SIGINT and SIGTERM on, and ends only what it started. It
returns the worst exit code of the nodes: 0 all ended well, 2 wrong input, 3 the graph failed. 130 says that
it was interrupted before it started anything, or twice.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from quadftc_flight.graph.plan import GraphPlan

ROOT = Path(__file__).resolve().parents[1]
BAD_INPUT, FAILED, INTERRUPTED = 2, 3, 130
ENTER = """
. "$1/scripts/lib/common.sh"
setup_ready || "$1/scripts/setup" || exit
. "$1/scripts/lib/env.sh"
shift
exec python3 "$@"
"""  # bash: into the environment of scripts/setup, made first if need be


def parse(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Start the node graph and run it until it ends or Ctrl-C.")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--scenario",
        help="scenario file or name; default: level flight, live setpoints, the recommended observer, no end",
    )
    what.add_argument("--params", type=Path, help="ROS parameter file for the nodes")
    parser.add_argument("--vehicle", help="vehicle to fly: a name or a TOML file; not with --scenario")
    parser.add_argument(
        "--live", action="store_true", help="follow attitude/setpoint or position/setpoint, not the scenario"
    )
    parser.add_argument(
        "--onboard",
        action="store_true",
        help="no plant, no fault injector: for a vehicle that publishes imu/data and reads torque/command",
    )
    parser.add_argument(
        "--remap",
        action="append",
        default=[],
        metavar="TOPIC:=OTHER",
        help="such as imu/data:=/mavros/imu/data; may be repeated",
    )
    parser.add_argument("--scheme", help="scheme of the scenario; default: its first")
    parser.add_argument("--gains", default="", help="tuned gains: a name or a file (see gains/)")
    parser.add_argument("--graph", choices=("composed", "processes"), default="composed")
    parser.add_argument("--mode", choices=("lockstep", "realtime"), default="realtime")
    parser.add_argument("--namespace", default="", help="ROS namespace of the vehicle")
    parser.add_argument(
        "--network",
        action="store_true",
        help="let other machines on the network find the graph; default: this machine only",
    )
    parser.add_argument("--record", type=Path, help="directory of the bag to write; must not exist")
    parser.add_argument("--duration", type=float, help="length of the flight [s]; 0: until Ctrl-C")
    parser.add_argument(
        "--respawn",
        action="store_true",
        help="start a node again that dies in flight (--graph processes, real time; not the plant)",
    )
    parser.add_argument(
        "--wait", choices=("sleep", "poll"), default="sleep", help="between samples; poll takes a whole core"
    )
    parser.add_argument("--realtime-priority", type=int, default=0, help="of SCHED_RR, if permitted")
    parser.add_argument(
        "--engine", choices=("c", "numpy"), default="c", help="what runs the laws: C made from them, or NumPy"
    )
    parser.add_argument("--core", type=int, action="append", default=[], help="processor core to run on")
    return parser.parse_args(arguments)


def parameters_from_file(path: Path) -> dict[str, dict[str, Any]]:
    """Read a ROS parameter file, or raise a ValueError: the parameters of each node of the graph by its name.

    ``/**`` stands for all nodes; namespaces are left out, and so are nodes that are not of the graph.
    """
    import yaml

    from quadftc_flight.graph.plan import EXECUTABLES

    try:
        data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: expected node names with ros__parameters below each")
    found: dict[str, dict[str, Any]] = {}
    for key, entry in cast("dict[Any, Any]", data).items():
        values = cast("dict[Any, Any]", entry).get("ros__parameters") if isinstance(entry, dict) else None
        if not isinstance(values, dict):
            raise ValueError(f"{path}: {key}: expected ros__parameters with a mapping")
        name = str(key).rpartition("/")[2]
        for node in EXECUTABLES if name == "**" else (name,):
            if node in EXECUTABLES:
                found.setdefault(node, {}).update(_flat(cast("dict[str, Any]", values)))
    return found


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested parameters with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat.update(_flat(cast("dict[str, Any]", value), f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat


def node_parameters_of(options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Collect the parameters of each node from scenario or parameter file.

    Raises
    ------
    ValueError
        If file, scenario or options are wrong.
    """
    from quadftc_flight.graph.plan import EXECUTABLES
    from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters
    from quadftc_sim.sensors import GRADES

    if options.scenario:
        if options.vehicle:
            raise ValueError("--vehicle: the scenario names its vehicle")
        loaded = load_scenario(find_scenario(options.scenario), gains=options.gains)
        parameters = {node: dict(values) for node, values in node_parameters(loaded, options.scheme).items()}
    elif options.scheme or options.gains:
        raise ValueError("--scheme, --gains: belong to --scenario")
    else:
        parameters = parameters_from_file(options.params) if options.params else {}
    if options.vehicle:
        is_file = options.vehicle.endswith(".toml")
        vehicle = str(Path(options.vehicle).resolve()) if is_file else options.vehicle
        for node in (node for node in EXECUTABLES if node not in ("fault_injector", "reference")):
            parameters.setdefault(node, {})["vehicle"] = vehicle
    if not (options.scenario or options.params):
        # readings without noise look stuck to an observer that watches the gyro
        grade = {f"imu.{name}": value for name, value in GRADES["mems"].items()}
        parameters["plant"] = {**grade, **parameters.get("plant", {})}
    if options.live or not (options.scenario or options.params):
        for node in ("reference", "position_controller"):
            parameters.setdefault(node, {})["source"] = "topic"
    if options.duration is not None:
        parameters.setdefault("plant", {})["duration"] = options.duration
    return parameters


def check_onboard(options: argparse.Namespace) -> None:
    """Raise a ValueError if the options contradict a vehicle that exists."""
    if not options.onboard:
        return
    if options.mode != "realtime" or options.duration is not None:
        raise ValueError("--onboard: a vehicle that exists flies in real time, until Ctrl-C")
    if not (options.vehicle or options.scenario or options.params):
        raise ValueError("--onboard: which vehicle? --vehicle NAME or FILE.toml (quadftc list vehicles)")


def with_attachments(options: argparse.Namespace, plan: GraphPlan, folder: Path) -> GraphPlan:
    """Write what belongs into the bag, so that a report knows what flew; nothing without a bag."""
    import yaml

    from quadftc_flight.scenario import find_scenario, load_scenario

    if plan.bag is None:
        return plan
    texts = {"parameters.yaml": plan.parameter_file()}
    if options.scenario and not options.live and options.duration is None:
        raw = load_scenario(find_scenario(options.scenario), gains=options.gains).raw
        texts["scenario.yaml"] = yaml.safe_dump(raw, sort_keys=False, width=120)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return dataclasses.replace(plan, attachments=tuple(folder / name for name in texts))


def launch(options: argparse.Namespace) -> int:
    """Run the graph; return the exit code."""
    from quadftc_flight.graph.introduction import farewell, introduction
    from quadftc_flight.graph.plan import GraphError, GraphPlan, check_options, check_remaps
    from quadftc_flight.runs import GRAPHS, check_namespace
    from quadftc_ros.executor import StopSignals
    from quadftc_ros.reach import reach
    from quadftc_ros.scheduling import Scheduling

    graph, wall = None, 0.0
    try:
        scheduling = Scheduling(options.wait, options.realtime_priority, tuple(options.core))
        check_options(options.graph, options.mode, scheduling, options.respawn)
        check_remaps(options.remap)
        check_namespace(options.namespace)
        check_onboard(options)
        plan = GraphPlan(
            node_parameters_of(options),
            options.mode,
            options.namespace,
            options.record,
            engine=options.engine,
            scheduling=scheduling,
            respawn=options.respawn,
            onboard=options.onboard,
            remaps=tuple(options.remap),
        )
        # first what it will do and who can hear it, then processes
        hint = "" if options.network else " (--network opens it)"
        sys.stderr.write("".join(f"{line}\n" for line in [*introduction(plan), reach() + hint]))
        with (
            tempfile.TemporaryDirectory(prefix="quadftc_") as folder,
            StopSignals() as stop,
            GRAPHS[options.graph](with_attachments(options, plan, Path(folder))) as graph,
        ):
            wall = graph.run(lambda _samples: not stop.requested)
            status = graph.recorder.finish() if graph.recorder is not None else None
            if status is not None and status.error is not None:
                raise GraphError(f"{status.error}: the recording stopped")
    except GraphError as error:
        sys.stderr.write(f"error: {error}\n")
        return (graph.exit_code if graph is not None else 0) or FAILED
    except ValueError as error:
        sys.stderr.write("".join(f"error: {line}\n" for line in str(error).splitlines()))
        return BAD_INPUT
    sys.stderr.write(f"{farewell(plan, wall)}\n")
    return graph.exit_code


def main() -> int:
    """Run the command, inside the environment that scripts/setup made."""
    options = parse(sys.argv[1:])
    if importlib.util.find_spec("quadftc_cli") is None:
        arguments = ["bash", "-c", ENTER, "bash", str(ROOT), str(Path(__file__).resolve()), *sys.argv[1:]]
        os.execvp("bash", arguments)
    from quadftc_ros.reach import open_to_network, stay_local

    (open_to_network if options.network else stay_local)()
    try:
        return launch(options)
    except KeyboardInterrupt:  # before anything was started; or a second time, and then all was ended
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
