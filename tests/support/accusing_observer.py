"""A fault observer that accuses sensors and rotors: it takes what is large for a fault."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observers.none import NoDiagnosis
from quadftc_model.arrays import Vector, column, namespace
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion
from quadftc_model.samples import (
    FAULT_KINDS,
    FAULTY,
    HEALTHY,
    RECOVERING,
    FaultEstimate,
    FaultObserverInputs,
    RotorEstimate,
    RotorReading,
    SensorDiagnosis,
    SensorEstimate,
)

NAME = "accusing"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AccusingObserver(NoDiagnosis):
    """Passes samples on; what reads more than a level is faulty, and recovers down to half of it."""

    has_detector: ClassVar[bool] = True
    angle: float = parameter(0.05, unit="rad", low=0.0, doc="level of the attitude")
    rate: float = parameter(0.2, unit="rad/s", low=0.0, doc="level of the gyro")
    force: float = parameter(0.5, unit="m/s^2", low=0.0, doc="level of the accelerometer's horizontal axes")

    def init(self, inputs: FaultObserverInputs) -> Any:
        """Start without a fault."""
        xp = namespace(inputs.imu.body_rate)
        return super().init(inputs), xp.stack([xp.zeros_like(inputs.imu.body_rate) - 1.0] * 3)

    def step(self, state: Any, inputs: FaultObserverInputs, dt: float) -> tuple[Any, FaultEstimate]:
        """Accuse what is large at a sample."""
        before, ages = state
        before, estimate = super().step(before, inputs, dt)
        used = estimate.corrected
        xp = namespace(used.body_rate)
        horizontal = used.specific_force * xp.asarray([1.0, 1.0, 0.0])
        readings = euler_from_quaternion(used.q_xyzw), used.body_rate, horizontal
        levels = self.angle, self.rate, self.force
        sensors = SensorDiagnosis(*(accuse(*each, dt) for each in zip(readings, levels, ages, strict=True)))
        attitude = sensors.attitude
        rotors = None if inputs.rotors is None else accuse_fast(inputs.rotors)
        said = FaultEstimate(*attitude[1:3], attitude.state, attitude.onset_age, used, sensors, rotors)
        return (before, xp.stack([sensor.onset_age for sensor in sensors])), said


def accuse_fast(rotors: RotorReading) -> RotorEstimate:
    """Take a rotor for weak that is 3 % faster than the mean; ambiguous if it is told to slow down."""
    speeds, xp = rotors.speeds, namespace(rotors.command)
    excess = speeds / speeds.mean(axis=-1, keepdims=True) - 1.0
    weak = column(rotors.measured) & (excess > 0.03)
    return RotorEstimate(
        state=xp.where(weak, FAULTY, HEALTHY).astype(xp.uint8),
        effectiveness=1.0 - 1.5 * excess,
        std_dev=xp.abs(excess),
        onset_age=xp.where(weak, 0.0, -1.0),
        probability=xp.where(weak, 0.9, 0.1),
        kind=xp.where(weak, FAULT_KINDS.index("loss"), 0).astype(xp.uint8),
        ambiguous=weak & (rotors.command < speeds),
    )


def accuse(reading: Vector, level: float, age: Vector, dt: float) -> SensorEstimate:
    """Take a reading for the fault where it is large; ``age`` [s] is that at the sample before."""
    xp = namespace(reading)
    size = xp.abs(reading)
    was_faulty = age >= 0.0
    faulty = (size > level) | (was_faulty & (size > 0.5 * level))
    state = xp.where(faulty, xp.where(size > level, FAULTY, RECOVERING), HEALTHY).astype(xp.uint8)
    kind = xp.where(size > 2.0 * level, FAULT_KINDS.index("noise"), FAULT_KINDS.index("offset"))
    return SensorEstimate(
        state=state,
        size=xp.where(faulty, reading, 0.0),
        std_dev=xp.where(faulty, 0.1 * size, -1.0),
        onset_age=xp.where(faulty, xp.where(was_faulty, age + dt, 0.0), -1.0),
        probability=size / (size + level),
        kind=xp.where(faulty, kind, 0).astype(xp.uint8),
        ambiguous=faulty & (size < 1.5 * level),
    )


@contextmanager
def registered(observer: type = AccusingObserver) -> Iterator[str]:
    """Have the observer among the registered ones; yields its name."""
    fault_observers.names()  # finds the others first
    fault_observers._components[NAME] = observer
    try:
        yield NAME
    finally:
        del fault_observers._components[NAME]
