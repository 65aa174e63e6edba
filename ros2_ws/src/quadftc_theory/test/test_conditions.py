"""The conditions of the observers: their numbers against independent ones, and what breaks them."""

import importlib.metadata
import math

import numpy as np
import pytest
from easy_circumstances import DT, QBALL, QUIET, TIME, circumstances, named

from quadftc_fdi.disturbance_observer import disturbance_observers
from quadftc_fdi.disturbance_observers.exosystem import Exosystem
from quadftc_fdi.fault_observer import fault_observers
from quadftc_fdi.fault_observers.sliding_mode import SlidingMode
from quadftc_model.rotations import euler_rates
from quadftc_theory.conditions import (
    Bound,
    Condition,
    Trace,
    Verdict,
    conditions_of,
    falls,
    judge,
    load_conditions,
)
from quadftc_theory.controller_conditions import estimation_error
from quadftc_theory.sliding_mode_conditions import (
    drift,
    kinematic_lipschitz,
    leak_time_constant,
    smallest_ramp,
)


@pytest.mark.parametrize("registry", [fault_observers, disturbance_observers], ids=["fault", "disturbance"])
def test_every_observer_says_where_its_theory_holds(registry):
    for name in registry.names():
        for item in judge(registry.get(name)(vehicle=QBALL), circumstances()):
            assert item.text, name
            assert not item.failed, (name, item)


class Borrowed(SlidingMode):
    """A law of somebody else."""


def test_a_law_without_conditions_says_so_and_one_of_another_package_brings_its_own(monkeypatch):
    (item,) = judge(object(), circumstances())
    assert (item.name, item.verdict, item.needed) == ("theory", Verdict.DEPENDS, False)
    assert "no conditions are registered for object" in item.text

    class Entry:
        def load(self):
            conditions_of(Borrowed)(lambda law, given: [Condition("theirs", Verdict.PASS, "holds")])

    inherited = judge(Borrowed(vehicle=QBALL), circumstances())
    assert len(inherited) == len(judge(SlidingMode(vehicle=QBALL), circumstances()))
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [Entry()])
    load_conditions.cache_clear()
    assert [item.name for item in judge(Borrowed(vehicle=QBALL), circumstances())] == ["theirs"]


@pytest.mark.parametrize(
    ("changes", "gains", "name"),
    [
        ({"fault": Bound(0.6, "rad", "given")}, {}, "(9), (19)"),
        ({"disturbance": QUIET + 4.0}, {}, "(18)"),
        ({"gyro_bias": Bound(0.01, "rad/s", "given")}, {}, "(12)"),
        ({"gyro_bias": Bound(0.01, "rad/s", "given")}, {}, "drift"),
        ({"faulty_channels": ("attitude", "gyro")}, {}, "(12)"),
        ({}, {"epsilon_1": 0.0}, "(28)"),
        ({}, {"epsilon_2": 0.0}, "(29)"),
        ({}, {"L1": 0.0}, "A-bar - L-bar C-bar"),
    ],
)
def test_a_condition_that_does_not_hold_fails_the_scheme(changes, gains, name):
    found = named(judge(SlidingMode(vehicle=QBALL, **gains), circumstances(**changes)), name)
    assert found.failed, found


def test_a_gyro_bias_eats_the_margin_of_29():
    observer = SlidingMode(vehicle=QBALL)
    bias = 0.011  # rad/s: 0.11 rad after 10 s, epsilon_2 is 0.1
    found = named(judge(observer, circumstances(gyro_bias=Bound(bias, "rad/s", "given"))), "(29)")
    assert found.numbers["state_error"] == pytest.approx(bias * 10.0, rel=1e-3)
    assert found.numbers["eta_2"] == pytest.approx(-0.01, rel=0.02)
    assert found.failed


def test_a_leak_that_eats_the_fault_is_reported():
    leaky = SlidingMode(vehicle=QBALL, L1=100.0)
    found = named(judge(leaky, circumstances()), "leak")
    assert found.verdict is Verdict.DEPENDS
    assert found.numbers["time_constant"] == pytest.approx((1.0 + 0.6 / 1e-3) / 100.0)


def test_a_large_fault_leaks_faster():
    """The table of docs/theory.md, section 4."""
    observer = SlidingMode(vehicle=QBALL)
    found = [leak_time_constant(observer, math.radians(size)) for size in (0.0, 0.1, 1.0, 5.0, 20.0)]
    np.testing.assert_allclose(found, [12020.0, 11985.0, 11672.0, 10282.0, 5097.0], rtol=0.01)


def test_the_smallest_ramp_is_that_of_the_limits():
    """The table of docs/theory.md, section 8: a ramp of 20 s after 20 healthy seconds on the mems grade."""
    mems = {
        "gyro_noise": Bound(math.radians(0.007), "rad/sqrt(s)", "given"),
        "attitude_noise": Bound(math.radians(0.1), "rad", "given"),
        "fault_length": Bound(20.0, "s", "given"),
    }
    assert math.degrees(smallest_ramp(circumstances(**mems))) == pytest.approx(0.0130, abs=5e-5)


def test_drift_is_bias_times_time_at_first_and_bias_times_time_constant_at_last():
    leaky = SlidingMode(vehicle=QBALL, L1=100.0)
    assert drift(leaky, 1e-3) == pytest.approx(1e-3, rel=1e-3)
    assert drift(leaky, 1e3) == pytest.approx(leak_time_constant(leaky))
    assert drift(SlidingMode(vehicle=QBALL, L1=0.0), 7.0) == 7.0


@pytest.mark.parametrize("tilt", [0.05, 0.5, 1.0])
def test_the_lipschitz_constant_bounds_the_kinematics_and_not_by_much(tilt):
    rng = np.random.default_rng(1)
    angles = np.stack(
        [rng.uniform(-tilt, tilt, 4000), rng.uniform(-tilt, tilt, 4000), np.zeros(4000)], axis=1
    )
    angles[::2, 1] = np.sign(angles[::2, 1]) * tilt  # the corner counts
    rates = rng.normal(size=(4000, 3))
    rates *= 0.7 / np.linalg.norm(rates, axis=1, keepdims=True)
    step = 1e-6
    columns = [
        (euler_rates(angles + step * axis, rates) - euler_rates(angles - step * axis, rates)) / (2.0 * step)
        for axis in np.eye(3)
    ]
    largest = np.linalg.norm(np.stack(columns, axis=-1), ord=2, axis=(1, 2)).max()
    bound = kinematic_lipschitz(tilt, 0.7)
    assert 0.6 * bound < largest <= bound * (1.0 + 1e-6)


def test_the_error_of_the_disturbance_estimate_decays_at_the_bandwidth():
    step = np.where(TIME[:, None] >= 1.0, [1.0, -2.0, 0.5], 0.0)
    error = estimation_error(Exosystem(vehicle=QBALL, bandwidth=8.0), step, QUIET, DT)
    np.testing.assert_allclose(error[TIME < 0.99], 0.0, atol=1e-12)
    late = error[TIME >= 1.5] / error[np.argmax(TIME >= 1.5)]
    np.testing.assert_allclose(late[:100], np.exp(-8.0 * (TIME[:100, None] * np.ones(3))), rtol=1e-6)


def test_the_poles_of_the_disturbance_observer_are_at_minus_its_bandwidth():
    for model, tolerance in (("constant", 1e-9), ("ramp", 1e-3), ("harmonic", 1e-3)):
        poles = Exosystem(vehicle=QBALL, model=model, bandwidth=12.0).poles(DT)
        np.testing.assert_allclose(poles, -12.0, rtol=tolerance)


@pytest.mark.parametrize(("model", "verdict"), [("harmonic", Verdict.PASS), ("constant", Verdict.DEPENDS)])
def test_assumption_5_passes_for_the_exosystem_that_makes_the_disturbance(model, verdict):
    observer = Exosystem(vehicle=QBALL, model=model, frequency=2.0)
    wave = np.sin(2.0 * TIME)[:, None] * np.ones(3)
    error = estimation_error(observer, wave, QUIET, DT)
    assert named(judge(observer, circumstances(wave, error)), "Assumption 5").verdict is verdict


STAMPS = (TIME * 1e9).round().astype(np.int64)


@pytest.mark.parametrize(
    ("rate", "verdict"), [(-2.0, Verdict.PASS), (-0.5, Verdict.FAIL), (1.0, Verdict.FAIL)]
)
def test_a_lyapunov_function_has_to_fall_as_fast_as_required(rate, verdict):
    V = np.exp(rate * TIME)
    found = falls("V", V, STAMPS, -1.0 * V, np.ones(len(V), np.bool_))
    assert found.verdict is verdict
    assert found.numbers["share_outside"] == 1.0


def test_inside_the_boundary_layer_nothing_has_to_fall():
    found = falls("V", TIME, STAMPS, -TIME, np.zeros(len(TIME), np.bool_))
    assert found.verdict is Verdict.PASS
    assert found.numbers == {"share_outside": 0.0, "share_holding": None}


def test_without_truth_nothing_is_claimed():
    unknown = np.full(len(TIME), math.nan)
    assert falls("V", unknown, STAMPS, unknown, np.ones(len(TIME), np.bool_)).verdict is Verdict.DEPENDS


def still_trace(fault, gyro_bias=0.0):
    """A vehicle that stands still and level for ten seconds."""
    zeros = np.zeros((len(TIME), 3))
    q = np.zeros((len(TIME), 4))
    q[:, 0], q[:, 3] = np.sin(0.5 * fault), np.cos(0.5 * fault)
    return Trace(
        stamp_ns=STAMPS,
        q_xyzw=q,
        gyro=np.tile([gyro_bias, 0.0, 0.0], (len(TIME), 1)),
        torque=zeros,
        angles=zeros,
        body_rate=zeros,
        sliding_variable=zeros,
        saturated=np.zeros((len(TIME), 3), np.bool_),
    )


def test_v2_stays_in_its_layer_under_a_small_fault_and_leaves_it_under_one_above_the_bound():
    observer = SlidingMode(vehicle=QBALL)
    for size, inside in ((0.05, True), (0.7, False)):
        trace = still_trace(np.where(TIME > 2.0, size, 0.0))
        found = named(judge(observer, circumstances(), trace), "(35): V2")
        assert (found.numbers["share_outside"] == 0.0) is inside
        # |e3| = delta f / (rho - f) where rho = epsilon_s + epsilon_2 is above f
        if inside:
            assert found.numbers["largest_e3"] == pytest.approx(1e-3 * size / (0.6 - size), rel=0.05)


def test_a_gyro_bias_shows_as_the_error_of_the_angle_along_the_run():
    observer = SlidingMode(vehicle=QBALL)
    found = named(judge(observer, circumstances(), still_trace(0.0 * TIME, 0.01)), "(35): V2")
    assert found.numbers["largest_z2_deg"] == pytest.approx(math.degrees(0.01 * TIME[-1]), rel=0.02)
