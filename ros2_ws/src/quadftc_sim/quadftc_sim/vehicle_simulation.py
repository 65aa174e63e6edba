"""A vehicle with all its sensors, as one law: it moves for a period, then its sensors measure.

    command -> plant -> IMU, position sensor, magnetometer, barometer

The plant node and the closed loop without ROS run it. Random numbers, and the condition of the rotors, come
in from outside. Position sensor, magnetometer and barometer measure in free flight alone, each at every n-th
sample of the IMU.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quadftc_model.arrays import Components, Quaternion, Scalar, Vector, namespace
from quadftc_model.numbers import prepared
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, to_body
from quadftc_model.samples import PositionSample, RotorCondition
from quadftc_sim.barometer import Barometer, PressureInputs, PressureSample
from quadftc_sim.flying_plant import FlyingPlant
from quadftc_sim.magnetometer import FieldInputs, FieldSample, Magnetometer
from quadftc_sim.plant import Plant
from quadftc_sim.position_sensor import PositionInputs, PositionSampling, PositionSensorState
from quadftc_sim.rotor_fault import healthy_rotors
from quadftc_sim.sensor_draws import Due, FirstDraws, SampleDraws, SensorDraws
from quadftc_sim.sensors import ImuInputs, ImuOutput, ImuSensor, ImuState


class VehicleInputs(NamedTuple):
    """What happens to a vehicle since the sample before, and the numbers of its sensors at this one."""

    command: Components  # torque [N m] (..., 3), in free flight rotor speeds [rad/s] (..., n); held
    rotors: RotorCondition | None  # None: on the test stand
    before: float  # scenario time of the sample before [s]; at the first sample its own
    now: float  # scenario time [s]
    due: Due
    draws: SampleDraws
    first_draws: FirstDraws  # read at the first sample alone


class VehicleState(NamedTuple):
    """A vehicle and its sensors at a sample; None where there is no such sensor."""

    motion: Any  # of the plant
    imu: ImuState
    position: PositionSensorState | None
    hard_iron: Vector | None  # of the magnetometer [T]
    pressure_error: Scalar | None  # slow error of the barometer [Pa]


class FreeMotion(NamedTuple):
    """True motion through space, in earth axes."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    q_xyzw: Quaternion
    speeds: Components  # of the rotors [rad/s]
    wind: Vector  # [m/s]
    body_velocity: Vector  # the velocity in body axes [m/s]


class VehicleOutput(NamedTuple):
    """What the sensors say at a sample, and the truth; None where there is no such sensor."""

    imu: ImuOutput
    position: PositionSample | None  # what arrives with the sample of the IMU
    field: FieldSample | None
    pressure: PressureSample | None
    angles: Vector  # true Euler angles [rad]
    body_rate: Vector  # true body rate [rad/s]
    disturbance: Vector  # true disturbance torque over the true inertia [rad/s²]
    flight: FreeMotion | None  # None: on the test stand


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class VehicleSimulation:
    """A vehicle with its IMU, level and at rest at first; in free flight with other sensors."""

    plant: Plant
    imu: ImuSensor
    period: float  # of the IMU [s]
    position: PositionSampling | None = None
    magnetometer: Magnetometer | None = None
    barometer: Barometer | None = None

    def __post_init__(self) -> None:
        if not self.period > 0.0:
            raise ValueError(f"period = {self.period:g} s: must be positive")
        if not self.plant.flies and (self.position or self.magnetometer or self.barometer):
            raise ValueError("plant: a position sensor, magnetometer or barometer is for one in free flight")

    @property
    def traceable(self) -> bool:
        """Whether a compiler can trace it."""
        return self.plant.traceable

    @prepared
    def every(self) -> tuple[int | None, int | None, int | None]:
        """How many samples of the IMU come to one of position sensor, magnetometer and barometer."""
        rate = 1.0 / self.period
        return (
            self.position and self.position.every,
            self.magnetometer and self.magnetometer.every(rate),
            self.barometer and self.barometer.every(rate),
        )

    @prepared
    def pressure_period(self) -> float:
        """Time between two samples of the barometer [s]."""
        return (self.every[2] or 0) * self.period

    def due(self, index: int) -> Due:
        """Return which sensors measure at the sample of an index, which counts from 0."""
        return Due(*(None if each is None else np.bool_(index % each == 0) for each in self.every))

    def example(self) -> VehicleInputs:
        """Return inputs as at the first sample."""
        command, due, random = self.plant.first_command, self.due(0), SensorDraws(0)
        rotors = healthy_rotors(command) if self.plant.flies else None
        return VehicleInputs(command, rotors, 0.0, 0.0, due, random.sample(due), random.first(due))

    def init(self, inputs: VehicleInputs) -> VehicleState:
        """Return the state before the first sample."""
        drawn = inputs.first_draws
        zeros = namespace(drawn.imu.uniform).zeros_like(drawn.imu.uniform)
        return VehicleState(
            self.plant.init(quaternion_from_euler(zeros), zeros),
            self.imu.init(drawn.imu),
            None if self.position is None else self.position.init(drawn.position),
            None if self.magnetometer is None else self.magnetometer.init(drawn.field),
            None if self.barometer is None else self.barometer.init(drawn.pressure),
        )

    def step(
        self, state: VehicleState, inputs: VehicleInputs, dt: float
    ) -> tuple[VehicleState, VehicleOutput]:
        """Fly for ``dt`` [s], then measure; at the first sample ``dt`` is 0, and nothing moves."""
        plant, motion, now = self.plant, state.motion, inputs.now
        if isinstance(plant, FlyingPlant) and inputs.rotors is not None:
            motion = plant.with_rotors(motion, inputs.rotors)
        motion = plant.step(motion, inputs.command, inputs.before, dt)
        q_xyzw, omega = motion.q_xyzw, motion.body_rate
        seen = ImuInputs(q_xyzw, omega, plant.specific_force(motion, now), inputs.draws.imu)
        imu, measured = self.imu.step(state.imu, seen, self.period)
        position, arrived = self._measure_position(state.position, motion, inputs)
        hard_iron, field = self._measure_field(state.hard_iron, motion, inputs)
        pressure_error, pressure = self._measure_pressure(state.pressure_error, motion, inputs)
        flight = None
        if isinstance(plant, FlyingPlant):
            wind, body_velocity = plant.wind(now, motion.velocity), to_body(q_xyzw, motion.velocity)
            flight = FreeMotion(motion.position, motion.velocity, q_xyzw, motion.speeds, wind, body_velocity)
        return VehicleState(motion, imu, position, hard_iron, pressure_error), VehicleOutput(
            measured,
            arrived,
            field,
            pressure,
            euler_from_quaternion(q_xyzw),
            omega,
            plant.disturbance_acceleration(now, omega),
            flight,
        )

    def _measure_position(
        self, state: Any, motion: Any, inputs: VehicleInputs
    ) -> tuple[PositionSensorState | None, PositionSample | None]:
        if self.position is None:
            return None, None
        seen = PositionInputs(motion.position, motion.velocity, inputs.due.position, inputs.draws.position)
        return self.position.step(state, seen, self.period)

    def _measure_field(
        self, state: Any, motion: Any, inputs: VehicleInputs
    ) -> tuple[Vector | None, FieldSample | None]:
        if self.magnetometer is None:
            return None, None
        seen = FieldInputs(motion.q_xyzw, inputs.due.field, inputs.draws.field)
        return self.magnetometer.step(state, seen, self.period)

    def _measure_pressure(
        self, state: Any, motion: Any, inputs: VehicleInputs
    ) -> tuple[Scalar | None, PressureSample | None]:
        if self.barometer is None:
            return None, None
        seen = PressureInputs(motion.position[..., 2], inputs.due.pressure, inputs.draws.pressure)
        return self.barometer.step(state, seen, self.pressure_period)
