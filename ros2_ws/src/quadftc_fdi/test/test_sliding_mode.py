"""The sliding-mode fault observer: implicit step, accuracy, gaps (theory: tests/test_theory_*.py)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_c import fly_arrays

from quadftc_fdi.fault_observers.sliding_mode import SlidingMode, implicit_injection
from quadftc_model.rotations import body_rates, euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("qball_x4")
AMPLITUDE, FREQUENCY, PHASE = np.array([0.3, 0.25, 0.5]), np.array([1.1, 0.9, 0.7]), np.array([0.0, 1.0, 2.0])


def motion(time):
    """Euler angles [rad] and body rate [rad/s] of a smooth motion."""
    angle = FREQUENCY * time + PHASE
    angles = AMPLITUDE * np.sin(angle)
    return angles, body_rates(angles, AMPLITUDE * FREQUENCY * np.cos(angle))


def still(_time):
    return np.zeros(3), np.zeros(3)


def flown(observer, duration, fault, rate=250, motion=motion, gyro_bias=0.0, absent=(0.0, 0.0), torque=0.0):
    """Times (n,), estimates (n, 3), corrected angles (n, 3) and the last state."""
    times = np.arange(round(duration * rate) + 1) / rate
    angles, body_rate = (np.array(column) for column in zip(*map(motion, times), strict=True))
    there, seen = np.ones(len(times), bool), (times < absent[0]) | (absent[1] <= times)
    q_xyzw = quaternion_from_euler(angles + np.array([fault(time) for time in times]))
    imu = ImuSample(q_xyzw, body_rate + gyro_bias, np.zeros_like(angles), seen, there, there)
    inputs = FaultObserverInputs(imu, np.zeros_like(angles) + torque)
    state, said = fly_arrays(observer, inputs, 1.0 / rate)
    return times, said.fault, euler_from_quaternion(said.corrected.q_xyzw), state


def smooth_fault(time):
    return np.array([0.01, 0.015, 0.02]) * (1.0 - np.cos(np.array([1.0, 2.0, 1.5]) * time))


GAIN = st.floats(0.0, 1e3)
NUMBER = st.floats(-10.0, 10.0).map(
    lambda number: number if abs(number) > 1e-100 else 0.0
)  # squares do not vanish


@given(
    st.tuples(NUMBER, NUMBER, NUMBER).map(np.array),
    GAIN,
    st.floats(1e-3, 1e3),
    st.one_of(st.just(0.0), st.floats(1e-9, 1.0)),
    st.one_of(st.just(0.0), st.floats(1e-4, 1.0)),
)
def test_implicit_injection_solves_its_equation(c, linear, rho, delta, dt):
    e, v = implicit_injection(c, linear, rho, delta, dt)
    size = np.linalg.norm(e)
    scale = np.linalg.norm(c) + dt * (linear * size + rho)
    np.testing.assert_allclose(e, c - dt * (linear * e + v), atol=1e-12 * scale)
    assert np.linalg.norm(v) <= rho * (1.0 + 1e-12)
    if size + delta > 0.0:
        np.testing.assert_allclose(v, rho * e / (size + delta), rtol=1e-12, atol=1e-300)


def test_implicit_injection_holds_the_error_at_zero_within_its_reach():
    e, v = implicit_injection(np.array([0.003, 0.0, -0.004]), 2.0, 2.0, 0.0, 0.004)
    assert e.tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(v, [0.75, 0.0, -1.0], rtol=1e-14)


@pytest.mark.parametrize(("size_deg", "rate"), [(0.5, 125), (5.0, 1000)])
def test_step_fault_is_estimated_within_a_twentieth_of_a_degree_after_a_fifth_of_a_second(rate, size_deg):
    step = np.radians(size_deg) * np.array([1.0, -1.0, 0.7])
    times, estimates, _, _ = flown(SlidingMode(vehicle=VEHICLE), 4.0, lambda t: step * (t >= 1.0), rate)
    error = np.degrees(np.abs(estimates - step * (times[:, None] >= 1.0)))
    assert np.max(error[times < 1.0]) < 0.01
    assert np.max(error[times >= 1.2]) < 0.05


def test_attitude_is_corrected_under_a_step_fault():
    times, _, corrected, _ = flown(SlidingMode(vehicle=VEHICLE), 3.0, lambda t: np.full(3, 0.05) * (t >= 1.0))
    true = np.array([motion(time)[0] for time in times])
    assert np.degrees(np.max(np.abs(corrected - true))) < 0.05


def test_fault_is_held_while_the_attitude_is_absent():
    step = np.array([0.05, -0.02, 0.03])
    times, estimates, _, _ = flown(
        SlidingMode(vehicle=VEHICLE), 4.0, lambda t: step * (t >= 1.0), absent=(2.0, 3.5)
    )
    held = estimates[(times >= 2.0) & (times < 3.5)]
    np.testing.assert_allclose(held, np.broadcast_to(step, held.shape), atol=np.radians(0.05))


def test_rate_observer_finds_the_disturbance_beside_the_torque():
    push, torque = 1.5, np.array([0.06, 0.0, 0.0])  # rad/s², within xi; N m
    acceleration = np.array([push, 0.0, 0.0]) + torque / VEHICLE.inertia
    observer = SlidingMode(vehicle=VEHICLE)
    *_, state = flown(
        observer, 0.2, lambda t: np.zeros(3), motion=lambda t: (np.zeros(3), acceleration * t), torque=torque
    )
    np.testing.assert_allclose(state.v1, [push, 0.0, 0.0], atol=1e-9)


def test_adaptive_gain_grows_as_equation_21():
    observer = SlidingMode(vehicle=VEHICLE, l_k2=1e6, L1=0.0)
    fault = np.array([0.03, 0.0, 0.0])
    *_, state = flown(observer, 2.0, lambda t: fault * (t > 0.0), motion=still)
    rho = observer.epsilon_s + observer.epsilon_2
    e3 = observer.delta * 0.03 / (rho - 0.03)  # where the injection balances the fault
    assert float(state.k2[0]) == pytest.approx(1e6 * e3**2 * 2.0, rel=0.05)


def test_no_vehicle_motion_gives_no_fault():
    times, estimates, _, _ = flown(SlidingMode(vehicle=VEHICLE), 10.0, lambda t: np.zeros(3))
    assert np.degrees(np.max(np.abs(estimates))) < 0.01
    assert len(times) == 2501


def test_kinematics_of_another_name_are_refused():
    with pytest.raises(ValueError, match="kinematics = 'large_angle': expected one of full, small_angle"):
        SlidingMode(vehicle=VEHICLE, kinematics="large_angle")
