# pyright: basic
"""Latency of the graph in real time: from the stamp of an IMU sample to its torque, and stage by stage."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median_high
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from quadftc_cli.screen import plain_table
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphPlan, check_options
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_ros.scheduling import ORDINARY, Scheduling
from quadftc_ros.topics import GRAPHS, TOPICS
from quadftc_ros.transport import load_trace
from quadftc_tools.bench.machine import Result, Usage

SETTLED = 1.0  # s; what comes before is not counted
PERCENTILES = (50.0, 90.0, 99.0, 99.9)
MICROSECOND = 1e3  # ns

# stage: from where to where; each end is a node, and whether it gives or takes which topic
STAGES = {
    "plant/imu to the injector": ("plant given plant/imu", "fault_injector taken plant/imu"),
    "fault injector": ("fault_injector taken plant/imu", "fault_injector given imu/data"),
    "imu/data to the observer": ("fault_injector given imu/data", "fault_observer taken imu/data"),
    "fault observer": ("fault_observer taken imu/data", "fault_observer given imu/corrected"),
    "imu/corrected to the controller": (
        "fault_observer given imu/corrected",
        "controller taken imu/corrected",
    ),
    "controller": ("controller taken imu/corrected", "controller given torque/command"),
    "torque/command to the plant": ("controller given torque/command", "plant taken torque/command"),
    "disturbance observer": (
        "disturbance_observer taken imu/corrected",
        "disturbance_observer given disturbance/estimate",
    ),
    "IMU published to torque": ("plant given plant/imu", "plant taken torque/command"),
}
TOTAL = "IMU stamp to torque"
TIMER = "plant's timer behind its schedule"

Times = dict[int, int]  # stamp -> time [ns]
Traces = Mapping[str, Mapping[str, NDArray[np.int64]]]


@dataclasses.dataclass(frozen=True)
class LatencyOptions:
    """How to measure; ValueError if the scheduling does not suit the graph."""

    graph: str = "composed"  # or "processes"
    record: bool = True  # write a bag meanwhile, and throw it away
    engine: str = "c"  # what runs the laws: "c" or "numpy"
    scheduling: Scheduling = ORDINARY

    def __post_init__(self) -> None:
        check_options(self.graph, "realtime", self.scheduling)


def measure_latency(
    scenario: Scenario, scheme: Scheme, options: LatencyOptions, progress: Callable[[int], bool]
) -> Result | None:
    """Fly a scenario in real time and measure; None if ``progress``, called with the samples, ended it.

    GraphError if the graph does not start or stalls.
    """
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        bag, traces = Path(folder, "bag") if options.record else None, Path(folder, "traces")
        traces.mkdir()
        paths = {"bag": bag, "traces": traces}
        parameters = node_parameters(scenario, scheme)
        how = {"scheduling": options.scheduling, "engine": options.engine}
        plan = GraphPlan(parameters, "realtime", **paths, **how)
        with (ProcessGraph if options.graph == "processes" else ComposedGraph)(plan) as graph:
            if not graph.wait_until_connected(progress):
                return None
            usage = Usage(_processes(graph))
            wall_time = graph.run(progress)
            taken = usage.taken(wall_time)
            recorded = None if graph.recorder is None else graph.recorder.finish()
        if not graph.flew_to_its_end:
            return None
        found = {node: load_trace(traces / f"{node}.npz") for node in plan.executables}
    result = latencies(found, scenario.rate)
    result |= {"scenario": scenario.name, "rate": scenario.rate, "duration": scenario.duration}
    result |= {**dataclasses.asdict(options), "observer": scheme.observer.kind}
    result |= {"wall_time_s": round(wall_time, 3), "usage": taken}
    if recorded is not None:
        result["recorded"] = {
            "stored": sum(recorded.counts.values()),
            "dropped": sum(recorded.dropped.values()) + recorded.lost,
            "missing": unrecorded(found, recorded.counts),
        }
    return result


def latencies(traces: Traces, rate: float) -> Result:
    """Statistics of the traces of a flight at a rate [Hz].

    Returns
    -------
    dict
        ``stages``: by name ``p50``...``max`` and ``mean`` [us]; ``samples`` counted; ``missed``: without a
        torque of their own; ``late``: whose torque came after the next sample; ``lost``: messages that did
        not reach a reader, by topic and reader; ``histogram`` of the total.
    """
    splits = {end: end.partition(" ") for both in STAGES.values() for end in both}
    times = {end: _first_times(traces[node], event) for end, (node, _, event) in splits.items()}
    emitted, answered = (times[end] for end in STAGES["IMU published to torque"])
    stamps = sorted(emitted)
    stamps = [stamp for stamp in stamps if stamp - stamps[0] >= SETTLED * 1e9][:-1]  # the last has no answer
    # the schedule: the earliest that any sample was, as none can be before its time
    schedule = min((emitted[stamp] - stamp for stamp in stamps), default=0)
    there = [stamp for stamp in stamps if stamp in answered]
    total = np.array([answered[stamp] - stamp - schedule for stamp in there])
    found = {name: _between(times[begin], times[end], stamps) for name, (begin, end) in STAGES.items()}
    found[TOTAL] = total
    found[TIMER] = np.array([emitted[stamp] - stamp - schedule for stamp in stamps])
    period = 1e9 / rate
    return {
        "stages": {name: statistics(values) for name, values in found.items() if len(values)},
        "samples": len(stamps),
        "missed": len(stamps) - len(there),
        "late": int(np.sum(total > period)),
        "lost": lost_messages(traces),
        "histogram": histogram(total),
    }


def lost_messages(traces: Traces) -> dict[str, int]:
    """How many messages were published but not taken, for each ``topic to reader`` with any.

    The last sample's do not count: the flight ends meanwhile.
    """
    lost: dict[str, int] = {}
    for row in GRAPHS["free_flight" if "position_controller" in traces else "test_stand"].values():
        given: set[int] = set()
        for node in row.publishers:
            given |= _first_times(traces.get(node, {}), f"given {row.name}").keys()
        given.discard(max(given, default=0))
        for reader in row.readers:
            missing = given - _first_times(traces.get(reader, {}), f"taken {row.name}").keys()
            if missing:
                lost[f"{row.name} to {reader}"] = len(missing)
    return lost


def unrecorded(traces: Traces, counts: Mapping[str, int]) -> int:
    """How many of the messages that were published are not in the bag with these counts, by topic."""
    missing = 0
    for node, trace in traces.items():
        for event, rows in trace.items():
            kind, _, topic = event.partition(" ")
            if kind == "given" and node in TOPICS[topic].publishers:
                missing += max(0, len(rows) - counts.get(f"/{topic}", 0))
    return missing


def statistics(nanoseconds: NDArray[np.int64]) -> dict[str, float]:
    """Percentiles, greatest and mean value [us]."""
    values = [*np.percentile(nanoseconds, PERCENTILES), np.max(nanoseconds), np.mean(nanoseconds)]
    names = (*(f"p{level:g}" for level in PERCENTILES), "max", "mean")
    return {name: round(float(value) / MICROSECOND, 1) for name, value in zip(names, values, strict=True)}


def histogram(nanoseconds: NDArray[np.int64], bins: int = 120) -> dict[str, list[float]]:
    """Counts between edges [us], evenly spaced on a logarithmic scale from 10 us to 1 s."""
    edges = np.geomspace(10.0, 1e6, bins + 1)
    counts, _ = np.histogram(nanoseconds / MICROSECOND, edges)
    return {"edges_us": [round(float(edge), 2) for edge in edges], "counts": counts.tolist()}


def _processes(graph: ComposedGraph | ProcessGraph) -> dict[str, int]:
    found = {"graph": os.getpid()}
    if isinstance(graph, ProcessGraph):
        found = {"recorder": os.getpid(), **graph.children.process_ids()}
    if graph.recorder is not None:
        found["bag" if "recorder" in found else "recorder"] = graph.recorder.process_id
    return found


def _first_times(trace: Mapping[str, NDArray[np.int64]], event: str) -> Times:
    """Times by stamp; a stamp that came more than once, with its first time."""
    rows = trace.get(event)
    return {} if rows is None else dict(rows[::-1].tolist())  # the last to be put in stays


def _between(begin: Times, end: Times, stamps: list[int]) -> NDArray[np.int64]:
    return np.array([end[stamp] - begin[stamp] for stamp in stamps if stamp in begin and stamp in end])


def latency_table(results: Sequence[Result]) -> Table:
    """Stages of one rate; of several runs, the medians."""
    first, shown = results[0], (*(f"p{level:g}" for level in PERCENTILES), "max")
    title = f"{first['rate']:g} Hz, {first['graph']}, {first['observer']}: latency [us]"
    table = plain_table(("stage",), shown, title)
    for stage in first["stages"]:
        rows = [item["stages"][stage] for item in results if stage in item["stages"]]
        table.add_row(stage, *(f"{median_high([row[name] for row in rows]):.0f}" for name in shown))
    return table


def counts_line(result: Result) -> str:
    """Say how many samples and messages of one run were missed, late, lost and recorded."""
    words = f"{result['samples']} samples, {result['missed']} missed, {result['late']} late"
    words += f"; {sum(result['lost'].values())} messages lost"
    bag = result.get("recorded")
    if bag is None:
        return words
    return f"{words}; {bag['stored']} recorded, {bag['dropped']} dropped, {bag['missing']} missing"


def usage_line(results: Sequence[Result]) -> str:
    """Processor time and memory by process; medians of the runs."""
    words: list[str] = []
    for name in results[0]["usage"]:
        runs = [result["usage"][name] for result in results]
        share, memory = (median_high([run[key] for run in runs]) for key in ("cpu_share", "memory_mib"))
        words.append(f"{name}: {100.0 * share:.0f} % of a core, {memory:.0f} MiB")
    return "; ".join(words)


def latency_figure(results: Sequence[Result], out: Path) -> Path:
    """Draw the latency from stamp to torque, a histogram for each rate with all its runs; return its path."""
    from matplotlib.figure import Figure

    rates = list(dict.fromkeys(item["rate"] for item in results))
    figure = Figure(figsize=(8.0, 1.2 + 1.6 * len(rates)), layout="constrained")
    axes: Any = figure.subplots(len(rates), 1, sharex=True, squeeze=False)
    for axis, rate in zip(axes[:, 0], rates, strict=True):
        histograms = [item["histogram"] for item in results if item["rate"] == rate]
        axis.stairs(
            np.sum([item["counts"] for item in histograms], axis=0), histograms[0]["edges_us"], fill=True
        )
        axis.axvline(1e6 / rate, linestyle="--", color="black", linewidth=1.0)
        axis.set(xscale="log", yscale="log", ylabel="samples", title=f"{rate:g} Hz; dashed: one period")
        axis.set_ylim(bottom=0.7)
        axis.grid(alpha=0.3)
    axes[-1, 0].set(xlabel="IMU stamp to torque [us]")
    path = out / "latency.png"
    figure.savefig(path, dpi=120)
    return path
