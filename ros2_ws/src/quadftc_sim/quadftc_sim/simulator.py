"""A flight, sample by sample, without ROS.

A `Simulator` is plant, sensor and random numbers. A `PlantFlight` is what the plant node does with one. The
torque that acts for a period is the last that has come when the period ends: in lock-step that of the sample
at its beginning. In real time it mostly comes long before the end, and the period is flown at once.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import Vector
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import ImuSample
from quadftc_model.stepper import seconds
from quadftc_sim.plant import Plant
from quadftc_sim.sensor_draws import SensorDraws
from quadftc_sim.sensors import ImuSensor

NEVER_NS = sys.maxsize


class Emission(NamedTuple):
    """What the simulator shows at one instant."""

    stamp_ns: int  # now [ns]
    sample: ImuSample | None  # what the IMU publishes now; None while the first sample is on its way
    sample_stamp_ns: int  # when that sample was taken [ns]
    angles: Vector  # true Euler angles [rad]
    body_rate: Vector  # true body rate [rad/s]
    disturbance: Vector  # true disturbance [rad/s²]: its torque over the true inertia


class Simulator:
    """One vehicle with its IMU, level and at rest at first.

    ``epoch_ns`` is the stamp of the first sample, at scenario time 0; ``seed`` that of noise and bias.
    """

    def __init__(self, plant: Plant, sensor: ImuSensor, period_ns: int, epoch_ns: int, seed: int) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns = {period_ns}: must be positive")
        self.plant, self.sensor, self.period_ns = plant, sensor, period_ns
        self._epoch_ns = self._stamp_ns = epoch_ns
        self._dt = seconds(period_ns)
        self._random = SensorDraws(seed)
        self._sensor_state = sensor.turn_on(self._random.turn_on)
        self._state = plant.init(quaternion_from_euler(np.zeros(3)), np.zeros(3))

    @property
    def time(self) -> float:
        """Scenario time [s]."""
        return seconds(self._stamp_ns - self._epoch_ns)

    def start(self) -> Emission:
        """Return the first emission; call once."""
        return self._emit()

    def advance(self, torque: Vector) -> Emission:
        """Fly one period under a torque command [N m] (3,), held; return the emission at its end."""
        self._state = self.plant.step(self._state, torque, self.time, self._dt)
        self._stamp_ns += self.period_ns
        return self._emit()

    def _emit(self) -> Emission:
        q_xyzw, body_rate, _ = self._state
        draws = self._random.next(1, self.sensor.wanders)[0]
        self._sensor_state, sample = self.sensor.step(self._sensor_state, q_xyzw, body_rate, draws, self._dt)
        return Emission(
            stamp_ns=self._stamp_ns,
            sample=sample,
            sample_stamp_ns=self._stamp_ns - self.sensor.delay * self.period_ns,
            angles=euler_from_quaternion(q_xyzw),
            body_rate=body_rate,
            disturbance=self.plant.disturbance_acceleration(self.time, body_rate),
        )


class PlantFlight:
    """A flight of ``count`` emissions (0: without end), from ``begin_ns`` on by the monotonic clock.

    When no torque has come for ``torque_timeout`` [s], zero torque acts.
    """

    def __init__(self, simulator: Simulator, count: int, torque_timeout: float, begin_ns: int) -> None:
        self._simulator, self.period_ns = simulator, simulator.period_ns
        self._count, self._torque_timeout, self._begin_ns = count, torque_timeout, begin_ns
        self._torque, self._torque_age = np.zeros(3), 0.0  # last command [N m], and how long ago it came [s]
        self._ahead: Emission | None = None  # of the period that is flown already
        self.emitted = 0
        self.finished = False
        self.awaited_ns: int | None = None  # stamp of the last sample, whose torque is missing [ns]

    @property
    def due_ns(self) -> int:
        """When the next emission after the first is due, by the monotonic clock [ns]; at the end never."""
        flies = self.emitted and not self.finished
        return self._begin_ns + self.emitted * self.period_ns if flies else NEVER_NS

    @property
    def torque_lost(self) -> bool:
        """Whether no torque has come for too long."""
        return self._torque_age > self._torque_timeout

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample is missing, so that the next period is not flown yet."""
        return self.awaited_ns is not None and self._ahead is None

    def command(self, torque: Vector) -> None:
        """Note a torque [N m] (3,), for the period that is not flown yet."""
        self._torque, self._torque_age = torque, 0.0

    def wait(self) -> None:
        """Note that a period has passed since the last torque."""
        self._torque_age += seconds(self.period_ns)
        if self.torque_lost:
            self._torque = np.zeros(3)

    def fly_ahead(self) -> None:
        """Fly the next period already, under the last torque."""
        if self._ahead is None and not self.finished:
            self._ahead = self._simulator.advance(self._torque)

    def emission(self) -> Emission | None:
        """Return the next emission; None if there is none, as the flight has had its length."""
        if self._count and self.emitted >= self._count:
            self.finished = True
            return None
        emission = self._ahead
        if emission is None:
            emission = self._simulator.advance(self._torque) if self.emitted else self._simulator.start()
        self._ahead = None
        self.emitted += 1
        self.awaited_ns = None if emission.sample is None else emission.sample_stamp_ns
        return emission
