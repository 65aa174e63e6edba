r"""A residual gate with a threshold on accumulated inconsistency, as in PX4's sensor selector.

PX4 compares each gyro with the mean of all (EKF2Selector.cpp, UpdateErrorScores, and VotedSensorsUpdate). The
difference d goes through a first-order low pass, 0.95 d + 0.05 (difference) at each sample, and what is above
7 deg/s (EKF2_SEL_IMU_RAT) adds up; from 15 deg (EKF2_SEL_IMU_ANG) on the sensor is faulty:

    a <- max(0, a + (|d| - rate_threshold) dt),      faulty: a > angle_threshold

Here the same law compares the gyro with the measured attitude y, each Euler angle by itself. x^ is the
attitude dead-reckoned on the gyro and, where a = 0, pulled to y with time constant T. But for the pull, its
residual r = y - x^ changes by the difference in question: with g = dt / (T + dt) and r^- the residual left
before,

    rho <- (1 - g) (rho + r - r^-),    d = rho / T      low pass of y' less the rate from the gyro, exactly
    x^ <- x^ + g r                       where a = 0

T = 0.1 s is PX4's factor of 0.95 at 200 Hz. Where a > 0, x^ is carried on by the gyro alone: so it dates from
before the fault, and is what is switched to.

    state        begins when                                  attitude given       fault estimate
    HEALTHY      a = 0                                        measured             0
    SUSPECT      a > 0                                        measured             0
    FAULTY       a > angle_threshold                          x^                   y - x^
    RECOVERING   FAULTY, and |y - x^| < recovery_angle        x^                   y - x^

RECOVERING ends in FAULTY when the residual is larger again, and in HEALTHY after ``recovery_time``. (PX4
itself lets a fall as soon as d is small, and so forgives any constant fault.) After ``patience`` the measured
attitude is believed again, whatever it says.

What it cannot do. A step of less than angle_threshold, and anything slower than rate_threshold, is never
found. On a faulty axis attitude and estimate drift at the gyro bias; once the residual has drifted out of
recovery_angle, only ``patience`` ends the state. An attitude beyond 80 deg of pitch counts as absent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_fdi.fault_observer import FaultObserver, comparable, correct_sample, dead_reckon, register
from quadftc_model import samples
from quadftc_model.arrays import Array, Quaternion, States, Vector, any_of, column, larger, namespace, where
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FAULTY, HEALTHY, FaultEstimate, FaultObserverInputs

DEG = math.pi / 180.0


class State(NamedTuple):
    """Observer state at the last sample."""

    q_xyzw: Quaternion  # x^
    gyro: Vector  # [rad/s]
    residual: Vector  # r^-, y - x^ after the pull [rad]
    rho: Vector  # T d [rad]
    accumulated: Vector  # a [rad]
    state: States
    age: Vector  # time since a was last 0 [s]
    calm: Vector  # time since RECOVERING began [s]


@register("threshold")
class Threshold(FaultObserver):
    """Switch to dead reckoning once gyro and attitude have disagreed for too long; finds large faults."""

    rate_threshold: float = parameter(
        7.0 * DEG, unit="rad/s", low=0.0, doc="inconsistency that does not add up (EKF2_SEL_IMU_RAT)"
    )
    angle_threshold: float = parameter(
        15.0 * DEG, unit="rad", low=1e-6, doc="accumulated inconsistency that is a fault (EKF2_SEL_IMU_ANG)"
    )
    filter_time: float = parameter(0.1, unit="s", low=1e-3, doc="T: time constant of the low pass of d")
    recovery_angle: float = parameter(2.0 * DEG, unit="rad", low=0.0, doc="residual that is no fault")
    recovery_time: float = parameter(1.0, unit="s", low=0.0, doc="how long it must be none to end the fault")
    patience: float = parameter(30.0, unit="s", low=0.0, doc="longest dead reckoning")

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        zeros = xp.zeros_like(imu.body_rate)
        healthy = xp.full_like(zeros, HEALTHY, dtype=xp.uint8)
        return State(imu.q_xyzw, imu.body_rate, zeros, zeros, zeros, healthy, zeros, zeros)

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        gyro = where(column(imu.rate_valid), imu.body_rate, state.gyro)
        y = euler_from_quaternion(imu.q_xyzw)
        q_xyzw = dead_reckon(state.q_xyzw, state.gyro, gyro, dt)
        x = euler_from_quaternion(q_xyzw)
        usable = column(imu.attitude_valid) & comparable(x, y)
        # low pass of the inconsistency, and its sum beyond the threshold
        g = dt / (self.filter_time + dt)
        r = where(usable, wrap(y - x), state.residual)
        rho = where(usable, (1.0 - g) * (state.rho + wrap(r - state.residual)), state.rho)
        excess = (abs(rho) / self.filter_time - self.rate_threshold) * dt
        a = larger(state.accumulated + where(usable, excess, 0.0), 0.0)
        # switch, and pull x^ to y where nothing adds up
        state = self._switch(state, a, abs(r), dt)
        switched = state.state >= FAULTY
        pull = where(usable & (state.state == HEALTHY), g * r, 0.0)
        q_xyzw = where(usable, quaternion_from_euler(x + pull), q_xyzw)
        state = state._replace(q_xyzw=q_xyzw, gyro=gyro, residual=r - pull, rho=rho)
        # give the measured attitude, x^ where it is absent, and on switched axes the angles of x^
        measured = column(imu.attitude_valid)
        mixed = quaternion_from_euler(where(switched, x, y))
        known = where(measured, imu.q_xyzw, q_xyzw)
        given = where(measured & any_of(switched), mixed, known)
        fault, age = where(switched, r, 0.0), where(switched, state.age, -1.0)
        corrected = correct_sample(imu, given, gyro)
        return state, FaultEstimate(fault, namespace(age).full_like(age, -1.0), state.state, age, corrected)

    def _switch(self, state: State, a: Array, residual: Array, dt: float) -> State:
        """Take the transitions of the table, with the new a and |y - x^|, each (..., 3)."""
        xp = namespace(a)
        was_switched = state.state >= FAULTY
        small = residual < self.recovery_angle
        calm = where(was_switched & small, state.calm + dt, 0.0)
        age = where((a > 0.0) | was_switched, state.age + dt, 0.0)
        over = (calm >= self.recovery_time) | (age >= self.patience)
        trusted = where(a > self.angle_threshold, FAULTY, where(a > 0.0, samples.SUSPECT, HEALTHY))
        distrusted = where(over, HEALTHY, where(small, samples.RECOVERING, FAULTY))
        now = where(was_switched, distrusted, trusted)
        ended = was_switched & over
        return state._replace(
            accumulated=where(ended, 0.0, a),
            state=now.astype(xp.uint8),
            age=where(ended, 0.0, age),
            calm=where(ended, 0.0, calm),
        )
