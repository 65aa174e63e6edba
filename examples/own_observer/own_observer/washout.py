"""The residual of dead reckoning, washed out: a small fault observer.

The gyro carries an attitude x^ on, which the measured attitude y pulls with the time constant T:

    r = y - x^,    x^ <- x^ + g r,    g = dt / (T + dt),    fault estimate (1 - g) r

So a fault shows at once and is forgotten with T, and a gyro bias b leaves an error of b T. The law says
FAULTY where the estimate exceeds the threshold. Beyond 80 deg of pitch it flies on the gyro alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from quadftc_fdi.fault_observer import FaultObserver, comparable, correct_sample, dead_reckon, register
from quadftc_model.arrays import Quaternion, Vector, namespace
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FAULTY, HEALTHY, FaultEstimate, FaultObserverInputs


class WashoutState(NamedTuple):
    """Observer state at the last sample."""

    q_xyzw: Quaternion  # x^
    gyro: Vector  # [rad/s]
    fault: Vector  # [rad]
    age: Vector  # how long each axis has been faulty [s]


@register("washout")
class Washout(FaultObserver):
    """Compare the attitude with the gyro, and forget slowly."""

    time_constant: float = parameter(200.0, unit="s", low=1e-3, doc="T: how long a fault is remembered")
    threshold: float = parameter(math.radians(0.2), unit="rad", low=0.0, doc="estimate that is a fault")

    def init(self, inputs: FaultObserverInputs) -> WashoutState:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        rate = inputs.imu.body_rate
        zeros = namespace(rate).zeros_like(rate)
        return WashoutState(inputs.imu.q_xyzw, rate, zeros, zeros)

    def step(
        self, state: WashoutState, inputs: FaultObserverInputs, dt: float
    ) -> tuple[WashoutState, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        # carry the attitude on by the gyro; an absent rate keeps its last value
        gyro = xp.where(imu.rate_valid[..., None], imu.body_rate, state.gyro)
        q_xyzw = dead_reckon(state.q_xyzw, state.gyro, gyro, dt)
        x, y = euler_from_quaternion(q_xyzw), euler_from_quaternion(imu.q_xyzw)
        # pull it to the measurement, where there is one
        usable = imu.attitude_valid[..., None] & comparable(x, y)
        r = xp.where(usable, wrap(y - x), 0.0)
        g = dt / (self.time_constant + dt)
        q_xyzw = xp.where(usable, quaternion_from_euler(x + g * r), q_xyzw)
        # judge what is left; without a measurement, the fault stays what it was
        fault = xp.where(usable, (1.0 - g) * r, state.fault)
        faulty = xp.abs(fault) > self.threshold
        age = xp.where(faulty, state.age + dt, 0.0)
        estimate = FaultEstimate(
            fault=fault,
            std_dev=xp.full_like(fault, -1.0),
            state=xp.where(faulty, FAULTY, HEALTHY).astype(xp.uint8),
            onset_age=xp.where(faulty, age, -1.0),
            corrected=correct_sample(imu, q_xyzw, gyro),
        )
        return WashoutState(q_xyzw, gyro, fault, age), estimate
