r"""The adaptive augmented-state Kalman filter: angles, gyro bias, and the fault as a random walk.

The fault diagnosis of Zhong, Zhang and Zhang (2017) and Zhong et al. (2019), references [26] and [9] of Wang,
Huang and Zhang (2021), for our sensors. x are the Euler angles, b the gyro bias, f_s the fault, m the gyro:

    x' = E(x) (m - b - n_g),   b' = n_b,   f_s' = n_f,   y = x + f_s + E(x) n_y

in one extended Kalman filter of nine states, coupled by the full kinematics (4), as b in Euler rates is no
constant when the vehicle turns. The references split it into a filter without fault and one of the fault
alone; that is algebraically this filter (Hsieh and Chen 1999).

Adaptation. A fault begins faster than its random walk says. As in the adaptive two-stage filter (Kim, Lee
and Park 2009) a forgetting factor lambda_i >= 1 raises the variance of f_s,i until the innovation r_i is as
large as the filter believes. With m_ij the mean of r_i over the time T_j (one sample, and three longer times
for slow faults) and v_ij its variance, S_ii the one of r_i itself:

    P_f,ii <- lambda_i P_f,ii,  (lambda_i - 1) P_f,ii = max over j of m_ij² - v_ij  where m_ij² > gate² v_ij

and lambda_i = 1 where no mean is out of bounds. (With a gate of 1 noise alone keeps lambda above 1, and the
gyro bias is hardly learnt.) The means restart after lambda > 1. On a faulty axis, and for ``alert_time``
after that, the random walk of f_s is ``faulty_walk``, so that f_s takes what changes, and not b.

What it cannot do. x and f_s appear only as their sum, and both may be constant: the model has three invariant
zeros at s = 0. Only the initial condition f_s(0) = 0, up to ``initial_fault``, tells an angle error from a
constant fault; std_dev never falls below it. A fault at the first sample is taken for attitude and stays so.
The angle random walk accumulates in x and, with the other sign, in f_s. An error made in telling a fault from
the attitude (at its onset, or by the error of b^ times its length) stays for ever: this filter never trusts
the sensor again after the fault. Errors of the attitude that are not white are faults to it.

The attitude is a quaternion, carried on the mean of two gyro samples; only errors are Euler angles. Beyond 80
deg of pitch the filter dead-reckons. The corrected sample is its attitude and m - b^.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from published_observers.detection import Detection
from quadftc_fdi import fault_observer
from quadftc_fdi.fault_observer import (
    SHORTEST,
    FaultObserver,
    comparable,
    correct_sample,
    dead_reckon,
    register,
)
from quadftc_model.arrays import (
    AnyArray,
    Array,
    Float,
    Quaternion,
    Vector,
    clip,
    column,
    components,
    cos,
    diagonal,
    larger,
    namespace,
    sin,
    solve_positive,
    sqrt,
    stacked,
    tan,
    where,
)
from quadftc_model.parameters import parameter
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler, wrap
from quadftc_model.samples import FaultEstimate, FaultObserverInputs

DEG = math.pi / 180.0
WINDOWS = (0.0, 0.03, 0.3, 1.5)  # s; T_j, the first is one sample
UNKNOWN = 1.0  # rad; standard deviation of an angle that is absent at the first sample


class State(NamedTuple):
    """Filter state at the last sample. The errors in P: angles, gyro bias, fault."""

    q_xyzw: Quaternion  # attitude x^
    gyro_bias: Vector  # b^ [rad/s]
    fault: Vector  # f_s^ [rad]
    P: Float[AnyArray, "*batch 9 9"]  # covariance [rad, rad/s, rad]
    gyro: Vector  # [rad/s]
    means: Float[AnyArray, "*batch 3 4"]  # m_ij [rad]
    alert: Vector  # how long n_f is still that of a faulty axis [s]
    detection: Detection


@register("augmented_kalman")
class AugmentedKalman(FaultObserver):
    """Kalman filter with the fault as a state; finds the gyro bias, and no fault that is there at first."""

    attitude_noise: float = parameter(0.1 * DEG, unit="rad", low=1e-6, doc="n_y of a sample, 1 sigma")
    gyro_noise: float = parameter(0.007 * DEG, unit="rad/sqrt(s)", low=1e-9, doc="n_g: angle random walk")
    gyro_bias: float = parameter(1.5 * DEG, unit="rad/s", low=1e-9, doc="b at the first sample, 1 sigma")
    gyro_bias_walk: float = parameter(2e-4 * DEG, unit="rad/s/sqrt(s)", low=0.0, doc="n_b: its random walk")
    fault_walk: float = parameter(0.002 * DEG, unit="rad/sqrt(s)", low=0.0, doc="n_f of a healthy axis")
    faulty_walk: float = parameter(0.3 * DEG, unit="rad/sqrt(s)", low=0.0, doc="n_f if faulty or on alert")
    initial_fault: float = parameter(0.01 * DEG, unit="rad", low=1e-9, doc="f_s at the first sample, 1 sigma")
    gap_walk: float = parameter(
        3.0 * DEG, unit="rad/sqrt(s)", low=0.0, doc="random walk of the angles while the gyro is absent"
    )
    gate: float = parameter(5.0, unit="1", low=1.0, doc="bound of a mean innovation, in standard deviations")
    alert_time: float = parameter(
        0.5, unit="s", low=0.0, doc="how long an axis is on alert after an innovation out of bounds"
    )
    detection_level: float = parameter(4.0, unit="1", low=0.0, doc="|f_s^| / std_dev that is a fault")
    recovery_level: float = parameter(2.5, unit="1", low=0.0, doc="|f_s^| / std_dev that is none")
    recovery_time: float = parameter(1.0, unit="s", low=0.0, doc="how long it must be none to end the fault")

    def init(self, inputs: FaultObserverInputs) -> State:
        """Start on the measurement: the sensor counts as healthy at the first sample."""
        imu = inputs.imu
        xp = namespace(imu.body_rate)
        zeros = xp.zeros_like(imu.body_rate)
        angle = zeros + where(column(imu.attitude_valid), self.attitude_noise, UNKNOWN)
        std_devs = xp.concatenate([angle, zeros + self.gyro_bias, zeros], axis=-1)
        hidden = xp.concatenate([xp.eye(3), xp.zeros((3, 3)), -xp.eye(3)], axis=-1)  # x^ is off by the fault
        P = (std_devs**2)[..., None] * xp.eye(9) + self.initial_fault**2 * (hidden.T @ hidden)
        means = xp.stack([zeros] * len(WINDOWS), axis=-1)
        return State(imu.q_xyzw, zeros, zeros, P, imu.body_rate, means, zeros, Detection.start(zeros))

    def step(self, state: State, inputs: FaultObserverInputs, dt: float) -> tuple[State, FaultEstimate]:
        """Predict on the gyro over ``dt`` [s], adapt, and correct by the attitude."""
        imu = inputs.imu
        # predict by the gyro; an absent one keeps its last value
        gyro = where(column(imu.rate_valid), imu.body_rate, state.gyro)
        b = state.gyro_bias
        q_xyzw = dead_reckon(state.q_xyzw, state.gyro - b, gyro - b, dt)
        x, y = euler_from_quaternion(q_xyzw), euler_from_quaternion(imu.q_xyzw)
        E, J = kinematic_matrices(x, gyro - b)
        EE = E @ E.swapaxes(-1, -2)
        predicted = self._predict(state.P, E, J, EE, imu.rate_valid, dt)
        # innovation r and its covariance S; adapt the variance of the fault, then correct
        usable = column(imu.attitude_valid) & comparable(x, y) & (dt > 0.0)
        r = where(usable, wrap(y - x - state.fault), 0.0)
        PH = predicted[..., :3] + predicted[..., 6:]  # P H', H = [I 0 I]
        S = PH[..., :3, :] + PH[..., 6:, :] + self.attitude_noise**2 * EE
        state, growth = self._adapt(state, r, diagonal(S), usable, dt)
        correction, P = _correct(predicted, PH, S, growth, r, usable)
        # detect the fault by its size in standard deviations
        fault = wrap(state.fault + correction[..., 6:])
        std_dev = sqrt(diagonal(P)[..., 6:])
        detection = state.detection.step(
            abs(fault) / std_dev, self.detection_level, self.recovery_level, self.recovery_time, dt
        )
        state = state._replace(
            q_xyzw=where(usable, quaternion_from_euler(x + correction[..., :3]), q_xyzw),
            gyro_bias=b + correction[..., 3:6],
            fault=fault,
            P=P,
            gyro=gyro,
            detection=detection,
        )
        corrected = correct_sample(imu, state.q_xyzw, gyro - state.gyro_bias)
        return state, detection.report(fault, std_dev, ~detection.low | (state.alert > 0.0), corrected)

    def _predict(self, P: Array, E: Array, J: Array, EE: Array, rate_valid: Array, dt: float) -> Array:
        """F P F' + Q, with F = I + dt [[J, -E, 0], [0, 0, 0], [0, 0, 0]]."""
        xp = namespace(P)
        F = xp.concatenate([xp.eye(3) + dt * J, -dt * E, xp.zeros_like(E)], axis=-1)  # its upper rows
        upper = F @ P
        gap = where(column(column(rate_valid)), 0.0, self.gap_walk**2) * xp.eye(3)
        angles = upper @ F.swapaxes(-1, -2) + dt * (self.gyro_noise**2 * EE + gap)
        across = upper[..., 3:]
        walks = [dt * self.gyro_bias_walk**2] * 3 + [dt * self.fault_walk**2] * 3
        others = P[..., 3:, 3:] + xp.asarray(walks) * xp.eye(6)
        above = xp.concatenate([angles, across], axis=-1)
        below = xp.concatenate([across.swapaxes(-1, -2), others], axis=-1)
        return xp.concatenate([above, below], axis=-2)

    def _adapt(self, state: State, r: Array, S_ii: Array, usable: Array, dt: float) -> tuple[State, Array]:
        """Means of the innovation, and what is added to P_f,ii (..., 3) [rad²]."""
        windows = namespace(r).asarray(WINDOWS)
        gains = dt / larger(windows + dt, SHORTEST)
        m = state.means + where(column(usable), gains * (r[..., None] - state.means), 0.0)
        v = S_ii[..., None] * (gains / (2.0 - gains))  # of the mean of white innovations
        excess = where(m * m > self.gate**2 * v, m * m - v, 0.0).max(axis=-1)
        excess = where(usable, excess, 0.0)  # (lambda_i - 1) P_f,ii
        sudden = excess > 0.0
        alert = where(sudden, self.alert_time, larger(state.alert - dt, 0.0))
        faulty = state.detection.detected | (alert > 0.0)
        walk = where(faulty, larger(self.faulty_walk**2 - self.fault_walk**2, 0.0), 0.0)
        means = where(column(sudden), 0.0, m)
        return state._replace(means=means, alert=alert), excess + dt * walk


def _correct(P: Array, PH: Array, S: Array, growth: Array, r: Array, usable: Array) -> tuple[Array, Array]:
    """Correction of the nine states (..., 9) and their covariance, after the variance of f_s has grown."""
    xp = namespace(P)
    more = growth[..., None] * xp.eye(3)
    grown = xp.concatenate([PH[..., :6, :], PH[..., 6:, :] + more], axis=-2)
    K = where(column(usable), solve_positive(S + more, grown.swapaxes(-1, -2)).swapaxes(-1, -2), 0.0)
    growths = xp.concatenate([xp.zeros_like(r), xp.zeros_like(r), growth], axis=-1)
    after = P + growths[..., None] * xp.eye(9) - K @ grown.swapaxes(-1, -2)
    return (K @ r[..., None])[..., 0], 0.5 * (after + after.swapaxes(-1, -2))


def kinematic_matrices(
    angles: Vector, body_rate: Vector
) -> tuple[Float[AnyArray, "*batch 3 3"], Float[AnyArray, "*batch 3 3"]]:
    """E [1] of (4), x' = E(x) omega, and the Jacobian [1/s] of E(x) omega by x.

    Pitch is kept within ``MAX_PITCH``, so that both are bounded.
    """
    xp = namespace(angles)
    phi, theta, _ = components(angles)
    theta = clip(theta, -fault_observer.MAX_PITCH, fault_observer.MAX_PITCH)
    _, q, r = components(body_rate)
    s, c, t, sec = sin(phi), cos(phi), tan(theta), 1.0 / cos(theta)
    across = s * q + c * r  # cos(theta) psi'
    theta_dot = c * q - s * r
    one, zero = xp.ones_like(s), xp.zeros_like(s)
    E = [one, s * t, c * t, zero, c, -s, zero, s * sec, c * sec]
    by_phi = stacked([t * theta_dot, -across, sec * theta_dot])
    by_theta = stacked([sec * sec * across, zero, sec * t * across])
    J = xp.stack([by_phi, by_theta, xp.zeros_like(angles)], axis=-1)
    return stacked(E).reshape(J.shape), J
