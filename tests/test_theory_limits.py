"""The limits of docs/theory.md: of any estimator on a MEMS IMU, and of the paper's observer on it."""

import math

import numpy as np
import pytest
from in_c import Shown, fly_arrays

from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_flight.closed_loop import fly
from quadftc_flight.scenario import find_scenario, load_scenario, with_duration
from quadftc_model.arrays import rows_of
from quadftc_model.samples import FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_sim.sensors import GRADES

DT = 0.004  # s
NOISE = math.degrees(GRADES["mems"]["attitude_noise"])  # deg
WALK = math.degrees(GRADES["mems"]["gyro_noise"])  # deg/sqrt(s), angle random walk N
TURN_ON = math.degrees(GRADES["mems"]["gyro_bias"])  # deg/s, uniform within +-
HEALTHY = 20.0  # s before the fault
MEMORY = NOISE * math.sqrt(DT) / WALK  # s: tau_f, memory of the best filter of angle and noise


def best_covariance(duration, fault):
    """Covariance of angle, bias and ramp rate [deg, s] at the end of a fault by the optimal (Kalman) filter.

    The onset is known. ``arbitrary``: the attitude tells nothing during the fault; ``ramp``: the fault is a
    ramp of unknown rate. Returns the last covariance and the angle's variance over the fault (n,).
    """
    P = np.diag([NOISE**2, TURN_ON**2 / 3.0, 1e4])
    A = np.array([[1.0, -DT, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    Q = np.diag([WALK**2 * DT, 0.0, 0.0])
    variances = []
    for index in range(1, round((HEALTHY + duration) / DT) + 1):
        P = A @ P @ A.T + Q
        since_onset = index * DT - HEALTHY
        if since_onset <= 0.0 or fault == "ramp":
            H = np.array([1.0, 0.0, max(since_onset, 0.0)])
            P = P - np.outer(P @ H, H @ P) / (H @ P @ H + NOISE**2)
        if since_onset > 0.0:
            variances.append(P[0, 0])
    return P, np.array(variances)


def test_floor_of_the_attitude_error_is_that_of_the_optimal_filter():
    duration = 20.0
    _, variances = best_covariance(duration, "arbitrary")
    at_onset = WALK * NOISE * math.sqrt(DT) * (1.0 + duration / HEALTHY)
    bias = WALK**2 / HEALTHY * (1.0 + 2.0 * MEMORY / HEALTHY) * duration**2 / 3.0
    floor = math.sqrt(at_onset + bias + WALK**2 * duration / 2.0)  # (T17)
    assert floor == pytest.approx(math.sqrt(np.mean(variances)), rel=0.01)
    assert floor == pytest.approx(0.031, abs=0.0005)  # deg


@pytest.mark.parametrize(("duration", "smallest"), [(5.0, 0.0225), (20.0, 0.0130), (40.0, 0.0112)])
def test_smallest_ramp_is_that_of_the_optimal_filter(duration, smallest):
    P, _ = best_covariance(duration, "ramp")
    variance = sum(WALK**2 / time * (1.0 + 2.0 * MEMORY / time) for time in (HEALTHY, duration))  # (T18)
    assert math.sqrt(variance) == pytest.approx(math.sqrt(P[2, 2]), rel=0.025)
    # missed once in a hundred, false once in a thousand: 2.33 + 3.29 standard deviations [deg/s]
    assert (2.326 + 3.291) * math.sqrt(variance) == pytest.approx(smallest, abs=1e-4)


def test_adaptive_gain_grows_without_end_under_noise():
    law = SlidingMode(vehicle=load_vehicle("qball_x4"), L1=0.0, kinematics="small_angle")
    sigma, shape = math.radians(NOISE), (5001, 3)
    vector = np.pad(
        0.5 * sigma * np.random.default_rng(4).standard_normal(shape), ((0, 0), (0, 1)), constant_values=1.0
    )
    there, zeros = np.ones(shape[0], bool), np.zeros(shape)
    q_xyzw = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    inputs = FaultObserverInputs(ImuSample(q_xyzw, zeros, zeros, there, there, there), zeros)
    begin = law.init(rows_of(inputs, 0))._replace(z2=np.zeros(3))
    _, states = fly_arrays(Shown(law), inputs, DT, begin)
    gains, injections = states.k2[:, 0], states.v2
    stiffness = (law.epsilon_s + law.epsilon_2) / law.delta
    passed = (DT * sigma) ** 2 / ((1.0 + DT * (law.L2 + stiffness)) ** 2 - 1.0)  # variance of e3 on an axis
    growth = law.l_k2 * law.H**2 * 3.0 * passed  # (T19)
    assert gains[-1] / (5000 * DT) == pytest.approx(growth, rel=0.03)
    assert gains[-1] / gains[2500] == pytest.approx(2.0, rel=0.03)  # it does not slow down
    assert np.std(injections) == pytest.approx(stiffness * math.sqrt(passed), rel=0.03)
    assert np.std(injections) / sigma == pytest.approx(0.74, abs=0.02)


def test_vehicle_follows_its_estimate_on_a_gyro_with_bias():
    scenario = with_duration(load_scenario(find_scenario("mems_faults")), 15.0)
    flight = fly(scenario, "proposed")
    late = flight.time > 13.0
    tracking = np.mean((flight.angles - flight.reference)[late], axis=0)
    estimate = np.mean((flight.fault_estimate - flight.fault)[late], axis=0)
    assert np.degrees(np.max(np.abs(estimate))) > 1.0  # it drifted
    np.testing.assert_allclose(np.degrees(tracking), np.degrees(estimate), atol=0.15)
