"""Theorem 2 and what any controller needs: when it passes, when it depends, when it fails."""

import dataclasses

import numpy as np
import pytest
from easy_circumstances import DT, QBALL, QUIET, TIME, circumstances, named

from quadftc_control.controller import controllers
from quadftc_control.controllers.indi import Indi
from quadftc_control.controllers.ismc import Ismc
from quadftc_control.controllers.smc import Smc
from quadftc_theory.conditions import Trace, Verdict, judge


def test_every_controller_holds_in_calm_air():
    for name in controllers.names():
        found = judge(controllers.get(name)(vehicle=QBALL), circumstances())
        assert found, name
        assert not any(item.failed for item in found), name


@pytest.mark.parametrize(
    ("rows", "verdict"),
    [(slice(0), Verdict.PASS), (slice(10, 20), Verdict.DEPENDS), (slice(None), Verdict.FAIL)],
)
def test_the_switching_gain_must_exceed_the_estimation_error(rows, verdict):
    error = QUIET.copy()
    error[rows, 1] = 2.5  # k_c3 is 2
    found = named(judge(Ismc(vehicle=QBALL), circumstances(error=error)), "Theorem 2")
    assert found.verdict is verdict
    assert found.numbers["time_short"] == pytest.approx(DT * len(error[rows]))
    assert found.numbers["eta"][0] == 2.0


def test_the_controller_without_observer_is_held_against_the_whole_disturbance():
    found = named(
        judge(Smc(vehicle=QBALL), circumstances(disturbance=QUIET + np.array([0.0, 0.0, 4.5]))),
        "Theorem 2",
    )
    assert found.verdict is Verdict.FAIL
    assert found.numbers["D_d"][2] == 4.5


def test_a_boundary_layer_too_thin_for_the_sampling_fails():
    found = named(judge(Ismc(vehicle=QBALL, phi=(0.1, 0.1, 0.0019)), circumstances()), "(41)")
    assert found.failed  # 1 / 0.0019 = 526 1/s, the limit at 250 Hz is 500


@pytest.mark.parametrize(
    ("size", "verdict"), [(1.0, Verdict.PASS), (38.5, Verdict.DEPENDS), (40.0, Verdict.FAIL)]
)
def test_authority_is_held_against_disturbance_reference_and_switching(size, verdict):
    # 1.2 N m / 0.03 kg m² = 40 rad/s², less 0.1 for the reference, less k_c3 = 2
    found = named(
        judge(Ismc(vehicle=QBALL), circumstances(disturbance=QUIET + np.array([size, 0.0, 0.0]))),
        "authority",
    )
    assert found.verdict is verdict


def test_a_surface_without_spring_is_not_stable():
    assert named(judge(Ismc(vehicle=QBALL, k_c1=(16.0, 0.0, 9.0)), circumstances()), "motion").failed


def trace(S):
    zeros = np.zeros((len(TIME), 3))
    return Trace(
        stamp_ns=(TIME * 1e9).round().astype(np.int64),
        q_xyzw=np.zeros((len(TIME), 4)),
        gyro=zeros,
        torque=zeros,
        angles=zeros,
        body_rate=zeros,
        sliding_variable=S,
        saturated=np.zeros((len(TIME), 3), np.bool_),
    )


@pytest.mark.parametrize(("slope", "verdict"), [(-2.0, Verdict.PASS), (-1.0, Verdict.FAIL)])
def test_s_has_to_come_back_at_eta_outside_its_layer(slope, verdict):
    error = QUIET + np.array([0.5, 0.0, 0.0])  # eta = 1.5 rad/s²
    S = QUIET.copy()
    S[:, 0] = np.maximum(3.0 + slope * TIME, 0.05)
    (found,) = judge(Ismc(vehicle=QBALL), circumstances(error=error), trace(S))
    assert found.verdict is verdict
    assert found.numbers["share_outside"] > 0.0


def test_inversion_with_gains_that_the_rotors_cannot_follow_fail():
    found = judge(Indi(vehicle=QBALL, k_angle=(16.0, 3.5, 2.5)), circumstances())
    assert named(found, "motion").verdict is Verdict.FAIL
    assert named(judge(Indi(vehicle=QBALL), circumstances()), "motion").verdict is Verdict.PASS


def test_inversion_sampled_slowly_fails():
    slow = dataclasses.replace(circumstances(), dt=0.04)
    assert named(judge(Indi(vehicle=QBALL), slow), "delay").verdict is Verdict.FAIL
    assert named(judge(Indi(vehicle=QBALL), circumstances()), "delay").verdict is Verdict.PASS
