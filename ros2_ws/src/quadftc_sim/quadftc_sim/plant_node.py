# pyright: basic
"""The plant node: flies the simulated vehicle and publishes its IMU.

Inputs: torque/command; fault/dropped (a sample that nobody will answer, in lock-step).
Outputs: plant/imu; the truth on plant/attitude, plant/rate and disturbance/applied; /clock in lock-step.
Services: ~/start, ~/reset (std_srvs/Trigger: a new flight begins). In lock-step the stamps begin anew, by
which the other nodes know it. In real time the plant pauses until their laws take the next sample for the
first; the schedules of faults and references begin anew if ~/reset of fault_injector and reference is called.

The plant makes time: it does not follow /clock, whatever use_sim_time says.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from quadftc_model.parameters import parameter
from quadftc_model.stepper import MAX_GAP, seconds
from quadftc_ros.conversions import (
    BASE_FRAME,
    EARTH_FRAME,
    NANOSECONDS,
    Floats,
    is_finite,
)
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode, missing_connections
from quadftc_ros.wire import ImuWire, VectorWire, vector_of
from quadftc_sim.assembly import EPOCH_NS, sample_count, simulator_from
from quadftc_sim.plant import Plant
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import Emission

LATE = 0.1  # s; real time: from when on a flight behind the wall clock is reported
PAUSE = MAX_GAP + 0.2  # s; real time: between two flights, so that the laws of all nodes start anew


@dataclasses.dataclass(frozen=True)
class PlantParameters:
    """Parameters of the node besides those of :class:`Plant` and, behind ``imu.``, :class:`ImuSensor`."""

    vehicle: str = parameter("qball_x4", doc="name of a vehicle, or path of its TOML file")
    rate: float = parameter(250.0, unit="Hz", low=10.0, high=4000.0, doc="control rate")
    duration: float = parameter(0.0, unit="s", low=0.0, doc="length of the flight; 0: without end")
    seed: int = parameter(0, low=0, doc="of the sensor's noise and bias")
    autostart: bool = parameter(True, doc="start as soon as the graph is connected; else wait for ~/start")
    torque_timeout: float = parameter(
        0.5,
        unit="s",
        low=0.0,
        doc="real time: zero torque when none has come for so long, as a motor controller does",
    )


class PlantNode(GraphNode):
    """Simulated vehicle with its IMU; the only node with a clock of its own.

    Parameters
    ----------
    each_sample : callable, optional
        Called after each emission, by whoever runs the node and wants to look at the flight now and then.
    **kwargs
        Those of `GraphNode`.
    """

    def __init__(self, each_sample: Callable[[], None] | None = None, **kwargs: Any) -> None:
        super().__init__("plant", **kwargs)
        self._each_sample = each_sample
        self.settings.declare(PlantParameters, read_only=True)
        self.settings.declare(Plant, read_only=True)
        self.settings.declare(ImuSensor, "imu.", read_only=True)
        self.settings.declare_list(
            "disturbances", "each: kind key=value..., e.g. 'constant start=5s amplitude=0.1Nm'"
        )
        self._values = self.settings.values()
        self._publish_imu = self.publishes("plant/imu")
        self._publish_attitude = self.publishes("plant/attitude")
        self._publish_rate = self.publishes("plant/rate")
        self._publish_disturbance = self.publishes("disturbance/applied")
        self._publish_clock = self.publishes("/clock") if self.lockstep else None
        self._imu, self._body, self._earth = ImuWire(), VectorWire(BASE_FRAME), VectorWire(EARTH_FRAME)
        self._clock_message = Clock()
        self.reads("torque/command", self._on_torque, decode=vector_of)
        self.reads("fault/dropped", self._on_dropped)
        self.offers("start", Trigger, self._on_start)
        self.offers_reset(self._restart, "a new flight begins")
        self._timer: Any = None
        self._torque_level: bytes | None = None
        self._clear()
        self._simulator = simulator_from(self._values, EPOCH_NS)
        self._waiting: Any = None
        if self._values["autostart"]:
            self._waiting = self.create_timer(0.05, self._start_when_connected, clock=self.steady_clock)
        self.ready()

    @property
    def finished(self) -> bool:
        """Whether the flight has had its length."""
        return self._finished

    @property
    def samples(self) -> int:
        """Emissions so far."""
        return self._emitted

    def start(self) -> None:
        """Begin the flight.

        Raises
        ------
        RuntimeError
            If it has begun already.
        """
        if self._emitted:
            raise RuntimeError("the flight has begun already")
        self._stop_waiting()
        self._simulator = simulator_from(self._values, EPOCH_NS if self.lockstep else time.time_ns())
        self._begin_ns = time.monotonic_ns()
        self._emit(self._simulator.start())
        if not self.lockstep:
            period = seconds(self._simulator.period_ns)
            self._timer = self.create_timer(period, self._on_timer, clock=self.steady_clock)
        elif self._awaited_ns is None:  # the sensor is late: its first sample comes after the first period
            self._advance()

    def _clear(self) -> None:
        self._torque, self._torque_age = np.zeros(3), 0.0  # last command [N m], and how long ago it came [s]
        self._awaited_ns: int | None = None  # lock-step: stamp of the sample whose torque is missing
        self._emitted, self._finished = 0, False
        self._begin_ns = 0  # monotonic clock, at the first emission
        self._count = sample_count(self._values["duration"], self._values["rate"])  # 0: without end

    def _restart(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._stop_waiting()
        self._clear()
        if self.lockstep:
            self.start()
        else:
            self._waiting = self.create_timer(PAUSE, self._start_waiting, clock=self.steady_clock)

    def _start_when_connected(self) -> None:
        if not missing_connections(self.get_name(), self.connections()):
            self._start_waiting()

    def _start_waiting(self) -> None:
        """Begin the flight, if the timer has not done so: one that is late may come twice."""
        if not self._emitted:
            self.start()

    def _stop_waiting(self) -> None:
        if self._waiting is not None:
            self.destroy_timer(self._waiting)
            self._waiting = None

    def _on_torque(self, stamp_ns: int, torque: Floats) -> None:
        if is_finite(torque):
            self._torque, self._torque_age = torque, 0.0
        else:
            self.diagnostics.count("torque/command: not finite")
        if stamp_ns == self._awaited_ns:
            self._advance()

    def _on_dropped(self, stamp_ns: int, message: Any) -> None:
        if stamp_ns == self._awaited_ns:
            self._advance()

    def _on_timer(self) -> None:
        if self._finished:
            return
        self._torque_age += seconds(self._simulator.period_ns)
        if self._torque_age > self._values["torque_timeout"]:
            self._torque = np.zeros(3)
            self._note_torque(ERROR, "torque/command does not come: zero torque")
        else:
            self._note_torque(OK, "torque/command comes")
        self._advance()
        if not self._finished and time.monotonic_ns() >= self._due_ns():
            self._advance()  # a timer that is late by a period skips it; the flight does not

    def _due_ns(self) -> int:
        """When the next emission is due, by the monotonic clock."""
        return self._begin_ns + self._emitted * self._simulator.period_ns

    def _note_torque(self, level: bytes, words: str) -> None:
        if level != self._torque_level:
            self._torque_level = level
            self.diagnostics.report("torque", level, words)

    def _advance(self) -> None:
        """Fly one period; in lock-step on to the next sample that somebody will answer."""
        self._awaited_ns = None
        while not self._finished and self._awaited_ns is None:
            if self._count and self._emitted >= self._count:
                self._finish()
                return
            self._emit(self._simulator.advance(self._torque))
            if not self.lockstep:
                return

    def _emit(self, emission: Emission) -> None:
        self._emitted += 1
        now = emission.stamp_ns
        if self._publish_clock is not None:
            self._clock_message.clock.sec, self._clock_message.clock.nanosec = divmod(now, NANOSECONDS)
            self._publish_clock(self._clock_message)
        if emission.sample is not None:  # first, as others wait for it
            self._awaited_ns = emission.sample_stamp_ns if self.lockstep else None
            self._publish_imu(self._imu(emission.sample_stamp_ns, emission.sample))
        self._publish_attitude(self._earth(now, emission.angles))
        self._publish_rate(self._body(now, emission.body_rate))
        self._publish_disturbance(self._body(now, emission.disturbance))
        self.sampled(now)
        if self._each_sample is not None:
            self._each_sample()

    def report(self) -> None:
        """Report how far the flight is, and in real time how far behind the wall clock."""
        level, words = OK, "finished" if self._finished else "flying" if self._emitted else "not started"
        values: dict[str, object] = {"samples": self._emitted}
        if not self.lockstep and self._emitted and not self._finished:
            behind = seconds(time.time_ns() - self._simulator.stamp_ns)
            values["behind_s"] = f"{behind:.3f}"
            if behind > LATE:
                level, words = WARN, "flying, behind the wall clock"
        self.diagnostics.report("flight", level, words, **values)

    def _finish(self) -> None:
        self._finished = True
        self.diagnostics.changed = True
        self.sampled(self._simulator.stamp_ns)

    def _on_start(self, request: Any, response: Any) -> Any:
        if self._emitted:
            response.success, response.message = False, "the flight has begun already"
            return response
        self.start()
        response.success, response.message = True, "started"
        return response


def main() -> None:
    """Run the node."""
    sys.exit(run_node(PlantNode))
