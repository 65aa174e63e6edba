"""Nodes beside ArduPilot's simulation, which a stand-in plays: it sends pulses, and waits for each answer."""

import contextlib
import socket
import struct

import pytest

from quadftc_fdi.fault_observer_node import FaultObserverNode
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

    def fly(self):
        """Fly one period; return the answer."""
        lifted = CLIMB if self.count < RATE else HOVER
        rolled = ROLL if self.count % 40 in (*range(10), *range(30, 40)) else -ROLL
        pulses = [lifted + rolled * side for side in RIGHT]
        self._socket.send(struct.pack("<HHI16H", 18458, RATE, self.count, *pulses, *[0] * 12))
        self.count += 1
        return self._socket.recv(2048)


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
                for topic, message in backend.take():
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
