# pyright: basic
"""The plant node: flies the simulated vehicle and publishes its IMU.

Inputs: torque/command, in free flight rotors/command and rotors/fault (the condition of the rotors);
fault/dropped (a sample that nobody will answer, in lock-step).
Outputs: plant/imu; the truth on plant/attitude, plant/rate and disturbance/applied; /clock in lock-step. In
free flight position/data, rotors/speed, and the truth on plant/odometry and wind/applied.
Services: ~/start, ~/reset (std_srvs/Trigger: a new flight begins). In lock-step the stamps restart, by which
the other nodes know it. In real time the plant pauses until their laws take the next sample for the first;
call ~/reset of fault_injector and reference too, to restart the schedules of faults and references.

The plant makes time: it does not follow /clock, whatever use_sim_time says.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from std_srvs.srv import Trigger

from quadftc_compile.engine import engine_from
from quadftc_model.samples import RotorCondition, is_usable
from quadftc_model.stepper import MAX_GAP, seconds
from quadftc_ros.conversions import Floats, wall_ns
from quadftc_ros.diagnostics import ERROR, OK, WARN
from quadftc_ros.executor import run_node
from quadftc_ros.limits import limits_of
from quadftc_ros.motion_wire import RotorsReader
from quadftc_ros.node import GraphNode
from quadftc_ros.rotor_wire import RotorConditionReader
from quadftc_ros.topics import missing_connections
from quadftc_ros.wire import vector_of
from quadftc_sim.assembly import EPOCH_NS, PlantParameters, flight_from
from quadftc_sim.barometer import Barometer
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.plant import plants
from quadftc_sim.plant_output import PlantOutput
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensors import ImuSensor
from quadftc_sim.simulator import NEVER_NS

LATE = 0.1  # s; real time: from when on a flight behind the wall clock is reported
GIVEN_UP_NS = 500_000_000  # real time: a flight that is later is not caught up with, it is slowed
PAUSE = MAX_GAP + 0.2  # s; real time: between two flights, so that the laws of all nodes restart


class PlantNode(GraphNode):
    """Simulated vehicle with its IMU; the only node with a clock of its own.

    ``each_sample()`` is called after each emission. In real time a timer of the node emits the samples; if
    not ``timed``, whoever runs the node calls `tick` at `due_ns`. Other arguments are those of `GraphNode`.
    """

    def __init__(
        self, each_sample: Callable[[], None] = lambda: None, timed: bool = True, **kwargs: Any
    ) -> None:
        super().__init__("plant", **kwargs)
        self._timed = timed and not self.lockstep
        self.settings.declare(PlantParameters, read_only=True)
        law = plants.get(self.settings.values()["plant"])
        self.settings.declare(law, read_only=True)
        self.settings.declare(ImuSensor, "imu.", read_only=True)
        if law.flies:
            self.settings.declare(PositionSensor, "position.", read_only=True)
            self.settings.declare(Magnetometer, "mag.", read_only=True)
            self.settings.declare(Barometer, "baro.", read_only=True)
            self.settings.declare_list(
                "winds", "each: kind key=value..., e.g. 'constant velocity_mean=2,0,0'"
            )
        example = "constant start=5s amplitude=0.1Nm"
        self.settings.declare_list("disturbances", f"each: kind key=value..., e.g. '{example}'")
        self._values = self.settings.values()
        engine = engine_from(self._values, self.get_logger().info)
        self.flight = flight_from(self._values, 0, time.monotonic_ns(), engine=engine)
        self._slowed_ns = 0  # real time: by how much the flight was slowed in all
        self._rests_until_ns = 0  # real time: does not emit before, however late
        # real time: samples after the first torque whose own had not come when the next was due; None: before
        self._without_torque: int | None = None
        rotors = self.flight.simulator.plant.command_size
        self._output = PlantOutput(self, each_sample, self.flight.simulator.law if law.flies else None)
        self.limits = limits_of(self.flight.simulator.plant.vehicle)
        self._topic = "rotors/command" if law.flies else "torque/command"
        decode = RotorsReader(rotors) if law.flies else vector_of
        self.reads(self._topic, self._on_command, decode=decode)
        self.reads("fault/dropped", self._on_dropped)
        self._awaited = {"command"}  # lock-step: what has to come for a sample
        if law.flies:
            self._awaited.add("rotors")
            self.reads("rotors/fault", self._on_rotors, decode=RotorConditionReader(rotors))
        self._answered = set[str]()  # what has come for the last sample
        self.offers("start", Trigger, self._on_start)
        self.offers_reset(self._restart, "a new flight begins")
        self._timer: Any = None  # for the start of the flight, then for its samples
        self._torque_lost: bool | None = None  # as reported
        if self._values["start_when_connected"]:
            self._call_every(0.05, self._start_when_connected)
        self.ready()

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample has not come."""
        return self.flight.unanswered

    @property
    def due_ns(self) -> int:
        """When `tick` is due, by the monotonic clock [ns]; in lock-step and while it rests, never.

        A flight that is late catches up at twice its rate: others have to keep up with it. What is more than
        `GIVEN_UP_NS` is given up: the flight is slower than the clock.
        """
        return NEVER_NS if self.lockstep or not self.active else max(self.flight.due_ns, self._rests_until_ns)

    def start(self) -> bool:
        """Begin the flight; False if it has begun already, or the node is not active."""
        if self.flight.emitted or not self.active:
            return False
        self._stop_timer()
        if self._timed:
            self._call_every(seconds(self.flight.period_ns), self._on_timer)
        self._make_flight(EPOCH_NS if self.lockstep else wall_ns())
        self._emit()
        return True

    def tick(self) -> None:
        """Real time: emit the next sample; zero torque has acted if none has come for too long."""
        now_ns = time.monotonic_ns()
        self._rests_until_ns = now_ns + self.flight.period_ns // 2
        if (late_ns := now_ns - self.flight.due_ns - GIVEN_UP_NS) > 0:
            self.flight.postpone(late_ns)
            self._slowed_ns += late_ns
        if self._without_torque is not None:
            self._without_torque += self.unanswered
        self.flight.wait()
        self._emit()
        lost = self.flight.torque_lost
        if lost is not self._torque_lost:
            self._torque_lost = lost
            level, words = (ERROR, "does not come: zero acts") if lost else (OK, "comes")
            self.diagnostics.report("torque", level, f"{self._topic} {words}")

    def resume(self) -> None:
        """Begin a new flight if one was interrupted."""
        if self.flight.emitted:
            self._restart()

    def report(self) -> None:
        """Report how far the flight is, and in real time how far behind the clock."""
        flight = self.flight
        level, words = OK, "finished" if flight.finished else "flying" if flight.emitted else "not started"
        values: dict[str, object] = {"samples": flight.emitted}
        if not self.lockstep and flight.due_ns < NEVER_NS:
            behind = max(0.0, seconds(time.monotonic_ns() - flight.due_ns))
            values |= {"behind_s": f"{behind:.3f}", "without_torque": self._without_torque or 0}
            values |= {"slowed_s": f"{seconds(self._slowed_ns):.3f}"}
            if behind > LATE:
                level, words = WARN, "flying, behind the wall clock"
        self.diagnostics.report("flight", level, words, **values)

    def _make_flight(self, epoch_ns: int) -> None:
        self.flight = flight_from(self._values, epoch_ns, time.monotonic_ns(), self.flight)

    def _emit(self) -> None:
        """Emit the next sample; in lock-step up to one that somebody will answer."""
        self._answered.clear()
        self._output.emit(self.flight.emission())
        while self.lockstep and self.flight.awaited_ns is None and not self.flight.finished:
            self._output.emit(self.flight.emission())

    def _restart(self) -> None:
        self._stop_timer()
        self._make_flight(0)
        self._output.pending = None
        if self.lockstep:
            self.start()
        else:
            self._call_every(PAUSE, self.start)

    def _call_every(self, period: float, callback: Callable[[], object]) -> None:
        self._timer = self.create_timer(period, callback, clock=self.steady_clock)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None

    def _start_when_connected(self) -> None:
        if not missing_connections(self.get_name(), self.connections(), plant=self.plant_kind):
            self.start()

    def _on_command(self, stamp_ns: int, command: Floats) -> None:
        if is_usable(command):
            self.flight.command(command)
            self._without_torque = self._without_torque or 0
        else:
            self.diagnostics.count(f"{self._topic}: not finite")
        if self.lockstep:
            self._take("command", stamp_ns)
        elif stamp_ns == self.flight.awaited_ns:
            self._output.show_truth()
            self.flight.fly_ahead()

    def _on_dropped(self, stamp_ns: int, message: object) -> None:
        if self.lockstep:
            self._take("command", stamp_ns)

    def _on_rotors(self, stamp_ns: int, condition: RotorCondition) -> None:
        limited = not np.isnan(condition.speed_limit).any()  # a healthy rotor has none: infinite
        if limited and is_usable(condition.effectiveness, condition.unbalance):
            self.flight.simulator.set_rotors(condition)
        else:
            self.diagnostics.count("rotors/fault: not finite")
        if self.lockstep:
            self._take("rotors", stamp_ns)

    def _take(self, what: str, stamp_ns: int) -> None:
        """Lock-step: fly on once all that belongs to the last sample has come."""
        if stamp_ns == self.flight.awaited_ns:
            self._answered.add(what)
            if self._answered == self._awaited:
                self._emit()

    def _on_timer(self) -> None:
        """Emit what is due: a timer that is late by periods skips them; the flight does not."""
        slack_ns = self.flight.period_ns // 2  # as the timer's clock may drift from ours
        for _ in range(2):  # not more at a time, so that others get to work, too
            if self.active and time.monotonic_ns() + slack_ns >= self.flight.due_ns:
                self.tick()

    def _on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.start()
        refusal = "the flight has begun already" if self.active else "the node is not active"
        response.message = "started" if response.success else refusal
        return response


main = partial(run_node, partial(PlantNode, timed=False), paced=True)
