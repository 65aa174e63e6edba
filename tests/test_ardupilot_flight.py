"""Nodes beside ArduPilot's simulation, which a stand-in plays: it sends pulses, and waits for each answer."""

import contextlib
import json
import socket
import struct
import threading
import time

import pytest

from quadftc_cli.commands.inject import clear, inject
from quadftc_cli.commands.watch import watch
from quadftc_fdi.fault_observer_node import FaultObserverNode
from quadftc_msgs.srv import InjectFault
from quadftc_sim.ardupilot_backend_node import ArduPilotBackendNode
from wired_node import Wired

RATE = 250  # Hz
CLIMB, HOVER, ROLL = 1850, 1770, 8  # us; pulses of an X500
RIGHT = (1, -1, -1, 1)  # of its rotors: those that lift the right side


class StandIn:
    """Flies as SITL does, over UDP: climbs for a second, then hovers, and rolls a little left and right."""

    def __init__(self, port):
        self.count = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(10.0)
        self._socket.connect(("127.0.0.1", port))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    def send(self):
        """Send the pulses of a period."""
        lifted = CLIMB if self.count < RATE else HOVER
        rolled = ROLL if self.count % 40 in (*range(10), *range(30, 40)) else -ROLL
        pulses = [lifted + rolled * side for side in RIGHT]
        self._socket.send(struct.pack("<HHI16H", 18458, RATE, self.count, *pulses, *[0] * 12))

    def receive(self):
        """Return an answer."""
        return self._socket.recv(2048)

    def fly(self):
        """Fly one period; return the answer."""
        self.send()
        self.count += 1
        return self.receive()


def published(backend, last):
    """Return what the backend publishes of a sample, up to its last topic: it answers SITL first."""
    found, end = [], time.monotonic() + 20.0
    while not found or found[-1][0] != last:
        assert time.monotonic() < end
        found += backend.take()
    return found


@contextlib.contextmanager
def beside(make, faults=(), **parameters):
    """A backend with faults, a node beside it, the stand-in, and a function that flies a time [s].

    It returns what the node has said, topic by topic.
    """
    with (
        Wired(ArduPilotBackendNode, "realtime", port=0, faults=[*faults]) as backend,
        Wired(make, "realtime", vehicle="x500", **parameters) as node,
        StandIn(backend.node.port) as sitl,
    ):

        def fly(duration):
            said = {}
            for _ in range(round(duration * RATE)):
                sitl.fly()
                for topic, message in published(backend, "wind/applied"):
                    if topic in node.topics:
                        node.feed(topic, message)
                for topic, message in node.take():
                    said.setdefault(topic, []).append(message)
            return said

        yield fly, backend


def named(said):
    """Components and elements of the last diagnosis."""
    return {f"{fault.component}/{fault.element}" for fault in said["diagnosis"][-1].faults}


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("bias channel=gyro axes=x value=0.3rad/s start=2s", {"gyro/x"}),
        ("bias channel=attitude axes=roll value=5deg start=2s", {"attitude/roll"}),
    ],
)
def test_observer_beside_sitl_tells_gyro_from_attitude(fault, expected):
    with beside(FaultObserverNode, [fault]) as (fly, _):
        assert named(fly(1.8)) == set()
        assert named(fly(0.7)) == expected


@pytest.fixture
def flying(bench):
    """A backend that the stand-in flies; what it says of the faults of its gyro."""
    backend = bench.run(ArduPilotBackendNode, port=0)
    told = bench.listen("fault/injected/gyro")
    bench.connect()
    over = threading.Event()

    def serve():
        while not over.is_set():
            bench._executor.spin_once(timeout_sec=0.05)

    def fly():
        with StandIn(backend.port) as sitl:
            while not over.is_set():
                sitl.fly()
                time.sleep(0.02)  # slowly: the commands run in this process, too

    threads = [threading.Thread(target=each) for each in (serve, fly)]
    for each in threads:
        each.start()
    yield told
    over.set()
    for each in threads:
        each.join()


def await_that(condition):
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_faults_come_and_go_by_command_while_sitl_flies(flying, capfd):
    inject(["bias", "channel=gyro", "axis=x", "value=0.3rad/s"])
    await_that(lambda: flying and flying[-1].vector.x == pytest.approx(0.3))
    watch(once=True)
    clear(1)
    await_that(lambda: flying[-1].vector.x == 0.0)
    injected, watched, cleared = capfd.readouterr().out.splitlines()
    assert injected == "fault 1: bias on gyro, until: quadftc clear 1"
    assert "measured" in watched
    assert "truth" in watched
    assert cleared == "1 ended"


def test_page_attaches_to_what_ardupilot_flies(flying):
    from quadftc_cli.live import LiveGraph
    from quadftc_cli.live_page.flying import page_of_running

    with LiveGraph() as graph:
        page = page_of_running(graph)
    assert (page.vehicle, page.plant, page.simulated) == ("x500", "free_flight", True)
    assert page.parts == "x500, observer none, flown by ArduPilot"
    assert page.home is None


def test_packet_that_sitl_repeats_while_it_waits_gets_one_answer():
    with Wired(ArduPilotBackendNode, "realtime", port=0) as backend, StandIn(backend.node.port) as sitl:
        with backend.node._faults.lock:  # as if laws were compiled
            for _ in range(3):
                sitl.send()
        assert json.loads(sitl.receive())["timestamp"] == 0.0
        sitl.count += 1
        assert json.loads(sitl.fly())["timestamp"] == 1 / RATE
        assert backend.node.physics.counts == {"frame_count repeated": 2}


def test_fault_that_is_put_on_before_sitl_starts_stays():
    with Wired(ArduPilotBackendNode, "realtime", port=0) as backend:
        request = InjectFault.Request(kind="bias", channel="gyro", axes=["x"], start=0.0)
        request.parameter_names, request.parameter_values = ["value"], [0.5]
        assert backend.call("inject", request).success
        with StandIn(backend.node.port) as sitl:
            answers = [json.loads(sitl.fly()) for _ in range(10)]
        assert answers[-1]["imu"]["gyro"][0] == pytest.approx(0.5, abs=0.1)
