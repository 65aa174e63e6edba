"""What the baseline fault observers say of their limits."""

import dataclasses
import math

import numpy as np
import pytest

from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.conditions import Bound, Circumstances, Series, Verdict, judge

DEG = math.pi / 180.0
QBALL = load_vehicle("qball_x4")


def given(value, unit):
    return Bound(value, unit, "given")


MEMS = Circumstances(
    vehicle=QBALL,
    dt=0.004,
    duration=80.0,
    faulty_channels=("attitude",),
    tilt=given(0.2, "rad"),
    body_rate=given(0.2, "rad/s"),
    acceleration=given((0.1, 0.1, 0.1), "rad/s^2"),
    fault=given(5.0 * DEG, "rad"),
    fault_growth=given(0.05 * DEG, "rad/s"),
    fault_length=given(20.0, "s"),
    gyro_bias=given(1.0 * DEG, "rad/s"),
    gyro_noise=given(0.007 * DEG, "rad/sqrt(s)"),
    attitude_noise=given(0.1 * DEG, "rad"),
    disturbance=Series(np.zeros((2, 3)), "rad/s^2", "given"),
    disturbance_error=Series(np.zeros((2, 3)), "rad/s^2", "given"),
)


@pytest.mark.parametrize(
    ("name", "condition", "changes", "verdict"),
    [
        ("threshold", "faults above", {}, Verdict.FAIL),
        (
            "threshold",
            "faults above",
            {"fault": given(0.4, "rad"), "fault_growth": given(0.3, "rad/s")},
            "PASS",
        ),
        ("threshold", "gyro bias below", {"gyro_bias": given(8.0 * DEG, "rad/s")}, Verdict.FAIL),
        ("threshold", "recovery within", {}, Verdict.FAIL),
        ("threshold", "recovery within", {"gyro_bias": given(0.05 * DEG, "rad/s")}, Verdict.PASS),
    ],
)
def test_limits_are_judged(name, condition, changes, verdict):
    observer = fault_observers.get(name)(vehicle=QBALL)
    found = judge(observer, dataclasses.replace(MEMS, **changes))
    assert next(item for item in found if item.name.startswith(condition)).verdict == verdict
