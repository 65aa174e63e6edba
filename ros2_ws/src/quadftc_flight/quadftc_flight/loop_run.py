"""Flying a scenario in the closed loop, without ROS, into what a run of the graph leaves: bag and summary."""

from __future__ import annotations

import platform
import time
from importlib.metadata import version
from pathlib import Path

import yaml

from quadftc_bags.bag import read_bag
from quadftc_flight.closed_loop import record_flight
from quadftc_flight.flight import flight_from_bag
from quadftc_flight.graph.plan import GraphError, GraphPlan
from quadftc_flight.loop_bag import BagRecord, write_loop_bag
from quadftc_flight.run_files import commit, run_name, write_beside, write_summary
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_flight.summary import Summary, summary
from quadftc_model.versions import software_version


def run_loop(scenario: Scenario, scheme: Scheme, out: Path, engine: str) -> Summary:
    """Fly one scheme of a scenario; return the summary that is written beside the bag.

    ``out`` is the directory of all runs. A GraphError says if the bag cannot be written.
    """
    bag, begin = out / run_name(scenario, scheme), time.perf_counter()
    record = record_flight(scenario, BagRecord, scheme, engine=engine)
    wall_time = time.perf_counter() - begin
    files = {
        "scenario.yaml": yaml.safe_dump(scenario.raw, sort_keys=False, width=120),
        "parameters.yaml": GraphPlan(node_parameters(scenario, scheme), engine=engine).parameter_file(),
    }
    try:
        counts = write_loop_bag(record, bag, {name: text.encode() for name, text in files.items()})
    except OSError as error:
        raise GraphError(f"{error.filename or bag}: {error.strerror}") from None
    for name, text in files.items():
        write_beside(bag / name, text)
    result = summary(flight_from_bag(read_bag(bag)), scenario, scheme, wall_time)
    result |= {"mode": "lockstep", "graph": "loop", "bag": bag.name}
    result |= {"recorded": {"messages": sum(counts.values()), "dropped": {}}}
    versions = {"quadftc": software_version(), "python": platform.python_version()}
    result["versions"] = versions | {name: version(name) for name in ("mcap", "numpy")} | commit()
    write_summary(out, result)
    return result
