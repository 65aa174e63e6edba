"""What flows between the parts: the IMU sample, the reference, the outputs of observers and controllers.

Every type is a NamedTuple of arrays with any leading axes (none on board, one for a batch of flights). Only a
`DiagnosisReport` is of one vehicle.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from quadftc_model.arrays import (
    Components,
    Flag,
    Mask,
    Quaternion,
    Scalar,
    States,
    Vector,
    column,
    components,
    namespace,
    where,
)

UNIT_NORM_TOLERANCE = 1e-2  # 1; a quaternion further from unit length is no attitude
MAX_BODY_RATE = 100.0  # rad/s, sum over the axes; MEMS gyros end at 70 (4000 deg/s): more is no body rate
UNUSABLE = 1e6  # in rad, rad/s, rad/s², N m and m/s² alike: no estimate or command can mean so much
STANDARD_GRAVITY = 9.80665  # m/s², CGPM 1901
AIR_DENSITY = 1.225  # kg/m³, at sea level (ISO 2533)
ABSENT = -1.0  # element 0 of a covariance of sensor_msgs/Imu: the sample lacks this channel (REP-145)
AXES = ("roll", "pitch", "yaw")  # of what has three elements in attitude

STARTING, HEALTHY, SUSPECT, FAULTY, RECOVERING = range(5)  # fault states, as in quadftc_msgs/FaultStatus
ALARMS = (FAULTY, RECOVERING)  # a fault is confirmed, and not known to be gone
FAULT_STATE_NAMES = ("starting", "healthy", "suspect", "faulty", "recovering")
FAULT_KINDS = ("", "offset", "stuck", "noise", "absent", "unknown", "loss", "off")  # "": no fault


class ImuSample(NamedTuple):
    """One sample of the IMU message: attitude, body rate, specific force, and which of them are there."""

    q_xyzw: Quaternion  # attitude, body to earth
    body_rate: Vector  # [rad/s], body frame
    specific_force: Vector  # [m/s²], body frame, +g along z at rest
    attitude_valid: Flag
    rate_valid: Flag
    force_valid: Flag


def level_sample() -> ImuSample:
    """What an IMU of one vehicle says that is level and at rest."""
    there = np.bool_(True)
    q_xyzw, force = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, STANDARD_GRAVITY])
    return ImuSample(q_xyzw, np.zeros(3), force, there, there, there)


class AttitudeReference(NamedTuple):
    """Where the attitude shall be: Euler angles (Z-Y-X) with their first and second time derivatives."""

    angles: Vector  # [rad]
    rates: Vector  # [rad/s]
    accelerations: Vector  # [rad/s²]


class AttitudeCommand(NamedTuple):
    """What a position controller wants."""

    attitude: AttitudeReference
    thrust: Scalar  # of all rotors, along body z [N]


class PositionReference(NamedTuple):
    """Where the vehicle shall be and go, in earth axes (east, north, up), and where it shall head."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    acceleration: Vector  # [m/s²]
    yaw: Scalar  # [rad]
    yaw_rate: Scalar  # [rad/s]
    jerk: Vector  # [m/s³]; zeros where it is not known


class PositionSample(NamedTuple):
    """What a position sensor says with an IMU sample, in earth axes."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]; zeros where the sensor has none
    there: Flag  # a sample came with this IMU sample


NO_PLACE = PositionSample(np.zeros(3), np.zeros(3), np.bool_(False))  # no position came with a sample


class PositionEstimate(NamedTuple):
    """Estimated motion of the centre of mass, in earth axes."""

    position: Vector  # [m]
    velocity: Vector  # [m/s]
    acceleration: Vector  # [m/s²]


class RotorReading(NamedTuple):
    """What is known of the rotors at a sample; n rotors, in the order of the vehicle file."""

    command: Components  # speeds commanded since the sample before (..., n) [rad/s]
    speeds: Components  # measured at the sample (..., n) [rad/s]
    measured: Flag  # the speeds are known; if not, what stands there says nothing


class RotorCondition(NamedTuple):
    """In what state the rotors really are; n rotors, in the order of the vehicle file."""

    effectiveness: Components  # thrust over that of a healthy rotor at the same speed (..., n) [1]
    speed_limit: Components  # largest speed that it reaches (..., n) [rad/s]; 0: it is off
    stuck: Components  # it keeps the speed that it has (..., n) bool
    unbalance: Components  # mass times its distance from the axis (..., n) [kg m]


class FaultObserverInputs(NamedTuple):
    """What a fault observer sees: the sample, and what the rotors gave since the sample before.

    In free flight there are thrust, position and rotors, too; on the test stand these are None.
    """

    imu: ImuSample
    torque: Vector  # [N m]
    thrust: Scalar | None = None  # of all rotors [N]
    position: PositionSample | None = None
    rotors: RotorReading | None = None
    driven: Flag = np.True_  # torque and thrust are known; if not, the torque is given as zero


class SensorEstimate(NamedTuple):
    """What is said of one sensor, axis by axis; sizes in its SI unit (rad, rad/s, m/s²)."""

    state: States  # STARTING ... RECOVERING
    size: Vector  # of the fault: reading minus truth; 0 without a fault
    std_dev: Vector  # of the size; -1: unknown
    onset_age: Vector  # time since the onset of the present fault [s]; -1: no fault
    probability: Vector  # that this axis of this sensor is faulty now [1]
    kind: States  # what the fault looks like, an index into `FAULT_KINDS`
    ambiguous: Mask  # declared, but the fault may as well be that of the other sensor of the axis


class SensorDiagnosis(NamedTuple):
    """Which sensor is faulty: attitude (roll, pitch, yaw), gyro and accelerometer (x, y, z)."""

    attitude: SensorEstimate
    gyro: SensorEstimate
    accelerometer: SensorEstimate


class RotorEstimate(NamedTuple):
    """What is said of each rotor; n rotors, in the order of the vehicle file."""

    state: States  # STARTING ... RECOVERING (..., n)
    effectiveness: Components  # thrust over that of a healthy rotor at the same speed (..., n) [1]
    std_dev: Components  # of the effectiveness (..., n) [1]; -1: unknown
    onset_age: Components  # time since the onset of the present fault (..., n) [s]; -1: no fault
    probability: Components  # that this rotor is faulty now (..., n) [1]
    kind: States  # what the fault looks like, an index into `FAULT_KINDS` (..., n)
    ambiguous: Mask  # declared, but it may as well be another rotor, or a disturbance (..., n)


class FaultEstimate(NamedTuple):
    """What a fault observer says."""

    fault: Vector  # attitude fault, roll, pitch, yaw [rad]
    std_dev: Vector  # its standard deviation [rad]; -1: the observer gives none
    state: States  # STARTING ... RECOVERING
    onset_age: Vector  # time since the onset of the present fault [s]; -1: no fault
    corrected: ImuSample  # the sample as the controller shall see it
    sensors: SensorDiagnosis | None = None  # None: of an observer of the attitude alone
    rotors: RotorEstimate | None = None  # None: of one that knows nothing of rotors, and on the test stand


class ComponentFault(NamedTuple):
    """A fault that is confirmed and not known to be gone, as quadftc_msgs/ComponentFault says it."""

    component: str  # attitude, gyro, accelerometer, rotor
    element: str  # roll, pitch, yaw of the attitude; 1, 2, ... of the rotors; else x, y, z
    kind: str  # of `FAULT_KINDS`
    state: int  # FAULTY or RECOVERING
    size: float  # reading minus truth, in ``unit``; of a rotor the share of its thrust that is lost
    std_dev: float  # of the size; -1: the observer gives none
    unit: str
    probability: float  # that the element is faulty now [1]; -1: the observer gives none
    ambiguous_with: tuple[str, ...]  # "component/element" that may be the faulty one instead
    onset_ns: int  # stamp of the onset [ns]


class DiagnosisReport(NamedTuple):
    """What is said of all components at a sample, as quadftc_msgs/Diagnosis says it."""

    stamp_ns: int  # of the sample [ns]
    watched: tuple[str, ...]  # components that are diagnosed now: healthy where there is no fault
    faults: tuple[ComponentFault, ...]


class DisturbanceObserverInputs(NamedTuple):
    """What a disturbance observer sees: body rate now, and the torque that acted since the sample before."""

    body_rate: Vector  # [rad/s]
    rate_valid: Flag
    torque: Vector  # [N m]


class RotorFeedback(NamedTuple):
    """What is known of the rotors at a sample in free flight; n rotors, in the order of the vehicle file."""

    torque: Vector  # of the measured speeds [N m]; zeros where they are not measured
    measured: Flag
    effectiveness: Components  # of each rotor (..., n) [1]; 1 where nothing is known


class ControllerInputs(NamedTuple):
    """What a controller sees."""

    imu: ImuSample
    reference: AttitudeReference
    disturbance: Vector  # estimate of d in (36) [rad/s²]
    rotors: RotorFeedback | None = None  # None: on the test stand

    @property
    def effectiveness(self) -> Components | None:
        """Effectiveness of the rotors (..., n) [1]; None: on the test stand."""
        return None if self.rotors is None else self.rotors.effectiveness


class ControllerOutput(NamedTuple):
    """What a controller says: a torque that the rotors can give, and how it came about."""

    torque: Vector  # [N m]
    error: Vector  # attitude minus reference, Euler angles [rad]
    sliding_variable: Vector  # S of (38) [rad/s]; zero where the controller has none
    saturated: Mask  # the law asked for more than the rotors can give


def effectiveness_of(rotors: RotorEstimate) -> Components:
    """Effectiveness (..., n) of the rotors for a controller: 1 of those that no fault is confirmed of."""
    xp = namespace(rotors.effectiveness)
    confirmed = (rotors.state == FAULTY) | (rotors.state == RECOVERING)
    return xp.where(confirmed, xp.clip(rotors.effectiveness, 0.0, 1.0), 1.0)


def is_usable(*vectors: Vector | Quaternion) -> bool:
    """Whether all numbers of NumPy vectors (n,) are finite and below `UNUSABLE`, as larger ones overflow."""
    for vector in vectors:
        for x in vector.tolist():
            if not -UNUSABLE < x < UNUSABLE:  # true for NaN
                return False
    return True


def has_attitude(sample: ImuSample) -> bool:
    """Whether a NumPy sample of one vehicle has an attitude that :func:`sanitised` keeps."""
    squared = sum([x * x for x in sample.q_xyzw.tolist()])
    return bool(sample.attitude_valid) and abs(squared - 1.0) <= 2.0 * UNIT_NORM_TOLERANCE


def has_rate(sample: ImuSample) -> bool:
    """Whether a NumPy sample of one vehicle has a body rate that :func:`sanitised` keeps."""
    return bool(sample.rate_valid) and sum([abs(x) for x in sample.body_rate.tolist()]) <= MAX_BODY_RATE


def usable(*arrays: Components) -> Flag:
    """Whether all numbers of arrays (..., n) are finite and below `UNUSABLE` (...), as :func:`is_usable`."""
    return functools.reduce(lambda a, b: a & b, [(abs(x) < UNUSABLE).all(axis=-1) for x in arrays])


def sanitised(sample: ImuSample) -> ImuSample:
    """Mark as absent what cannot be used, with finite numbers in its place.

    That is NaN, Inf, a quaternion off unit length, a body rate beyond `MAX_BODY_RATE`, and a specific force
    beyond `UNUSABLE`. Good channels are returned unchanged, bit for bit.
    """
    xp = namespace(sample.q_xyzw)
    squared = [x * x for x in components(sample.q_xyzw)]
    unit = xp.abs(sum(squared) - 1.0) <= 2.0 * UNIT_NORM_TOLERANCE  # false for NaN and Inf, too
    attitude_valid = sample.attitude_valid & unit
    turning = sum(abs(x) for x in components(sample.body_rate))
    rate_valid = sample.rate_valid & (turning <= MAX_BODY_RATE)  # false for NaN and Inf, too
    pushed = sum(abs(x) for x in components(sample.specific_force))
    force_valid = sample.force_valid & (pushed < UNUSABLE)
    level = xp.asarray([0.0, 0.0, 0.0, 1.0])
    return ImuSample(
        q_xyzw=where(column(attitude_valid), sample.q_xyzw, level),
        body_rate=where(column(rate_valid), sample.body_rate, 0.0),
        specific_force=where(column(force_valid), sample.specific_force, 0.0),
        attitude_valid=attitude_valid,
        rate_valid=rate_valid,
        force_valid=force_valid,
    )
