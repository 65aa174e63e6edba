"""From the flight to the page: the last message of each topic, some 30 times a second.

The flight never waits for the page. What it has to do for a message is to keep a reference to its bytes; once
in a frame it hands all of them to the socket, or drops the frame if the page is behind.
"""

from __future__ import annotations

import contextlib
import pickle
import socket
import time
from typing import NamedTuple

from quadftc_ros.topics import GRAPHS, PlantKind, absolute
from quadftc_ros.transport import Take

PERIOD = 1.0 / 30.0  # s, between two frames
LARGEST = 1 << 16  # bytes of a frame
DIAGNOSTICS = "/diagnostics"  # of many nodes: every message counts
GUIDANCE = {"test_stand": "reference", "free_flight": "position_controller"}  # the node that follows sliders
TRIGGER = "control/status"  # the last that the controller says of a sample: its torque is out
SHOWN = (
    *("imu/data", "imu/corrected", "plant/attitude", "plant/rate", "plant/odometry", "position/data"),
    *("fault/status", "fault/injected", "diagnosis", "rotors/status", "rotors/fault", "rotors/speed"),
    *("torque/command", "attitude/reference", "position/reference", TRIGGER),
)


class Flown(NamedTuple):
    """What flies, for the page's heading and its controls."""

    title: str  # of the scenario
    parts: str  # vehicle, observer, controller
    vehicle: str  # name, or path of a TOML file
    plant: PlantKind
    namespace: str = ""
    home: tuple[float, ...] | None = None  # live setpoint at first, in SI; None: the scenario's is followed
    simulated: bool = True  # with plant and fault injector; False: a vehicle that exists


class Frame(NamedTuple):
    """What goes to the page at a time."""

    last: dict[str, bytes]  # by topic, those that are new
    diagnostics: list[bytes]
    vehicle: int = 0  # whose it is, of several


def shown_topics(plant: PlantKind) -> tuple[str, ...]:
    """Return the topics of a graph that the page shows."""
    return tuple(topic for topic in SHOWN if topic in GRAPHS[plant])


class Feed:
    """The end of the flight of a vehicle, by its number if there are several.

    ``tap`` is what `quadftc_ros.transport` calls a tap.
    """

    def __init__(self, channel: socket.socket, namespace: str, plant: PlantKind, vehicle: int = 0) -> None:
        self._channel, self._vehicle = channel, vehicle
        self._channel.setblocking(False)
        self._topics = {absolute(namespace, topic): topic for topic in shown_topics(plant)}
        self._frame = Frame({}, [], vehicle)
        self._due = 0.0

    def tap(self, full_name: str) -> Take | None:
        """Return what takes the messages of a topic; None if the page does not show it."""
        if full_name == DIAGNOSTICS:
            return self._note
        if (topic := self._topics.get(full_name)) is None:
            return None

        def take(data: bytes) -> None:
            self._frame.last[topic] = data
            if topic == TRIGGER and time.monotonic() >= self._due:
                self.send()

        return take

    def _note(self, data: bytes) -> None:
        self._frame.diagnostics.append(data)

    def send(self) -> None:
        """Hand over what has come since the last frame."""
        self._due = time.monotonic() + PERIOD
        frame, self._frame = self._frame, Frame({}, [], self._vehicle)
        with contextlib.suppress(OSError):  # the page is behind, or closed
            self._channel.send(pickle.dumps(tuple(frame), pickle.HIGHEST_PROTOCOL))


def receive(channel: socket.socket) -> Frame | None:
    """Return a frame that has come; None if the flight is over."""
    data = channel.recv(LARGEST)
    return Frame(*pickle.loads(data)) if data else None  # of the process that started this one
