r"""The sliding-mode fault observer of Wang, Huang and Zhang (2021), equations (10)-(29).

Set-up. With the gyro as a second, fault-free output, y = [angles + f_s; body rate], (10)-(11) is a
permutation: z1 = body rate, z2 = angles, A1 = A2 = A4 = 0, A3 = I, C1 = C4 = I, F2 = I, W1 = I, B1 = J^-1,
and

    (12)  z1' = D1 f(x) + J^-1 u + Delta_d,        h1 = z1
    (13)  z2' = z1 + D2 f(x),                      h2 = z2 + f_s
    (14)  z3' = h2,                                h3 = z3

where D1 f is the body's gyroscopic acceleration and D2 f the rest of the kinematics (4) against (5) (zero
with ``kinematics="small_angle"``). The paper's own output, the angles alone, fails its Assumption 1;
docs/theory.md says why.

Observers, with e1 = h1 - z1^, e3 = h3 - h3^ (all gains scalar times I, so that P1 = p1 I, H = h I, F0 = I):

    (16)  z1^' = J^-1 u + D1 f + (k1^/2) p1 e1 + a1 e1 + v1                    A1 - A1s = a1 I
    (17)  z2^' = h1 + D2 f(z^) + (L1 + (k2^/2) h) e3
          z3^' = z2^ + L2 e3 + v2
    (18)  v1 = (xi + epsilon_1) e1 / |e1|
    (26)  v2 = (epsilon_s + epsilon_2) e3 / (|e3| + delta)
    (20)  k1^' = l_k1 |p1 e1|²            (21)  k2^' = l_k2 |h e3|²
    (27)  f_s^ = v2

Time stepping. The stiff injections (18) and (26) are solved implicitly: with everything else known, e+ = c -
dt (a e+ + rho e+ / (|e+| + delta)) leaves e+ parallel to c, and |e+| is the root of a quadratic. That does
not chatter at any step, however stiff (epsilon_s + epsilon_2) / delta is. z2^ takes the trapezoidal rule, of
order 2. e3 takes h2 - z2^ at the new sample: its mean over the step would put f_s^ half a sample late. An
error of order 1 is left in f_s^, dt f_s'' / 2 times delta / (epsilon_s + epsilon_2). The state is h3 - h3^,
as h3 and h3^ grow without bound and only their difference acts.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from quadftc_fdi.fault_observer import SHORTEST, FaultObserver, assume_healthy, correct_sample, register
from quadftc_model.arrays import Array, Column, Scalar, Vector, column, larger, namespace, norm, sqrt, where
from quadftc_model.parameters import parameter
from quadftc_model.rigid_body import gyroscopic_acceleration
from quadftc_model.rotations import euler_from_quaternion, euler_rates, quaternion_from_euler, wrap
from quadftc_model.samples import FaultEstimate, FaultObserverInputs


class State(NamedTuple):
    """Observer state at the last sample."""

    z1: Vector  # estimate of the body rate [rad/s]
    z2: Vector  # estimate of the angles [rad]
    e3: Vector  # h3 - h3^ [rad s]
    k1: Column  # adaptive gain of (20)
    k2: Column  # adaptive gain of (21)
    v1: Vector  # injection (18) [rad/s²]; its mean is the disturbance
    v2: Vector  # injection (26) [rad]: the fault estimate
    innovation: Vector  # h2 - z2^ [rad]
    h1: Vector  # gyro [rad/s]


@register("sliding_mode")
class SlidingMode(FaultObserver):
    """The paper's pair of observers; right in the paper's conditions: no gyro bias, and a healthy start."""

    has_detector: ClassVar[bool] = False

    epsilon_s: float = parameter(0.5, unit="rad", low=1e-6, doc="epsilon_s of (9): bound of the fault |f_s|")
    epsilon_2: float = parameter(0.1, unit="rad", low=0.0, doc="epsilon_2 of (19): gain above the bound")
    delta: float = parameter(1e-3, unit="rad s", low=1e-9, doc="delta of (26): smoothing of the injection v2")
    L1: float = parameter(0.05, unit="1/s^2", low=0.0, doc="L1-bar of (17); above 0 it makes f_s^ leak")
    L2: float = parameter(1.0, unit="1/s", low=0.0, doc="L2-bar of (17)")
    H: float = parameter(1.0, unit="1", low=0.0, doc="H-bar of (17) and (21)")
    l_k2: float = parameter(1.0, unit="1/(rad^2 s^5)", low=0.0, doc="l_k2 of (21): adaptation rate of k2^")
    a1: float = parameter(20.0, unit="1/s", low=1e-6, doc="A1s = -a1 I of (16)")
    q1: float = parameter(40.0, unit="1", low=1e-6, doc="Lyapunov equation A1s' P1 + P1 A1s = -q1 I")
    xi: float = parameter(5.0, unit="rad/s^2", low=0.0, doc="xi of (18): bound of the disturbance |Delta_d|")
    epsilon_1: float = parameter(1.0, unit="rad/s^2", low=0.0, doc="epsilon_1 of (18): gain above the bound")
    l_k1: float = parameter(1.0, unit="1/(rad^2 s^3)", low=0.0, doc="l_k1 of (20): adaptation rate of k1^")
    kinematics: str = parameter("full", choices=("full", "small_angle"), doc="(4), or its linearisation (5)")

    @property
    def p1(self) -> float:
        """P1 = p1 I, the Lyapunov matrix of A1s."""
        return self.q1 / (2.0 * self.a1)

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        imu = inputs.imu
        zeros = namespace(imu.body_rate).zeros_like(imu.body_rate)
        angles = euler_from_quaternion(imu.q_xyzw)
        gain = zeros[..., :1]
        return State(imu.body_rate, angles, zeros, gain, gain, zeros, zeros, zeros, imu.body_rate)

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Advance both observers by ``dt`` [s] to the sample."""
        imu = inputs.imu
        h1 = where(column(imu.rate_valid), imu.body_rate, state.h1)
        z1, k1, v1 = self._rate_observer(state, inputs.torque, h1, dt)
        state = self._fault_observer(state, inputs, h1, dt)._replace(z1=z1, k1=k1, v1=v1, h1=h1)
        return state, assume_healthy(state.v2, correct_sample(imu, quaternion_from_euler(state.z2), h1))

    def _rate_observer(self, state: State, torque: Array, h1: Array, dt: float) -> tuple[Array, Array, Array]:
        """Observer (16) with (18) and (20): z1^, k1^ and v1 at the new sample."""
        inertia = self.vehicle.inertia
        D1_f = 0.5 * (gyroscopic_acceleration(inertia, state.h1) + gyroscopic_acceleration(inertia, h1))
        c = h1 - (state.z1 + dt * (torque / inertia + D1_f))
        linear = 0.5 * state.k1 * self.p1 + self.a1
        e1, v1 = implicit_injection(c, linear, self.xi + self.epsilon_1, 0.0, dt)
        k1 = state.k1 + dt * self.l_k1 * self.p1**2 * norm(e1) ** 2
        return h1 - e1, k1, v1

    def _fault_observer(self, state: State, inputs: FaultObserverInputs, h1: Array, dt: float) -> State:
        """Observer (17) with (21), (26) and (27): z2^, e3, k2^, v2 and h2 - z2^ at the new sample."""
        imu = inputs.imu
        L1 = self.L1 + (0.5 * self.H * state.k2 if self.kinematics == "full" else 0.0)  # D2 = 0 for (5)
        z2 = self._kinematics(state.z2, state.h1, h1, dt) + 0.5 * dt * L1 * state.e3  # but for L1 e3+ dt / 2
        measured = wrap(euler_from_quaternion(imu.q_xyzw) - z2)  # h2 - z2^
        innovation = where(column(imu.attitude_valid), measured, state.innovation)  # absent: as before
        rho = self.epsilon_s + self.epsilon_2
        c = state.e3 + dt * innovation
        e3, v2 = implicit_injection(c, self.L2 + 0.5 * dt * L1, rho, self.delta, dt)
        k2 = state.k2 + dt * self.l_k2 * self.H**2 * norm(e3) ** 2
        correction = 0.5 * dt * L1 * e3
        return state._replace(z2=z2 + correction, e3=e3, k2=k2, v2=v2, innovation=innovation - correction)

    def _kinematics(self, angles: Array, rate: Array, next_rate: Array, dt: float) -> Array:
        """Angles after ``dt`` on the gyro: the trapezoidal rule with Heun's prediction."""
        if self.kinematics == "small_angle":
            return angles + 0.5 * dt * (rate + next_rate)
        slope = euler_rates(angles, rate)
        predicted = angles + dt * slope
        return angles + 0.5 * dt * (slope + euler_rates(predicted, next_rate))


def implicit_injection(
    c: Vector, linear: Array, rho: Scalar, delta: Scalar, dt: Scalar
) -> tuple[Vector, Vector]:
    """Solve e = c - dt (linear e + injection), injection = rho e / (|e| + delta); return both.

    c (..., 3) is the error without injection, ``linear`` (..., 1) [1/s] a gain that is not negative. With
    delta = 0 the injection takes the value that keeps e at 0. With ``dt`` [s] of 0 the error stays c.
    """
    size = norm(c)
    a = 1.0 + dt * linear
    b = a * delta + dt * rho - size
    # positive root of a n² + b n - |c| delta = 0, in the form that does not cancel for b > 0
    root = sqrt(b * b + 4.0 * a * delta * size)
    n = where(b > 0.0, 2.0 * size * delta / where(b > 0.0, b + root, 1.0), (root - b) / (2.0 * a))
    unit = c / where(size > 0.0, size, 1.0)
    # where delta = 0 and n = 0, the injection holds e there
    sliding = rho / where(n + delta > 0.0, n + delta, 1.0) * n
    held = where(dt > 0.0, size / larger(dt, SHORTEST), 0.0)
    return n * unit, where(n + delta > 0.0, sliding, held) * unit
