# pyright: basic
"""Flying a scenario through the real node graph: one bag and one summary for each run.

Not pure: starts the graph, writes files.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

import yaml
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from quadftc_bags.bag import read_bag
from quadftc_bags.writer import BagStatus
from quadftc_flight.flight import flight_from_bag
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphError, GraphPlan, check_options
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.run_files import commit, run_name, write_beside, write_summary
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_flight.summary import Summary, summary
from quadftc_ros.scheduling import ORDINARY, Scheduling
from quadftc_ros.versions import versions
from quadftc_sim.assembly import sample_count

GRAPHS = {"composed": ComposedGraph, "processes": ProcessGraph}

Progress = Callable[[float], bool]  # called with the share of the flight that is over; False ends it early


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """How to fly; a ValueError if the parts do not suit each other, or ROS has no such namespace."""

    graph: str = "composed"  # or processes
    mode: str = "lockstep"  # or realtime
    namespace: str = ""  # of the vehicle; empty: none
    force: bool = False  # replace an earlier run of the same name
    scheduling: Scheduling = ORDINARY  # in real time: how to share the machine
    engine: str = "c"  # what runs the laws: "c" or "numpy"

    def __post_init__(self) -> None:
        check_options(self.graph, self.mode, self.scheduling)
        check_namespace(self.namespace)


def check_namespace(namespace: str) -> None:
    """Raise a ValueError if ROS has no such namespace; empty: none."""
    try:
        validate_namespace(f"/{namespace.strip('/')}")
    except InvalidNamespaceException as error:
        words = str(error).split(": ", 1)[-1].splitlines()[0].rstrip(":")
        raise ValueError(f"namespace = {namespace!r}: {words}") from None
    except TypeError:  # it cannot be encoded
        raise ValueError(f"namespace = {namespace!r}: is no text") from None


def run(
    scenario: Scenario, scheme: Scheme, out: Path, options: RunOptions, progress: Progress
) -> Summary | None:
    """Fly one scheme of a scenario; return the summary that is written beside the bag, None if ended early.

    ``out`` is the directory of all runs. A GraphError says if the graph does not start or stalls. After the
    flight it says if messages were lost, or if the recording stopped, as on a full disk.
    """
    bag = out / run_name(scenario, scheme)
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        files = (Path(folder, "scenario.yaml"), Path(folder, "parameters.yaml"))
        parameters = node_parameters(scenario, scheme)
        how = {"scheduling": options.scheduling, "engine": options.engine}
        plan = GraphPlan(parameters, options.mode, options.namespace, bag, files, **how)
        files[0].write_text(yaml.safe_dump(scenario.raw, sort_keys=False, width=120), encoding="utf-8")
        files[1].write_text(plan.parameter_file(), encoding="utf-8")
        wall_time, status = _fly(plan, options.graph, scenario.duration * scenario.rate, progress)
        kept = sum(status.counts.values())
        # the flight went to its end; without the end of its bag nobody can judge it
        if status.error is not None:
            lost = f"{kept} messages are in the bag, {status.lost} are lost; run quadftc repair {bag}"
            raise GraphError(f"{status.error}: the recording stopped, the flight went on; {lost}")
        for file in files:
            write_beside(bag / file.name, file.read_text(encoding="utf-8"))
    if wall_time is None:
        return None
    # judged by its bag, as everybody else will see it
    flight = flight_from_bag(read_bag(bag))
    wanted = sample_count(scenario.duration, scenario.rate) - scenario.sensor.delay
    if options.mode == "lockstep" and len(flight) != wanted:
        raise GraphError(f"{bag}: {wanted} samples were flown, but {len(flight)} recorded")
    result = summary(flight, scenario, scheme, wall_time)
    result |= {"mode": options.mode, "graph": options.graph, "bag": bag.name}
    result |= {"recorded": {"messages": kept, "dropped": dict(status.dropped)}}
    result |= {"versions": {**versions(), **commit()}}
    write_summary(out, result)
    if status.dropped:
        counts = ", ".join(f"{topic} {count}" for topic, count in sorted(status.dropped.items()))
        raise GraphError(
            f"{bag}: messages were lost on the way to the bag, as the writer was behind: {counts}"
        )
    return result


def _fly(plan: GraphPlan, kind: str, samples: float, progress: Progress) -> tuple[float | None, BagStatus]:
    """Fly and record; return the wall time [s], None if ``progress`` ended the flight, and the recording."""
    with GRAPHS[kind](plan) as graph:
        wall_time = graph.run(lambda count: progress(min(1.0, count / samples)))
        recorder = graph.recorder
        assert recorder is not None  # the plan has a bag
        return (wall_time if graph.flew_to_its_end else None), recorder.finish()
