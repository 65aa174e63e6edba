"""One flight of the simulated vehicle: what the plant node does between its messages, without ROS.

The torque that acts for a period is the last that has come when the period ends, which in lock-step is that
of the sample at its beginning. In real time that torque mostly comes long before the end: the period is flown
there and then, so that at its end the next sample only has to be sent.
"""

from __future__ import annotations

import sys

import numpy as np

from quadftc_model.stepper import seconds
from quadftc_sim.simulator import Emission, Floats, Simulator

NEVER_NS = sys.maxsize


class PlantFlight:
    """A flight, from its first emission to its last.

    Parameters
    ----------
    simulator : Simulator
    count : int
        Emissions of the flight; 0: without end.
    torque_timeout : float
        When no torque has come for so long [s], zero torque acts.
    begin_ns : int
        When it begins, by the monotonic clock [ns].
    """

    def __init__(self, simulator: Simulator, count: int, torque_timeout: float, begin_ns: int) -> None:
        self._simulator = simulator
        self._count, self._torque_timeout, self._begin_ns = count, torque_timeout, begin_ns
        self._torque, self._torque_age = np.zeros(3), 0.0  # last command [N m], and how long ago it came [s]
        self._ahead: Emission | None = None
        self.emitted = 0
        self.finished = False
        self.awaited_ns: int | None = None  # stamp of the last sample, whose torque is missing [ns]

    @property
    def period_ns(self) -> int:
        """Control period [ns]."""
        return self._simulator.period_ns

    @property
    def due_ns(self) -> int:
        """When the next emission is due, by the monotonic clock [ns]; never once the flight has ended."""
        return NEVER_NS if self.finished else self._begin_ns + self.emitted * self._simulator.period_ns

    @property
    def torque_lost(self) -> bool:
        """Whether no torque has come for too long."""
        return self._torque_age > self._torque_timeout

    def command(self, torque: Floats) -> None:
        """Note a torque [N m] (3,), for the period that is not flown yet."""
        self._torque, self._torque_age = torque, 0.0

    def wait(self) -> None:
        """Note that a period has passed since the last torque."""
        self._torque_age += seconds(self._simulator.period_ns)
        if self.torque_lost:
            self._torque = np.zeros(3)

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample is missing, so that the next period is not flown yet."""
        return self.awaited_ns is not None and self._ahead is None

    def fly_ahead(self) -> None:
        """Fly the next period already, under the last torque."""
        if self._ahead is None and not self.finished:
            self._ahead = self._simulator.advance(self._torque)

    def emission(self) -> Emission | None:
        """Return the next emission; None if there is none, as the flight has had its length."""
        if self._count and self.emitted >= self._count:
            self.finished = True
            return None
        if self.emitted == 0:
            emission = self._simulator.start()
        else:
            self.fly_ahead()
            emission = self._ahead
            assert emission is not None
        self._ahead = None
        self.emitted += 1
        self.awaited_ns = None if emission.sample is None else emission.sample_stamp_ns
        return emission
