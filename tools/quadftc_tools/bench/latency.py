# pyright: basic
"""Latency of the graph in real time: from the stamp of an IMU sample to its torque, and stage by stage."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import EXECUTABLES, GraphPlan, check_scheduling
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.scenario import Scenario, Scheme, node_parameters
from quadftc_ros.scheduling import ORDINARY, Scheduling
from quadftc_ros.topics import TOPICS
from quadftc_ros.trace import load_trace
from quadftc_tools.bench.machine import Usage

SETTLED = 1.0  # s; what comes before is not counted
PERCENTILES = (50.0, 90.0, 99.0, 99.9)
MICROSECOND = 1e3  # ns

# stage: from where to where; each end is a node, and what it does with a topic
STAGES: dict[str, tuple[tuple[str, str], tuple[str, str]]] = {
    "plant/imu to the injector": (("plant", "given plant/imu"), ("fault_injector", "taken plant/imu")),
    "fault injector": (("fault_injector", "taken plant/imu"), ("fault_injector", "given imu/data")),
    "imu/data to the observer": (("fault_injector", "given imu/data"), ("fault_observer", "taken imu/data")),
    "fault observer": (("fault_observer", "taken imu/data"), ("fault_observer", "given imu/corrected")),
    "imu/corrected to the controller": (
        ("fault_observer", "given imu/corrected"),
        ("controller", "taken imu/corrected"),
    ),
    "controller": (("controller", "taken imu/corrected"), ("controller", "given torque/command")),
    "torque/command to the plant": (
        ("controller", "given torque/command"),
        ("plant", "taken torque/command"),
    ),
    "disturbance observer": (
        ("disturbance_observer", "taken imu/corrected"),
        ("disturbance_observer", "given disturbance/estimate"),
    ),
    "IMU published to torque": (("plant", "given plant/imu"), ("plant", "taken torque/command")),
}
TOTAL = "IMU stamp to torque"
TIMER = "plant's timer behind its schedule"

Times = dict[int, int]  # stamp -> time [ns]
Traces = Mapping[str, Mapping[str, NDArray[np.int64]]]


@dataclasses.dataclass(frozen=True)
class LatencyOptions:
    """How to measure.

    Parameters
    ----------
    graph : str
        ``composed`` or ``processes``.
    executor : str
        ``events`` or ``single``; of the composed graph.
    record : bool
        Write a bag meanwhile, and throw it away.
    scheduling : Scheduling
        How to share the machine.

    Raises
    ------
    ValueError
        If the scheduling does not suit the graph.
    """

    graph: str = "composed"
    executor: str = "events"
    record: bool = True
    scheduling: Scheduling = ORDINARY

    def __post_init__(self) -> None:
        check_scheduling(self.scheduling, "realtime", self.graph)


def measure_latency(
    scenario: Scenario, scheme: Scheme, options: LatencyOptions, progress: Callable[[int], bool]
) -> dict[str, Any] | None:
    """Fly a scenario in real time and measure; None if ``progress``, called with the samples, ended it.

    Raises
    ------
    GraphError
        If the graph does not start or stalls.
    """
    with tempfile.TemporaryDirectory(prefix="quadftc_") as folder:
        bag = Path(folder, "bag") if options.record else None
        traces = Path(folder, "traces")
        traces.mkdir()
        plan = GraphPlan(
            node_parameters(scenario, scheme),
            "realtime",
            bag=bag,
            traces=traces,
            scheduling=options.scheduling,
        )
        going_on = True

        def follow(samples: int) -> bool:
            nonlocal going_on
            going_on = progress(samples)
            return going_on

        with _graph(plan, options) as graph:
            if not graph.wait_until_connected(follow):
                return None
            usage = Usage(_processes(graph))
            wall_time = graph.run(follow)
            taken = usage.taken(wall_time)
            recorded = None if graph.recorder is None else graph.recorder.finish()
        if not going_on:
            return None
        found = {node: load_trace(traces / f"{node}.npz") for node in EXECUTABLES}
    result = latencies(found, scenario.rate)
    result.update(
        scenario=scenario.name,
        rate=scenario.rate,
        duration=scenario.duration,
        **dataclasses.asdict(options),
        observer=scheme.observer.kind,
        wall_time_s=round(wall_time, 3),
        usage=taken,
    )
    if recorded is not None:
        result["recorded"] = {
            "stored": sum(recorded.counts.values()),
            "dropped": sum(recorded.dropped.values()) + recorded.lost,
            "missing": unrecorded(found, recorded.counts),
        }
    return result


def latencies(traces: Traces, rate: float) -> dict[str, Any]:
    """Statistics of the traces of a flight at a rate [Hz].

    Returns
    -------
    dict
        ``stages``: by name ``p50``...``max`` and ``mean`` [us]; ``samples`` counted; ``missed``: without a
        torque of their own; ``late``: whose torque came after the next sample; ``lost``: messages that did
        not reach a reader, by topic and reader; ``histogram`` of the total.
    """
    ends = {end for both in STAGES.values() for end in both}
    times = {(node, event): _first_times(traces[node], event) for node, event in ends}
    emitted, answered = times["plant", "given plant/imu"], times["plant", "taken torque/command"]
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
    for row in TOPICS.values():
        given = {
            stamp
            for node in row.publishers
            for stamp in _first_times(traces.get(node, {}), f"given {row.name}")
        }
        for reader in row.readers:
            missing = (
                given
                - set(_first_times(traces.get(reader, {}), f"taken {row.name}"))
                - {max(given, default=0)}
            )
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
    values = np.percentile(nanoseconds, PERCENTILES) / MICROSECOND
    found = {f"p{level:g}": round(float(value), 1) for level, value in zip(PERCENTILES, values, strict=True)}
    found["max"] = round(float(np.max(nanoseconds)) / MICROSECOND, 1)
    found["mean"] = round(float(np.mean(nanoseconds)) / MICROSECOND, 1)
    return found


def histogram(nanoseconds: NDArray[np.int64], bins: int = 120) -> dict[str, list[float]]:
    """Counts between edges [us], evenly spaced on a logarithmic scale from 10 us to 1 s."""
    edges = np.geomspace(10.0, 1e6, bins + 1)
    counts, _ = np.histogram(nanoseconds / MICROSECOND, edges)
    return {"edges_us": [round(float(edge), 2) for edge in edges], "counts": counts.tolist()}


def _graph(plan: GraphPlan, options: LatencyOptions) -> ComposedGraph | ProcessGraph:
    if options.graph == "processes":
        return ProcessGraph(plan)
    return ComposedGraph(plan, executor=options.executor)


def _processes(graph: ComposedGraph | ProcessGraph) -> dict[str, int]:
    found = {"graph": os.getpid()}
    if isinstance(graph, ProcessGraph):
        found = {"recorder": os.getpid(), **graph.children.process_ids()}
    elif graph.recorder is not None and graph.recorder.process_id is not None:
        found["recorder"] = graph.recorder.process_id
    return found


def _first_times(trace: Mapping[str, NDArray[np.int64]], event: str) -> Times:
    """Times by stamp; a stamp that came more than once, with its first time."""
    rows = trace.get(event)
    return {} if rows is None else dict(rows[::-1].tolist())  # the last to be put in stays


def _between(begin: Times, end: Times, stamps: list[int]) -> NDArray[np.int64]:
    return np.array([end[stamp] - begin[stamp] for stamp in stamps if stamp in begin and stamp in end])
