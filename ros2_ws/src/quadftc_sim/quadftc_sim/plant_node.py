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

from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from quadftc_model.parameters import parameter
from quadftc_model.samples import is_usable
from quadftc_model.stepper import MAX_GAP, seconds
from quadftc_ros.conversions import NANOSECONDS, Floats
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.node import GraphNode
from quadftc_ros.topics import BASE_FRAME, EARTH_FRAME, missing_connections
from quadftc_ros.wire import ImuWire, VectorWire, vector_of
from quadftc_sim.assembly import EPOCH_NS, sample_count, simulator_from
from quadftc_sim.plant import Plant
from quadftc_sim.plant_flight import NEVER_NS, PlantFlight
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
    timed : bool
        Real time: a timer of the node's own calls `tick`; otherwise whoever runs the node does, at `due_ns`.
    **kwargs
        Those of `GraphNode`.
    """

    def __init__(
        self, each_sample: Callable[[], None] | None = None, timed: bool = True, **kwargs: Any
    ) -> None:
        super().__init__("plant", **kwargs)
        self._each_sample, self._timed = each_sample, timed
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
        self._waiting: Any = None
        self._torque_level: bytes | None = None
        self._flight = self._new_flight(EPOCH_NS)
        self._stamp_ns = EPOCH_NS  # of the last emission
        self._rests_until_ns = 0  # real time: does not emit before, however late
        self._unshown: Emission | None = None  # real time: whose truth is still to be published
        if self._values["autostart"]:
            self._waiting = self.create_timer(0.05, self._start_when_connected, clock=self.steady_clock)
        self.ready()

    @property
    def finished(self) -> bool:
        """Whether the flight has had its length."""
        return self._flight.finished

    @property
    def samples(self) -> int:
        """Emissions so far."""
        return self._flight.emitted

    @property
    def due_ns(self) -> int:
        """When :meth:`tick` is due, by the monotonic clock [ns]; in lock-step never.

        A flight that is late catches up at twice its rate: others have to keep up with it.
        """
        if self.lockstep or not self._flight.emitted:
            return NEVER_NS
        return max(self._flight.due_ns, self._rests_until_ns)

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample has not come."""
        return self._flight.unanswered

    def start(self) -> None:
        """Begin the flight.

        Raises
        ------
        RuntimeError
            If it has begun already.
        """
        if self._flight.emitted:
            raise RuntimeError("the flight has begun already")
        self._stop_waiting()
        self._flight = self._new_flight(EPOCH_NS if self.lockstep else time.time_ns())
        if self.lockstep:
            self._advance()
            return
        if self._timed:
            period = seconds(self._flight.period_ns)
            self._timer = self.create_timer(period, self._on_timer, clock=self.steady_clock)
        self._emit()

    def tick(self) -> None:
        """Real time: emit the next sample; zero torque has acted if none has come for too long."""
        flight = self._flight
        self._rests_until_ns = time.monotonic_ns() + flight.period_ns // 2
        flight.wait()
        if flight.torque_lost:
            self._note_torque(ERROR, "torque/command does not come: zero torque")
        else:
            self._note_torque(OK, "torque/command comes")
        self._emit()

    def _new_flight(self, epoch_ns: int) -> PlantFlight:
        values = self._values
        simulator = simulator_from(values, epoch_ns)
        count = sample_count(values["duration"], values["rate"])
        return PlantFlight(simulator, count, values["torque_timeout"], time.monotonic_ns())

    def _restart(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._stop_waiting()
        self._flight, self._unshown = self._new_flight(EPOCH_NS), None
        if self.lockstep:
            self.start()
        else:
            self._waiting = self.create_timer(PAUSE, self._start_waiting, clock=self.steady_clock)

    def _start_when_connected(self) -> None:
        if not missing_connections(self.get_name(), self.connections()):
            self._start_waiting()

    def _start_waiting(self) -> None:
        """Begin the flight, if the timer has not done so: one that is late may come twice."""
        if not self._flight.emitted:
            self.start()

    def _stop_waiting(self) -> None:
        if self._waiting is not None:
            self.destroy_timer(self._waiting)
            self._waiting = None

    def _on_torque(self, stamp_ns: int, torque: Floats) -> None:
        flight = self._flight
        if is_usable(torque):
            flight.command(torque)
        else:
            self.diagnostics.count("torque/command: not finite")
        if stamp_ns != flight.awaited_ns:
            return
        if self.lockstep:
            self._advance()
        else:
            self._show()
            flight.fly_ahead()

    def _on_dropped(self, stamp_ns: int, message: Any) -> None:
        if self.lockstep and stamp_ns == self._flight.awaited_ns:
            self._advance()

    def _on_timer(self) -> None:
        """Emit what is due: a timer that is late by periods skips them; the flight does not.

        Its clock and ours may drift apart, so that it does not come at the due time: half a period decides.
        """
        if self._timer is None:  # it was due already when the flight was reset
            return
        half = self._flight.period_ns // 2
        for _ in range(2):  # not more at a time, so that others get to work, too
            if time.monotonic_ns() + half >= self._flight.due_ns:
                self.tick()

    def _note_torque(self, level: bytes, words: str) -> None:
        if level != self._torque_level:
            self._torque_level = level
            self.diagnostics.report("torque", level, words)

    def _advance(self) -> None:
        """Lock-step: emit the next sample that somebody will answer, and what comes before it."""
        self._emit()
        while self._flight.awaited_ns is None and not self._flight.finished:
            self._emit()

    def _emit(self) -> None:
        """Publish what comes next; in real time its truth later, when nobody waits for anything."""
        self._show()
        emission = self._flight.emission()
        if emission is None:
            self.diagnostics.changed = True
            self.sampled(self._stamp_ns)
            return
        self._unshown, self._stamp_ns = emission, emission.stamp_ns
        if self._publish_clock is not None:
            self._clock_message.clock.sec, self._clock_message.clock.nanosec = divmod(
                emission.stamp_ns, NANOSECONDS
            )
            self._publish_clock(self._clock_message)
        if emission.sample is not None:  # first, as others wait for it
            self._publish_imu(self._imu(emission.sample_stamp_ns, emission.sample))
        if self.lockstep:
            self._show()

    def _show(self) -> None:
        """Publish the truth of the last emission, if that has not been done."""
        emission, self._unshown = self._unshown, None
        if emission is None:
            return
        now = emission.stamp_ns
        self._publish_attitude(self._earth(now, emission.angles))
        self._publish_rate(self._body(now, emission.body_rate))
        self._publish_disturbance(self._body(now, emission.disturbance))
        self.sampled(now)
        if self._each_sample is not None:
            self._each_sample()

    def report(self) -> None:
        """Report how far the flight is, and in real time how far behind the clock."""
        flight = self._flight
        level, words = OK, "finished" if flight.finished else "flying" if flight.emitted else "not started"
        values: dict[str, object] = {"samples": flight.emitted}
        if not self.lockstep and flight.emitted and not flight.finished:
            behind = max(0.0, seconds(time.monotonic_ns() - flight.due_ns))
            values["behind_s"] = f"{behind:.3f}"
            if behind > LATE:
                level, words = WARN, "flying, behind the wall clock"
        self.diagnostics.report("flight", level, words, **values)

    def _on_start(self, request: Any, response: Any) -> Any:
        if self._flight.emitted:
            response.success, response.message = False, "the flight has begun already"
            return response
        self.start()
        response.success, response.message = True, "started"
        return response


def main() -> None:
    """Run the node."""
    sys.exit(run_node(lambda: PlantNode(timed=False), paced=True))
