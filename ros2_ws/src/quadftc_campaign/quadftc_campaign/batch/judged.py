"""What is judged of a flight, sample by sample: how the vehicle moves, and what is said of it."""

from __future__ import annotations

from typing import NamedTuple

from quadftc_model.arrays import Array, Components, Flag, Mask, Scalar, States, Vector
from quadftc_model.samples import RotorCondition


class Motion(NamedTuple):
    """How a vehicle moves, true."""

    angles: Vector  # Euler angles [rad]
    disturbance: Vector  # [rad/s²]
    position: Vector | None  # [m]; None: on the test stand


class OfSensors(NamedTuple):
    """Something of each sensor."""

    attitude: Array
    gyro: Array
    accelerometer: Array


class Place(NamedTuple):
    """Where a vehicle in free flight shall be, and where it takes itself to be."""

    reference: Vector  # [m]
    estimate: Vector  # [m]


class Rotors(NamedTuple):
    """The rotors, and what is said of them."""

    condition: RotorCondition  # true
    state: States
    effectiveness: Components  # estimated [1]
    ambiguous: Mask


class JudgeInputs(NamedTuple):
    """A sample that is taken, and what is known of the one that leaves the IMU then."""

    motion: Motion  # at the sample that is taken
    left: Flag  # one has left the IMU; if not, the rest says nothing
    delivered: Flag  # and no fault has withheld it
    time: Scalar  # when that one was taken [s]
    faults: OfSensors  # true: [rad], [rad/s], [m/s²]
    reference: Vector  # Euler angles [rad]
    estimate: Vector  # of the fault of the attitude [rad]
    state: States  # of the attitude
    sensors: OfSensors  # states of each
    ambiguous: tuple[Mask, Mask]  # of attitude and gyro
    disturbance: Vector  # estimated [rad/s²]
    torque: Vector  # [N m]
    saturated: Mask
    failed: tuple[Flag, ...]  # laws that restart
    place: Place | None  # None: on the test stand
    rotors: Rotors | None  # None: on the test stand
