# pyright: basic
"""`scripts/soak nodes`: nodes killed, stopped and slowed in flight; in real time, a process for each node.

A flight begins with a healthy start, in which the observer learns the gyro bias. In each window of `WINDOW`
seconds a sensor fault or a disturbance acts, and a node is hit. The graph restarts dead nodes.
`quadftc_tools.soak.node_judgement` reads from the bag what came of it.
"""

from __future__ import annotations

import itertools
import os
import random
import signal
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.scenario import Scenario, node_parameters
from quadftc_tools.soak.flights import best_scheduling, choose, soak_scenario
from quadftc_tools.soak.node_judgement import KILL, Hit, Judge, Record, Trial

STOP, STALL = "stopped for 0.5 s", "stalled 20 ms, ten times"
SENSOR_FAULT, CHANGING_FAULT, DISTURBANCE = "sensor fault", "changing fault", "disturbance"
FAULTS = {
    SENSOR_FAULT: ("kind: bias, axes: roll, value: 2 deg", "kind: bias, axes: pitch, value: -3 deg"),
    CHANGING_FAULT: (  # by steps, that it is found at once: how soon is not the question here
        "kind: bias, axes: roll, value: 2 deg",
        "kind: sine, axes: roll, amplitude: 1.5 deg, frequency: 1 rad/s",
        "kind: bias, axes: pitch, value: -2 deg",
        "kind: drift, axes: pitch, rate: -0.2 deg/s",
    ),
}
NODES = ("fault_observer", "disturbance_observer", "controller", "reference", "fault_injector")
ALL = tuple(
    Hit(node, action, stress)
    for stress in (*FAULTS, DISTURBANCE)
    for action in (KILL, STOP, STALL)
    for node in NODES
)

START, WINDOW = 5.0, 13.0  # s
ACTS = 9.5  # s; how long fault or disturbance acts in its window
FIRST, LAST = 1.5, 2.5  # s; between which a node is hit in its window
STOPPED, STALLED, PAUSE, STALLS = 0.5, 0.02, 0.18, 10  # s, s, s, 1
TOGETHER = 3  # hits in a flight


def soak(trials: int, seed: int, only: str) -> Iterator[Trial]:
    """Hit so many times, in turn all that has ``only`` in its name; ValueError if that leaves nothing."""
    named = {f"{hit.node} {hit.action} {hit.stress}": hit for hit in ALL}
    chosen = [named[name] for name in choose(named, only)]
    for number, hits in enumerate(flights_of(chosen, trials, random.Random(seed))):
        yield from fly_and_judge(hits, seed * 1000 + number)


def flights_of(chosen: Sequence[Hit], trials: int, generator: random.Random) -> Iterator[list[Hit]]:
    """Hits in an order that is drawn, so many together as fit."""
    rounds = (generator.sample(chosen, len(chosen)) for _ in itertools.count())
    hits = itertools.islice(itertools.chain.from_iterable(rounds), trials)
    while together := list(itertools.islice(hits, TOGETHER)):
        yield together


def fly_and_judge(hits: Sequence[Hit], seed: int) -> list[Trial]:
    """Fly once, and judge."""
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        bag = Path(folder, "bag")
        records = fly(hits, seed, bag)
        judge = Judge(bag)
        return [judge.judge(record) for record in records]


def scenario_of(hits: Sequence[Hit], seed: int) -> Scenario:
    """Flight with a window for each hit."""
    faults: list[str] = []
    disturbances: list[str] = []
    for k, hit in enumerate(hits):
        times = f"start: {START + WINDOW * k:g} s, stop: {START + WINDOW * k + ACTS:g} s"
        if hit.stress in FAULTS:
            faults += [f"{fault}, {times}" for fault in FAULTS[hit.stress]]
        else:
            disturbances.append(times)
    return soak_scenario(faults, disturbances, START + WINDOW * len(hits), seed)


def fly(hits: Sequence[Hit], seed: int, bag: Path) -> list[Record]:
    """Fly and hit; the seed is that of the sensors, and of when nodes are hit in their windows.

    GraphError if the graph does not start or ends early.
    """
    generator = random.Random(seed)
    parameters = node_parameters(scenario_of(hits, seed))
    plan = GraphPlan(parameters, "realtime", bag=bag, scheduling=best_scheduling(), respawn=True)
    records = [Record(hit) for hit in hits]
    delays = [generator.uniform(FIRST, LAST) for _ in hits]
    with ProcessGraph(plan) as graph:
        over = threading.Event()
        hitter = threading.Thread(target=_hit_all, args=(graph, records, delays, over))

        def follow(samples: int) -> bool:
            if samples and hitter.ident is None:
                hitter.start()
            return True

        try:
            graph.run(follow)
        finally:
            over.set()
            if hitter.ident is not None:
                hitter.join()
    return records


def _hit_all(
    graph: ProcessGraph, records: Sequence[Record], delays: Sequence[float], over: threading.Event
) -> None:
    """Make one hit after the other, in a thread beside that of the graph.

    The first sample is reported with a delay of up to a second, within which all windows begin.
    """
    begin = time.time()
    for k, (record, delay) in enumerate(zip(records, delays, strict=True)):
        opens = begin + START + WINDOW * k
        if over.wait(max(0.0, opens + delay - time.time())):
            return
        record.until_ns = round((opens + WINDOW - 1.0) * 1e9)
        record.begin_ns = time.time_ns()
        _act(graph, record.hit)
        record.end_ns = time.time_ns()


def _act(graph: ProcessGraph, hit: Hit) -> None:
    process = graph.children.process_ids()[hit.node]
    if hit.action == KILL:
        os.kill(process, signal.SIGKILL)
    elif hit.action == STOP:
        _pause(process, STOPPED)
    else:
        for _ in range(STALLS):
            _pause(process, STALLED)
            time.sleep(PAUSE)


def _pause(process: int, duration: float) -> None:
    os.kill(process, signal.SIGSTOP)
    try:
        time.sleep(duration)
    finally:
        os.kill(process, signal.SIGCONT)
