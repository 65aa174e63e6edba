"""A flight, sample by sample, without ROS.

A `Simulator` is plant, sensors and random numbers. A `PlantFlight` is what the plant node does with one. The
command that acts for a period is the last that has come when the period ends: in lock-step that of the sample
at its beginning. In real time it mostly comes long before the end, and the period is flown at once.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Components, Quaternion, Vector
from quadftc_model.rotations import quaternion_from_euler
from quadftc_model.samples import ImuSample, PositionSample, RotorCondition
from quadftc_model.stepper import seconds
from quadftc_sim.barometer import Barometer
from quadftc_sim.flying_plant import FlyingPlant
from quadftc_sim.magnetometer import Magnetometer
from quadftc_sim.motion import Motion, Seen, motion_of, see
from quadftc_sim.plant import Plant
from quadftc_sim.position_sensor import PositionSensor
from quadftc_sim.sensor_draws import SensorDraws
from quadftc_sim.sensors import ImuSensor

NEVER_NS = sys.maxsize
NO_MAGNETOMETER, NO_BAROMETER = Magnetometer(), Barometer()


class FreeMotion(NamedTuple):
    """True motion through space, in earth axes."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    q_xyzw: Quaternion
    speeds: Components  # of the rotors [rad/s]
    wind: Vector  # [m/s]


class Emission(NamedTuple):
    """What the simulator shows at one instant."""

    stamp_ns: int  # now [ns]
    sample: ImuSample | None  # what the IMU publishes now; None while the first sample is on its way
    sample_stamp_ns: int  # when that sample was taken [ns]
    angles: Vector  # true Euler angles [rad]
    body_rate: Vector  # true body rate [rad/s]
    disturbance: Vector  # true disturbance [rad/s²]: its torque over the true inertia
    flight: FreeMotion | None = None  # of a vehicle in free flight
    place: PositionSample | None = (
        None  # what the position sensor says with the IMU sample; None: there is none
    )
    place_stamp_ns: int = 0  # when that was measured [ns]
    field: Vector | None = None  # of the magnetometer [T], measured now; None: it does not measure now
    pressure: float | None = None  # of the barometer [Pa], likewise


class Simulator:
    """One vehicle with its IMU, level and at rest at first.

    ``epoch_ns`` is the stamp of the first sample, at scenario time 0; ``seed`` that of noise and bias.
    ``motion`` is that of the plant, which may be compiled. Position sensor, magnetometer and barometer
    measure in free flight alone.
    """

    def __init__(
        self,
        plant: Plant,
        sensor: ImuSensor,
        period_ns: int,
        epoch_ns: int,
        seed: int,
        place: PositionSensor | None = None,
        motion: Motion | None = None,
        magnetometer: Magnetometer = NO_MAGNETOMETER,
        barometer: Barometer = NO_BAROMETER,
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns = {period_ns}: must be positive")
        self.plant, self.sensor, self.period_ns = plant, sensor, period_ns
        self._epoch_ns = self._stamp_ns = epoch_ns
        self._dt = seconds(period_ns)
        self._seed, self._random = seed, SensorDraws(seed)
        self._move = motion or motion_of(plant)
        self._sensor_state = sensor.turn_on(self._random.turn_on)
        self.position_sensor = place
        self._place = _PlaceSensor(place, self._random, sensor.delay, self._dt) if place is not None else None
        self.magnetometer, self.barometer = magnetometer, barometer
        self._field = _FieldSensor(magnetometer, self._random, self._dt)
        self._pressure = _PressureSensor(barometer, self._random, self._dt)
        self._state: Any = plant.init(quaternion_from_euler(np.zeros(3)), np.zeros(3))

    @property
    def time(self) -> float:
        """Scenario time [s]."""
        return seconds(self._stamp_ns - self._epoch_ns)

    def anew(self, epoch_ns: int) -> Simulator:
        """Return the same simulator at the begin of a flight."""
        others = self.position_sensor, self._move, self.magnetometer, self.barometer
        return Simulator(self.plant, self.sensor, self.period_ns, epoch_ns, self._seed, *others)

    def start(self) -> Emission:
        """Return the first emission; call once."""
        return self._emit(see(self.plant, self._state, self.time))

    def set_rotors(self, condition: RotorCondition | None) -> None:
        """Put the rotors of a free flight into a condition; None: as they are."""
        if isinstance(self.plant, FlyingPlant):
            self._state = self.plant.with_rotors(self._state, condition)

    def advance(self, command: Components) -> Emission:
        """Fly one period under a command, held; return the emission at its end.

        The command is a torque [N m] (3,) on the test stand, rotor speeds [rad/s] (n,) in free flight.
        """
        before = self.time
        self._stamp_ns += self.period_ns
        self._state, seen = self._move(self._state, command, before, self.time, self._dt)
        return self._emit(seen)

    def _emit(self, seen: Seen) -> Emission:
        state = self._state
        q_xyzw, body_rate = state.q_xyzw, state.body_rate
        draws = self._random.next(1, self.sensor.wanders)[0]
        self._sensor_state, sample = self.sensor.step(
            self._sensor_state, q_xyzw, body_rate, seen.force, draws, self._dt
        )
        flight = place = field = pressure = None
        if seen.wind is not None:
            flight = FreeMotion(state.position, state.velocity, q_xyzw, state.speeds, seen.wind)
            place = self._place and self._place.measure(state.position, state.velocity)
            field = self._field.measure(q_xyzw)
            pressure = self._pressure.measure(state.position[2])
        return Emission(
            stamp_ns=self._stamp_ns,
            sample=sample,
            sample_stamp_ns=self._stamp_ns - self.sensor.delay * self.period_ns,
            angles=seen.angles,
            body_rate=body_rate,
            disturbance=seen.disturbance,
            flight=flight,
            place=place,
            place_stamp_ns=self._stamp_ns - self._place.behind * self.period_ns if self._place else 0,
            field=field,
            pressure=pressure,
        )


class _PlaceSensor:
    """The position sensor beside an IMU that is ``imu_delay`` samples late, at a period of ``dt`` [s]."""

    def __init__(self, law: PositionSensor, random: SensorDraws, imu_delay: int, dt: float) -> None:
        self._law, self._random, self._dt = law, random, dt
        self._every, self.behind = law.every(1.0 / dt), imu_delay + law.lag(1.0 / dt)
        self._state = law.turn_on(random.next_place(1)[0])
        self._count = 0

    def measure(self, position: Vector, velocity: Vector) -> PositionSample | None:
        due = np.bool_(self._count % self._every == 0)
        self._count += 1
        draws = self._random.next_place(1)[0]
        self._state, sample = self._law.step(
            self._state, position, velocity, due, draws, self.behind, self._dt
        )
        return sample


class _Due:
    """Says which samples of an IMU, ``dt`` [s] apart, a sensor of a rate [Hz] measures at; 0: at none."""

    def __init__(self, rate: float, dt: float) -> None:
        self.every = max(1, round(1.0 / (rate * dt))) if rate else 0
        self.period = self.every * dt
        self._count = 0

    def now(self) -> bool:
        """Return whether it measures at the next sample; call once for each."""
        due = self.every > 0 and self._count % self.every == 0
        self._count += 1
        return due


class _FieldSensor:
    def __init__(self, law: Magnetometer, random: SensorDraws, dt: float) -> None:
        self._law, self._random, self._due = law, random, _Due(law.rate, dt)
        self._hard_iron = law.turn_on(random.next_field())

    def measure(self, q_xyzw: Quaternion) -> Vector | None:
        if not self._due.now():
            return None
        return self._law.measure(self._hard_iron, q_xyzw, self._random.next_field())


class _PressureSensor:
    def __init__(self, law: Barometer, random: SensorDraws, dt: float) -> None:
        self._law, self._random, self._due = law, random, _Due(law.rate, dt)
        self._wander = law.turn_on(random.next_pressure())

    def measure(self, height: float) -> float | None:
        if not self._due.now():
            return None
        draws = self._random.next_pressure()
        self._wander, pressure = self._law.measure(self._wander, height, draws, self._due.period)
        return float(pressure)


class PlantFlight:
    """A flight of ``count`` emissions (0: without end), from ``begin_ns`` on by the monotonic clock.

    When no command has come for ``torque_timeout`` [s], zero acts.
    """

    def __init__(self, simulator: Simulator, count: int, torque_timeout: float, begin_ns: int) -> None:
        self.simulator, self.period_ns = simulator, simulator.period_ns
        self._count, self._torque_timeout, self._begin_ns = count, torque_timeout, begin_ns
        plant = simulator.plant
        self._nothing = np.zeros(plant.command_size)
        self._command, self._command_age = plant.first_command, 0.0  # the last, and how long ago it came [s]
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
        """Whether no command has come for too long."""
        return self._command_age > self._torque_timeout

    @property
    def unanswered(self) -> bool:
        """Whether the torque of the last sample is missing, so that the next period is not flown yet."""
        return self.awaited_ns is not None and self._ahead is None

    def command(self, command: Components) -> None:
        """Note a command, as of `Simulator.advance`, for the period that is not flown yet."""
        self._command, self._command_age = command, 0.0

    def wait(self) -> None:
        """Note that a period has passed since the last torque."""
        self._command_age += seconds(self.period_ns)
        if self.torque_lost:
            self._command = self._nothing

    def fly_ahead(self) -> None:
        """Fly the next period already, under the last torque."""
        if self._ahead is None and not self.finished:
            self._ahead = self.simulator.advance(self._command)

    def emission(self) -> Emission | None:
        """Return the next emission; None if there is none, as the flight has had its length."""
        if self._count and self.emitted >= self._count:
            self.finished = True
            return None
        emission = self._ahead
        if emission is None:
            emission = self.simulator.advance(self._command) if self.emitted else self.simulator.start()
        self._ahead = None
        self.emitted += 1
        self.awaited_ns = None if emission.sample is None else emission.sample_stamp_ns
        return emission
