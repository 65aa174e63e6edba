# pyright: basic
"""`scripts/soak recorder` and `scripts/soak disk`: recorders killed or out of disk at random times.

| form | who is hit |
|---|---|
| ``node, real time`` | the recorder as a process of its own, and the one that builds its bag |
| ``node, lock-step`` | the same; the messages come at a fifth to four times real time |
| ``composed, real time`` | the process that builds the bag of a composed graph; the graph flies on |
| ``composed, lock-step`` | the same |

A full disk is a limit to the size of files (RLIMIT_FSIZE), set at the hit to the size of the bag.
"""

from __future__ import annotations

import dataclasses
import os
import random
import resource
import signal
import subprocess
import tempfile
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from uuid import uuid4

import psutil
from mcap.reader import make_reader
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosbags.highlevel import AnyReader

from quadftc_bags.bag import BagError, read_bag
from quadftc_bags.interfaces import load_message_class
from quadftc_bags.repair import repair
from quadftc_flight.graph.composed import ComposedGraph
from quadftc_flight.graph.plan import GraphError, GraphPlan
from quadftc_flight.graph.processes import executable_path
from quadftc_flight.scenario import find_scenario, load_scenario, node_parameters
from quadftc_ros.conversions import NANOSECONDS, stamp_of, time_message
from quadftc_ros.qos import topic_profile
from quadftc_ros.topics import TOPICS

FORMS = NODE, NODE_LOCKSTEP, COMPOSED, COMPOSED_LOCKSTEP = tuple(
    f"{recorder}, {clock}" for recorder in ("node", "composed") for clock in ("real time", "lock-step")
)
KILLED, DISK_FULL = "recorder killed (SIGKILL)", "disk full"
FORMS_HIT = {KILLED: FORMS, DISK_FULL: (COMPOSED, COMPOSED_LOCKSTEP)}
ALLOWED = 1.0  # s; that a recorder may lose
EARLIEST, LATEST = 0.1, 4.0  # s, wall time after the first message at which a recorder is hit
SPEEDS = 0.2, 4.0  # of the messages in lock-step, as multiples of real time
SENT = ("plant/rate", "torque/command", "control/status")  # topics, all reliable
PERIOD_NS = 4_000_000
START_NS = NANOSECONDS  # first stamp
PATIENCE = 30.0  # s; for a process to be there
SCENARIO = "paper_faults"  # 80 s: in lock-step, too, more than is needed
FLOWN_ON = 500  # samples that a flight has to go on when its recorder has been hit


@dataclasses.dataclass(frozen=True)
class Trial:
    """One recorder that was killed, or ran out of disk."""

    form: str  # one of `FORMS`
    after_s: float  # from the first message to the hit
    lost_s: float  # age of the newest message in the repaired bag at the hit; if there is none, ``after_s``
    lost_stamps_s: float  # by which the stamps went on meanwhile; in real time the same
    messages: int  # in the repaired bag
    wrong: str  # with the repaired bag, or with the flight that should have gone on; empty if nothing


@dataclasses.dataclass
class _Flight:
    """What was sent to a recorder until it was hit; times are wall time."""

    topics: tuple[str, ...]  # on which every stamp was sent
    times_ns: list[int] = dataclasses.field(default_factory=list)  # when each stamp was sent
    stamps_ns: list[int] = dataclasses.field(default_factory=list)
    hit_ns: int = 0
    wrong: str = ""

    def add(self, stamp_ns: int) -> None:
        self.times_ns.append(time.time_ns())
        self.stamps_ns.append(stamp_ns)


def try_recorder(form: str, hit: str, generator: random.Random) -> Trial:
    """Record in one of `FORMS`, hit the recorder at a random time, repair the bag, and read it.

    ``hit`` is `KILLED`, or `DISK_FULL` for composed forms. GraphError if the graph or the recorder does not
    start.
    """
    after, lockstep = generator.uniform(EARLIEST, LATEST), form in (NODE_LOCKSTEP, COMPOSED_LOCKSTEP)
    speed = SPEEDS[0] * (SPEEDS[1] / SPEEDS[0]) ** generator.random() if form == NODE_LOCKSTEP else 1.0
    with tempfile.TemporaryDirectory(prefix="quadftc_soak_") as folder:
        bag = Path(folder, "bag")
        if form in (NODE, NODE_LOCKSTEP):
            flight = _kill_node(bag, lockstep, after, speed)
        else:
            flight = _hit_composed_graph(bag, lockstep, after, hit)
        log_times_ns, wrong = _read_repaired(bag, flight.topics)
    newest_ns, last = max(log_times_ns, default=0), 0
    if lockstep:  # log times are stamps
        last = max(0, bisect_right(flight.stamps_ns, newest_ns) - 1)
        newest_ns = flight.times_ns[last]
    lost = max(0, flight.hit_ns - max(newest_ns, flight.times_ns[0])) / NANOSECONDS
    behind = (flight.stamps_ns[-1] - flight.stamps_ns[last]) / NANOSECONDS if lockstep else lost
    return Trial(
        form,
        (flight.hit_ns - flight.times_ns[0]) / NANOSECONDS,
        lost,
        behind,
        len(log_times_ns),
        "; ".join(filter(None, (flight.wrong, wrong, "too much is lost" * (lost > ALLOWED)))),
    )


def _kill_node(bag: Path, lockstep: bool, after: float, speed: float) -> _Flight:
    """Send messages to a recorder that is a process, and kill it."""
    mode = "lockstep" if lockstep else "realtime"
    namespace = f"/soak_{uuid4().hex}"
    command = [str(executable_path("quadftc_ros", "recorder")), "--ros-args", "-r", f"__ns:={namespace}"]
    command += ["-p", f"directory:={bag}", "-p", f"mode:={mode}"]
    context = Context()
    context.init()
    node = Node("soak", context=context, namespace=namespace, use_global_arguments=False)
    try:
        publishers = {
            topic: node.create_publisher(
                load_message_class(TOPICS[topic].type_name), topic, topic_profile(TOPICS[topic].qos, mode)
            )
            for topic in SENT
        }
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
            try:
                _wait_until(lambda: all(p.get_subscription_count() for p in publishers.values()), process)
                flight = _send(publishers, after, speed)
            finally:
                for each in (*psutil.Process(process.pid).children(), process):
                    each.kill()
            flight.hit_ns = time.time_ns()
        return flight
    finally:
        node.destroy_node()
        context.try_shutdown()


def _send(publishers: dict[str, Publisher], after: float, speed: float) -> _Flight:
    """Send messages for a time [s]."""
    flight = _Flight(SENT)
    begin = now = time.monotonic()
    while now < begin + after:
        stamp_ns = START_NS + len(flight.stamps_ns) * PERIOD_NS
        for topic, publisher in publishers.items():
            message = load_message_class(TOPICS[topic].type_name)()
            message.header.stamp = time_message(stamp_ns)
            publisher.publish(message)
        flight.add(stamp_ns)
        due = begin + len(flight.stamps_ns) * PERIOD_NS / NANOSECONDS / speed
        time.sleep(max(0.0, min(due, begin + after) - time.monotonic()))
        now = time.monotonic()
    return flight


def _wait_until(done: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + PATIENCE
    while not done():
        if process.poll() is not None or time.monotonic() > end:
            raise GraphError("the recorder did not start")
        time.sleep(0.01)


def _hit_composed_graph(bag: Path, lockstep: bool, after: float, hit: str) -> _Flight:
    """Fly, hit the process that builds the bag, fly on."""
    scenario = load_scenario(find_scenario(SCENARIO))
    parameters = node_parameters(scenario, scenario.scheme(None))
    flight = _Flight(("plant/rate",))
    flown = [0, 0]  # samples; those before the recorder was hit
    with ComposedGraph(GraphPlan(parameters, "lockstep" if lockstep else "realtime", bag=bag)) as graph:
        recorder = graph.recorder
        assert recorder is not None
        path, victim = recorder.path, recorder.process_id
        assert victim is not None

        def follow(samples: int) -> bool:
            flown[0] = samples
            if samples and not flight.hit_ns:
                flown[1] = samples
                flight.add(START_NS + round((samples - 1) * NANOSECONDS / scenario.rate))
                if time.time_ns() - flight.times_ns[0] > after * NANOSECONDS:
                    _hit(victim, path, hit)
                    flight.hit_ns = time.time_ns()
            return flown[0] - flown[1] < FLOWN_ON

        graph.run(follow)
        status = recorder.finish()
    if not flight.hit_ns:
        raise GraphError(f"the flight ended before {after:.1f} s had passed")
    if flown[0] - flown[1] < FLOWN_ON:
        flight.wrong = f"only {flown[0] - flown[1]} samples were flown after the recorder was hit"
    elif status.error is None:
        flight.wrong = "that the recording stopped was not reported"
    return flight


def _hit(process: int, file: Path, hit: str) -> None:
    if hit == KILLED:
        os.kill(process, signal.SIGKILL)
    else:
        size = file.stat().st_size
        resource.prlimit(process, resource.RLIMIT_FSIZE, (size, size))


def _read_repaired(bag: Path, topics: tuple[str, ...]) -> tuple[list[int], str]:
    """Repair a bag; return the log times in the new one [ns], and what is wrong with it."""
    try:
        out = repair(bag).out or bag
    except BagError as error:
        return [], str(error) if read_bag(bag).topics else ""
    try:
        with AnyReader([out]) as reader:
            found = [
                (link.topic, time_ns, reader.deserialize(data, link.msgtype))
                for link, time_ns, data in reader.messages()
            ]
            told = reader.message_count
        with (out / f"{out.name}_0.mcap").open("rb") as stream:
            read = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
    except Exception as error:  # whatever the libraries find wrong with it
        return [], f"unreadable: {type(error).__name__}: {error}"
    wrong = f"{told} messages told, {len(found)} and {read} read" if {told, read} != {len(found)} else ""
    for topic in topics:
        stamps = [stamp_of(message) for name, _, message in found if name.endswith(f"/{topic}")]
        if any(later - earlier != PERIOD_NS for earlier, later in pairwise(stamps)):
            wrong = wrong or f"{topic}: messages are missing in between"
    return [time_ns for _, time_ns, _ in found], wrong


def soak(hit: str, trials: int, seed: int) -> Iterator[Trial]:
    """Hit so many recorders, of each form in turn."""
    generator, forms = random.Random(seed), FORMS_HIT[hit]
    for number in range(trials):
        yield try_recorder(forms[number % len(forms)], hit, generator)
