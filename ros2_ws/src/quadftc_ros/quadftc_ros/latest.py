# pyright: basic
"""The last message of each topic, and what can be drawn of them: attitudes, position, thrust of the rotors.

Messages come as bytes at the rate of the IMU, and are decoded only when somebody looks.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from nav_msgs.msg import Odometry

from quadftc_bags.cdr.message import NANOSECONDS, FieldReader, leading_stamp_ns
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.vehicle import Vehicle
from quadftc_ros.conversions import Floats
from quadftc_ros.motion_wire import RotorsReader
from quadftc_ros.rotor_wire import RotorConditionReader
from quadftc_ros.topics import GRAPHS, PlantKind
from quadftc_ros.wire import imu_of, vector_of

T = TypeVar("T")

ROLES = ("truth", "measured", "corrected")  # of attitudes
SOURCES = {"truth": "plant/attitude", "measured": "imu/data", "corrected": "imu/corrected"}
PLACES = ("plant/odometry", "position/data")  # the truth, else what is measured
SILENT_NS = NANOSECONDS // 2  # a topic that is so far behind the others is not shown


class Latest:
    """The last message of each topic of a vehicle that is shown; bytes of any topic can be put into it."""

    def __init__(self, vehicle: Vehicle, plant: PlantKind) -> None:
        self.vehicle = vehicle
        self.flies = plant == "free_flight"
        self._data: dict[str, tuple[int, bytes]] = {}  # by topic: stamp [ns] and message
        self._place, self._turn, self._rate = (
            FieldReader(Odometry, field)
            for field in ("pose.pose.position", "pose.pose.orientation_xyzw", "twist.twist.angular")
        )
        rotors = len(vehicle.rotors.positions)
        self._speeds, self._condition = RotorsReader(rotors), RotorConditionReader(rotors)
        self._none = np.zeros(rotors)

    @staticmethod
    def topics(plant: PlantKind) -> tuple[str, ...]:
        """Return the topics of a graph that `attitudes`, `position` and `thrusts` need."""
        thrust = ("rotors/speed", "rotors/fault") if plant == "free_flight" else ("torque/command",)
        wanted = (*SOURCES.values(), *PLACES, *thrust)
        return tuple(topic for topic in wanted if topic in GRAPHS[plant])

    def put(self, topic: str, data: bytes) -> None:
        """Take a message in CDR; what is too short for a stamp is none."""
        with contextlib.suppress(ValueError):
            self._data[topic] = leading_stamp_ns(data), data

    def forget(self) -> None:
        """Forget all messages."""
        self._data.clear()

    def stamp_ns(self) -> int:
        """Return the newest stamp [ns]; 0 if nothing has come."""
        return max((stamp_ns for stamp_ns, _ in self._data.values()), default=0)

    def read(self, topic: str, decode: Callable[[bytes], T]) -> T | None:
        """Return what a topic says now; None if it is silent, or says nothing that can be read."""
        stamp_ns, data = self._data.get(topic, (0, None))
        if data is None or self.stamp_ns() - stamp_ns > SILENT_NS:
            return None
        try:
            return decode(data)
        except ValueError:
            return None

    def attitudes(self) -> dict[str, Floats]:
        """Return the attitudes q_xyzw (4,) that there are, by their roles."""
        found: dict[str, Floats] = {}
        angles = self.read(SOURCES["truth"], vector_of)
        if angles is not None:
            found["truth"] = quaternion_from_euler(angles)
        elif (turn := self.read(PLACES[0], self._turn)) is not None:
            found["truth"] = np.array(turn[1])
        for role in ROLES[1:]:
            imu = self.read(SOURCES[role], imu_of)
            if imu is not None and imu.attitude_valid and np.all(np.isfinite(imu.q_xyzw)):
                found[role] = imu.q_xyzw
        return found

    def body_rate(self) -> Floats | None:
        """Return the true body rate (3,) [rad/s]."""
        rate = self.read("plant/rate", vector_of)
        if rate is None and (spin := self.read(PLACES[0], self._rate)) is not None:
            rate = np.array(spin[1])
        return rate

    def position(self) -> Floats:
        """Return the position (3,) [m]; the origin where there is none, as on a test stand."""
        for topic in PLACES:
            place = self.read(topic, self._place)
            if place is not None:
                return np.array(place[1])
        return np.zeros(3)

    def thrusts(self) -> Floats:
        """Return the thrust (n,) [N] of each rotor; 0: unknown.

        It follows from its speed and the condition it is in, on a test stand from the torque command.
        """
        rotors = self.vehicle.rotors
        if self.flies:
            speeds = self.read("rotors/speed", self._speeds)
            condition = self.read("rotors/fault", self._condition)
            left = 1.0 if condition is None else condition.effectiveness
            return self._none if speeds is None else rotors.thrust_coefficient * left * speeds**2
        torque = self.read("torque/command", vector_of)
        if torque is None:
            return self._none
        commands = rotors.command_trim + self.vehicle.allocation @ torque
        return np.clip(rotors.thrust_gain * (commands - rotors.command_idle), 0.0, None)
