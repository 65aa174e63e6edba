r"""The classical sliding-mode observer for sensor faults.

Of Edwards, Spurgeon and Patton (2000) and Tan and Edwards (2002), references [13] and [14] of Wang, Huang
and Zhang (2021). With the outputs y1 = x + f_s (angles, faulty) and y2 = omega (gyro, faultless), a
first-order filter of y1 makes an actuator fault of the sensor fault:

    x'   = E(x) y2                          the kinematics (4); y2 is measured
    z_f' = -a_f z_f + a_f (x + f_s)         the filter, which is run; its output z_f is known

In the canonical form of [13], x1 = x is not measured and x2 = z_f is; A11 = 0, A21 = a_f I, A22 = -a_f I, and
f_s acts on x2 alone, through D2 = a_f I. (The observer of y2 in that form reconstructs the disturbance, and
is left out.) The observer, with e = z_f - z_f^:

    x^'   = E(x^) y2 + (l / a_f) nu
    z_f^' = -a_f z_f^ + a_f x^ + (a_s - a_f) e + nu,    nu = rho e / |e|,   rho > a_f |f_s|

with poles by placement: e' = -a_s e + a_f (x - x^ + f_s) - nu, and on e = 0 the error of the angles has the
pole -l. There the equivalent injection is nu_eq = a_f (x - x^ + f_s), and its low pass, of time constant tau,
gives

    f_s^ = nu_eq / a_f

What it cannot do. The reduced motion has the poles of the plant, which are at 0 ([14] asks for a stable
plant): the invariant zeros at s = 0 of our sensors. So l must not be 0: a constant f_s^ leaks away with time
constant 1 / l, and with a small l a gyro bias b moves f_s^ by -b t. It is right without gyro bias and after a
healthy start. On the sliding surface f_s^ is the low-passed difference of measured and dead-reckoned angles.

Time stepping. nu is discontinuous and is stepped implicitly, see ``implicit_injection``: e is 0 after one
sample within the reach dt rho, without chattering. Only the difference e acts, so e is the state. A sample
without attitude is bridged with x - x^ + f_s = f_s^; so is one beyond 80 deg of pitch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from published_observers.detection import Detection
from quadftc_fdi.fault_observer import FaultObserver, comparable, correct_sample, dead_reckon, register
from quadftc_fdi.fault_observers.sliding_mode import implicit_injection
from quadftc_model.arrays import Quaternion, Vector, column, exp, namespace, where
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FaultEstimate, FaultObserverInputs

DEG = math.pi / 180.0


class State(NamedTuple):
    """Observer state at the last sample."""

    q_xyzw: Quaternion  # attitude x^
    e: Vector  # z_f - z_f^ [rad]
    fault: Vector  # f_s^ [rad]
    gyro: Vector  # y2 [rad/s]
    detection: Detection


@register("edwards_spurgeon")
class EdwardsSpurgeon(FaultObserver):
    """Sensor fault from the equivalent injection; right without gyro bias and after a healthy start."""

    a_f: float = parameter(20.0, unit="1/s", low=1e-3, doc="A_f = a_f I: bandwidth of the angles' filter")
    a_s: float = parameter(40.0, unit="1/s", low=0.0, doc="A22s = -a_s I: pole of e = z_f - z_f^, but for nu")
    leak: float = parameter(1e-4, unit="1/s", low=0.0, doc="l: on e = 0 the angle error's pole is -l")
    rho: float = parameter(12.0, unit="rad/s", low=1e-9, doc="size of nu; must exceed a_f |f_s|")
    tau: float = parameter(0.02, unit="s", low=1e-6, doc="time constant of the low pass of nu")
    detection_level: float = parameter(0.3 * DEG, unit="rad", low=1e-9, doc="|f_s^| that is a fault")
    recovery_level: float = parameter(0.15 * DEG, unit="rad", low=1e-9, doc="|f_s^| that is none")
    recovery_time: float = parameter(1.0, unit="s", low=0.0, doc="how long it must be none to end the fault")

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        imu = inputs.imu
        zeros = namespace(imu.body_rate).zeros_like(imu.body_rate)
        return State(imu.q_xyzw, zeros, zeros, imu.body_rate, Detection.start(zeros))

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Advance by ``dt`` [s] to the sample."""
        imu = inputs.imu
        # the kinematics run on the gyro; an absent gyro keeps its last value
        y2 = where(column(imu.rate_valid), imu.body_rate, state.gyro)
        q_xyzw = dead_reckon(state.q_xyzw, state.gyro, y2, dt)
        x = euler_from_quaternion(q_xyzw)
        y1 = euler_from_quaternion(imu.q_xyzw)
        usable = column(imu.attitude_valid) & comparable(x, y1)
        # inject on the surface e = 0; the low pass of nu is the fault, its leak corrects x^
        innovation = where(usable, wrap(y1 - x), state.fault)  # x - x^ + f_s
        c = state.e + dt * self.a_f * innovation
        e, nu = implicit_injection(c, self.a_s, self.rho, 0.0, dt)
        fault = state.fault + (1.0 - exp(-dt / self.tau)) * (nu / self.a_f - state.fault)
        leaked = quaternion_from_euler(x + dt * (self.leak / self.a_f) * nu)
        q_xyzw = where(usable, leaked, q_xyzw)
        detection = state.detection.step(
            abs(fault), self.detection_level, self.recovery_level, self.recovery_time, dt
        )
        corrected = correct_sample(imu, q_xyzw, y2)
        estimate = detection.report(fault, namespace(fault).full_like(fault, -1.0), ~detection.low, corrected)
        return State(q_xyzw, e, fault, y2, detection), estimate
