"""The disturbance observer against its theory: poles, exosystems followed to rounding, gaps."""

import dataclasses
import math

import numpy as np
import pytest
from sampling import sampled

from quadftc_fdi.disturbance_observer import DisturbanceEstimation
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_model.samples import DisturbanceObserverInputs, level_sample
from quadftc_model.vehicle import load_vehicle

QBALL = load_vehicle("qball_x4")
# without gyroscopic coupling the body rate is the integral of the disturbance, known in closed form
SPHERE = dataclasses.replace(QBALL, inertia=np.full(3, 0.03))
SIZE = np.array([1.0, -2.0, 0.5])
TORQUE = np.array([0.03, 0.02, -0.01])
FREQUENCY = 2.0
RATES = [125, 250, 500, 1000]


def constant(time):
    """Disturbance [rad/s²] and its integral."""
    return SIZE, SIZE * time


def ramp(time):
    return SIZE * (1.0 + 0.7 * time), SIZE * (time + 0.35 * time**2)


def harmonic(time):
    angle = FREQUENCY * time + np.array([0.3, 1.0, 2.0])
    return SIZE * np.sin(angle), -SIZE / FREQUENCY * np.cos(angle)


def both(time):
    first, second = constant(time), harmonic(time)
    return first[0] + second[0], first[1] + second[1]


EXOSYSTEMS = {"constant": constant, "ramp": ramp, "harmonic": harmonic, "constant+harmonic": both}


def flown(observer, disturbance, duration, rate, missing=()):
    """Times (n,), estimates (n, 3) and true disturbances (n, 3) under a constant torque."""
    times = np.arange(round(duration * rate) + 1) / rate
    state, estimates = None, []
    for index, time in enumerate(times):
        body_rate = disturbance(time)[1] + TORQUE / observer.vehicle.inertia * time
        inputs = DisturbanceObserverInputs(body_rate, np.bool_(index not in missing), TORQUE)
        state = observer.init(inputs) if state is None else state
        state, estimate = observer.step(state, inputs, 1.0 / rate if index else 0.0)
        estimates.append(estimate)
    return times, np.array(estimates), np.array([disturbance(time)[0] for time in times])


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("bandwidth", [2.0, 10.0, 40.0])
def test_error_under_a_constant_disturbance_decays_with_the_pole_lambda(rate, bandwidth):
    observer = Exosystem(vehicle=SPHERE, bandwidth=bandwidth)
    times, estimates, true = flown(observer, constant, 3.0 / bandwidth, rate)
    slope = np.polyfit(times, np.log(np.abs(estimates - true)), 1)[0]
    np.testing.assert_allclose(-slope, bandwidth, rtol=0.01)  # (44): d_e' = -lambda d_e


@pytest.mark.parametrize(("rate", "frequency"), [(125, 0.5), (1000, 10.0)])
def test_constant_exosystem_sees_a_sine_through_a_first_order_lag(rate, frequency):
    def sine(time):
        return SIZE * np.sin(frequency * time), -SIZE / frequency * np.cos(frequency * time)

    period = 2.0 * math.pi / frequency
    times, estimates, _ = flown(Exosystem(vehicle=SPHERE, bandwidth=10.0), sine, 2.0 + period, rate)
    last = times > times[-1] - period
    basis = np.column_stack([np.sin(frequency * times[last]), np.cos(frequency * times[last])])
    in_phase, across = np.linalg.lstsq(basis, estimates[last], rcond=None)[0] / SIZE
    expected = 1.0 / (1.0 + 1j * frequency / 10.0)  # (T16): lambda / (lambda + s)
    np.testing.assert_allclose(in_phase + 1j * across, expected, rtol=0.001)


@pytest.mark.parametrize(("rate", "model"), sampled(RATES, EXOSYSTEMS, every=5))
def test_disturbance_of_the_exosystem_is_followed_to_rounding(rate, model):
    observer = Exosystem(vehicle=SPHERE, model=model, bandwidth=10.0, frequency=FREQUENCY)
    times, estimates, true = flown(observer, EXOSYSTEMS[model], 6.0, rate)
    settled = times > 5.0
    np.testing.assert_allclose(estimates[settled], true[settled], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "size"), [("constant", 1), ("ramp", 2), ("harmonic", 2), ("constant+harmonic", 3)]
)
def test_error_of_every_exosystem_decays_with_all_poles_at_the_bandwidth(model, size):
    observer = Exosystem(vehicle=SPHERE, model=model, bandwidth=10.0, frequency=FREQUENCY)
    times, estimates, true = flown(observer, EXOSYSTEMS[model], 1.0, 250)
    # n equal poles: the error is exp(-bandwidth t) times a polynomial of degree n - 1
    scaled = (estimates - true) * np.exp(10.0 * times)[:, None]
    polynomial = np.vander(times, size)
    fitted = polynomial @ np.linalg.lstsq(polynomial, scaled, rcond=None)[0]
    np.testing.assert_allclose(fitted, scaled, rtol=0.0, atol=1e-6 * np.max(np.abs(scaled)))


def test_gyroscopic_coupling_is_no_disturbance():
    # free rotation of an axisymmetric body: p, q turn at a constant rate, r stays
    inertia, spin = QBALL.inertia, 2.0
    precession = (inertia[2] - inertia[0]) / inertia[0] * spin
    observer = Exosystem(vehicle=QBALL, bandwidth=10.0)
    state, estimates = None, []
    for index in range(500):
        angle = precession * 0.004 * index
        body_rate = np.array([math.cos(angle), math.sin(angle), spin])
        inputs = DisturbanceObserverInputs(body_rate, np.bool_(True), np.zeros(3))
        state = observer.init(inputs) if state is None else state
        state, estimate = observer.step(state, inputs, 0.004 if index else 0.0)
        estimates.append(estimate)
    assert np.max(np.abs(estimates)) < 1e-5


@pytest.mark.parametrize("model", EXOSYSTEMS)
def test_disturbance_is_carried_on_while_the_rate_is_absent(model):
    observer = Exosystem(vehicle=SPHERE, model=model, bandwidth=10.0, frequency=FREQUENCY)
    gap = range(1000, 1100)
    _, estimates, true = flown(observer, EXOSYSTEMS[model], 4.6, 250, missing=gap)
    np.testing.assert_allclose(estimates[1000:], true[1000:], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("model", EXOSYSTEMS)
def test_fast_observer_at_a_slow_rate_is_stable(model):
    observer = Exosystem(vehicle=SPHERE, model=model, bandwidth=1000.0, frequency=FREQUENCY)
    _, estimates, true = flown(observer, EXOSYSTEMS[model], 1.0, 125)
    np.testing.assert_allclose(estimates[-1], true[-1], rtol=0.0, atol=1e-8)


def test_model_changed_in_flight_takes_over_from_the_estimate():
    times, estimates = np.arange(1000) / 250, []
    estimation = DisturbanceEstimation(Exosystem(vehicle=SPHERE))
    for index, time in enumerate(times):
        if index == 500:
            estimation.switch(Exosystem(vehicle=SPHERE, model="ramp"))
        sample = level_sample()._replace(body_rate=ramp(time)[1])
        estimates.append(estimation.estimate(10**9 + 4_000_000 * index, sample, np.zeros(3)))
    np.testing.assert_allclose(estimates[-1], ramp(times[-1])[0], atol=1e-6)
    np.testing.assert_allclose(estimates[500], estimates[499], atol=0.02)


def test_exosystem_of_another_name_is_refused():
    with pytest.raises(ValueError, match="model = 'noise': expected one of constant, ramp"):
        Exosystem(vehicle=QBALL, model="noise")
