# pyright: basic
"""Flights in real time, a process for each node; nodes are killed, stopped or slowed, messages lost.

A flight begins with a healthy start, in which the observer learns the gyro bias. In each window of `WINDOW`
seconds a sensor fault or a disturbance acts, and a node is hit. The graph restarts dead nodes.
`quadftc_tools.soak.node_judgement` reads from the bag what came of it.
"""

from __future__ import annotations

import dataclasses
import os
import random
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from quadftc_flight.graph.plan import GraphPlan
from quadftc_flight.graph.processes import ProcessGraph
from quadftc_flight.scenario import Scenario, node_parameters, parse_scenario
from quadftc_ros.children import Children
from quadftc_ros.scheduling import ORDINARY, Scheduling, SchedulingError, scheduled
from quadftc_ros.topics import TOPICS
from quadftc_tools.soak.relay import DELAY, DROP, sent

KILL, STOP, STALL = "killed (SIGKILL)", "stopped for 0.5 s", "stalled 20 ms, ten times"
LOSE, HOLD_BACK = "5 % of all messages lost", "5 % of all messages 20 ms late"
ACTIONS = (KILL, STOP, STALL)
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
STRESSES = (*FAULTS, DISTURBANCE)
CONSTANT_DISTURBANCE = "kind: constant, amplitude: [0.05 N m, 0.04 N m, 0.015 N m]"
NODES = ("fault_observer", "disturbance_observer", "controller", "reference", "fault_injector")
NETWORK = "all"
RELAYED = (
    *("plant/imu", "imu/data", "imu/corrected", "fault/status", "disturbance/estimate"),
    *("attitude/reference", "torque/command"),
)  # what the nodes exchange with every sample

START, WINDOW = 5.0, 13.0  # s
ACTS = 9.5  # s; how long fault or disturbance acts in its window
FIRST, LAST = 1.5, 2.5  # s; between which a node is hit in its window
NETWORK_FOR = 5.0  # s; how long the network is bad
RATE, SLOWER = 250.0, 125.0  # Hz; with a relay, which doubles what a machine has to carry
PRIORITY = 20  # of SCHED_RR
STOPPED, STALLED, PAUSE, STALLS = 0.5, 0.02, 0.18, 10  # s, s, s, 1

BASE = """
name: soak_nodes
description: Faults of the software, on top of those of sensors and the world
vehicle: qball_x4
sensors: {grade: mems}
references:
  - {kind: step, angles: [3 deg, -2 deg, 5 deg], start: 1 s, stop: 3 s, rise: 1 s}
schemes:
  supervised:
    observer: supervised
    disturbance_observer: exosystem
    controller: ismc
"""


@dataclasses.dataclass(frozen=True)
class Hit:
    """What happens in one window."""

    node: str  # one of `NODES`, or `NETWORK`
    action: str  # of `ACTIONS`; `LOSE` or `HOLD_BACK` of the network, one of them in a flight at most
    stress: str  # what acts meanwhile, one of `STRESSES`


@dataclasses.dataclass
class Record:
    """When a hit was made, by the wall clock; a node that was killed is back after its end."""

    hit: Hit
    begin_ns: int = 0
    end_ns: int = 0
    until_ns: int = 0  # end of its window


def scenario_of(hits: Sequence[Hit], seed: int) -> Scenario:
    """Flight with a window for each hit."""
    rate = SLOWER if any(hit.node == NETWORK for hit in hits) else RATE
    faults: list[str] = []
    disturbances: list[str] = []
    for k, hit in enumerate(hits):
        times = f"start: {START + WINDOW * k:g} s, stop: {START + WINDOW * k + ACTS:g} s"
        if hit.stress in FAULTS:
            faults += [f"{fault}, {times}" for fault in FAULTS[hit.stress]]
        else:
            disturbances.append(times)
    return soak_scenario(BASE, faults, disturbances, rate, START + WINDOW * len(hits), seed)


def soak_scenario(
    base: str, faults: Sequence[str], disturbances: Sequence[str], rate: float, duration: float, seed: int
) -> Scenario:
    """Add faults of the attitude and constant disturbances to a scenario, whose ``base`` is YAML."""
    fault_items = (f"{{channel: attitude, {each}}}" for each in faults)
    disturbance_items = (f"{{{CONSTANT_DISTURBANCE}, {each}}}" for each in disturbances)
    lines = [base, f"rate: {rate:g} Hz", f"duration: {duration:g} s", f"seed: {seed}"]
    lines += [f"faults: [{', '.join(fault_items)}]", f"disturbances: [{', '.join(disturbance_items)}]"]
    return parse_scenario("\n".join(lines) + "\n")


class RelayedGraph(ProcessGraph):
    """A graph with a relay between its nodes, which the table of topics does not know."""

    def _missing(self) -> list[str]:
        return [lack for lack in super()._missing() if not self._is_relayed(lack)]

    @staticmethod
    def _is_relayed(lack: str) -> bool:
        return lack.endswith("readers") and any(f" {topic}: " in lack for topic in RELAYED)


def best_scheduling() -> Scheduling:
    """Real-time priority if the machine allows it: what else it does shall not count as a fault."""
    wanted = Scheduling(priority=PRIORITY)
    try:
        with scheduled(wanted):
            return wanted
    except SchedulingError:
        return ORDINARY


def fly(hits: Sequence[Hit], seed: int, bag: Path) -> list[Record]:
    """Fly and hit; the seed is that of the sensors, and of when nodes are hit in their windows.

    GraphError if the graph does not start or ends early.
    """
    parameters = node_parameters(scenario_of(hits, seed))
    network = [k for k, hit in enumerate(hits) if hit.node == NETWORK]
    generator, relay = random.Random(seed), Children()
    remapped: dict[str, dict[str, str]] = {}
    if network:
        for topic in RELAYED:
            remapped.setdefault(TOPICS[topic].publishers[0], {})[topic] = sent(topic)
        begin = START + WINDOW * network[0] + FIRST
        kind = DROP if hits[network[0]].action == LOSE else DELAY
        command = [
            sys.executable,
            "-m",
            "quadftc_tools.soak.relay",
            kind,
            f"{begin}",
            f"{begin + NETWORK_FOR}",
        ]
        relay.start({"relay": [*command, *RELAYED]})
    scheduling = best_scheduling()
    plan = GraphPlan(parameters, "realtime", bag=bag, scheduling=scheduling, respawn=True, remapped=remapped)
    records = [Record(hit) for hit in hits]
    delays = [generator.uniform(FIRST, LAST) for _ in hits]
    try:
        with (RelayedGraph if network else ProcessGraph)(plan) as graph:
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
    finally:
        relay.stop()
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
    if hit.node == NETWORK:
        time.sleep(NETWORK_FOR)
        return
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
