"""The interface of fault observers, their registry, and what several of them share."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar, NamedTuple

from quadftc_model import samples
from quadftc_model.arrays import AnyArray, Array, Bool, Flag, Mask, Quaternion, Vector, larger, namespace
from quadftc_model.assembly import VehicleLaw, law_from
from quadftc_model.registry import Registry
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, turn
from quadftc_model.samples import (
    FaultEstimate,
    FaultObserverInputs,
    ImuSample,
    RotorEstimate,
    SensorDiagnosis,
    SensorEstimate,
)

MAX_PITCH = math.radians(80.0)  # rad; steeper, roll and yaw are not defined well enough to be compared
SHORTEST = 1e-9  # s; of a time step that divides: it is 0 at the first sample


class LastDiagnosis(NamedTuple):
    """What an observer knew that has died, as far as others have heard it."""

    fault: Vector  # attitude fault [rad]
    std_dev: Vector  # its standard deviation [rad]; -1: not known
    faulty: Mask  # a fault was confirmed and had not ended
    gyro_correction: Vector  # what it added to the gyro [rad/s]: minus the bias
    since: Vector  # time since the onsets of these faults [s]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FaultObserver(VehicleLaw[FaultObserverInputs, FaultEstimate]):
    """Base of all fault observers: from IMU samples and torques to an estimate of the attitude fault.

    ``init`` and ``step`` take arrays with any leading axes. They bridge a sample whose attitude or rate is
    marked invalid.
    """

    has_detector: ClassVar[bool] = True  # False: its status never says faulty, its estimate has to be judged

    def resumed(self, inputs: FaultObserverInputs, last: LastDiagnosis) -> Any:
        """Return the state that resumes at a sample where another observer of this kind has died.

        Its fault is assumed to last; by default the observer starts at the attitude without it.
        """
        return self.init(without_fault(inputs, last.fault))

    def bias_of(self, state: Any) -> Vector | None:
        """Return the gyro bias [rad/s] of a state; None: it is what is taken off the corrected rate."""
        return None

    def describe(self, state: Any) -> dict[str, Vector]:
        """Return what else the observer knows, for people, by name and axis; none by default."""
        return {}


fault_observers: Registry[Any] = Registry(
    "fault observer", "quadftc_fdi.fault_observers", "quadftc.fault_observers"
)
register = fault_observers.register
fault_observer_from = law_from(fault_observers, "observer")  # from the parameters of its node


def without_fault(inputs: FaultObserverInputs, fault: Vector) -> FaultObserverInputs:
    """Inputs with the attitude that the sensor would read without a fault [rad]."""
    angles = euler_from_quaternion(inputs.imu.q_xyzw) - fault
    return inputs._replace(imu=inputs.imu._replace(q_xyzw=quaternion_from_euler(angles)))


def dead_reckon(q_xyzw: Quaternion, rate: Vector, next_rate: Vector, dt: float) -> Quaternion:
    """Attitude after ``dt`` [s] on the mean of two body rates [rad/s]; of order 2."""
    return turn(q_xyzw, 0.5 * dt * (rate + next_rate))


def comparable(angles: Vector, others: Vector) -> Bool[AnyArray, "*batch 1"]:
    """Whether two attitudes, in Euler angles [rad], are both away from 90 deg of pitch."""
    return larger(abs(angles[..., 1:2]), abs(others[..., 1:2])) < MAX_PITCH


def correct_sample(imu: ImuSample, q_xyzw: Quaternion, body_rate: Vector) -> ImuSample:
    """Put the observer's attitude and body rate [rad/s] into a sample."""
    _, _, force, attitude_valid, rate_valid, force_valid = imu
    return ImuSample(q_xyzw, body_rate, force, attitude_valid | True, rate_valid, force_valid)


def assume_healthy(fault: Vector, corrected: ImuSample) -> FaultEstimate:
    """Return the estimate of an observer that never decides whether its fault [rad] is one."""
    xp = namespace(fault)
    unknown, state = xp.full_like(fault, -1.0), xp.full_like(fault, samples.HEALTHY, dtype=xp.uint8)
    return FaultEstimate(fault, unknown, state, unknown, corrected)


def await_start(imu: ImuSample, said: FaultEstimate) -> FaultEstimate:
    """Return the estimate before an observer has started: no fault is known, the sample passes.

    It has the parts of what the observer has ``said``, or would say.
    """
    state, zeros, unknown, none, kind = _nothing_known(said.fault)
    sensor = SensorEstimate(state, zeros, unknown, unknown, zeros, kind, none)
    sensors = None if said.sensors is None else SensorDiagnosis(sensor, sensor, sensor)
    rotors = None if said.rotors is None else await_rotors(said.rotors)
    return FaultEstimate(zeros, unknown, state, unknown, imu, sensors, rotors)


def await_rotors(said: RotorEstimate) -> RotorEstimate:
    """Return what is said of rotors before an observer has started: as far as known, they are healthy."""
    state, zeros, unknown, none, kind = _nothing_known(said.effectiveness)
    return RotorEstimate(state, zeros + 1.0, unknown, unknown, zeros, kind, none)


def is_usable_estimate(estimate: FaultEstimate) -> Flag:
    """Whether all numbers of an estimate are finite and below `samples.UNUSABLE` (...)."""
    corrected = estimate.corrected
    found = [estimate.fault, estimate.std_dev, estimate.onset_age, corrected.q_xyzw, corrected.body_rate]
    for part in (*(estimate.sensors or ()), estimate.rotors):
        found += () if part is None else part[1:5]
    return samples.usable(*found)


def _nothing_known(like: Array) -> tuple[Array, Array, Array, Array, Array]:
    """States STARTING, zeros, minus ones, false and fault kinds "", shaped as an array."""
    xp = namespace(like)
    zeros = xp.zeros_like(like)
    state = xp.full_like(like, samples.STARTING, dtype=xp.uint8)
    return state, zeros, zeros - 1.0, zeros > 0.0, xp.zeros_like(state)
