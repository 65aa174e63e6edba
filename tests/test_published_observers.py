"""The fault observers of the literature, an example: found by their entry points, right on a step."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from in_c import fly_arrays
from law_contract import assert_step_is_traced

from quadftc_fdi.fault_observer import FaultObserver
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FAULTY, HEALTHY, FaultObserverInputs, ImuSample
from quadftc_model.vehicle import load_vehicle
from quadftc_theory.conditions import _judge

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "published_observers"
STEP = np.radians([3.0, -3.0, 2.0])


@pytest.fixture(params=["augmented_kalman", "edwards_spurgeon"])
def observer(request, monkeypatch) -> FaultObserver:
    from importlib.metadata import entry_points

    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    (entry,) = entry_points(group="quadftc.fault_observers", name=request.param)
    return entry.load()(vehicle=load_vehicle("qball_x4"))


def test_step_is_found_and_estimated_in_c(observer):
    time = np.arange(750) / 250
    angles = 0.1 * np.sin(time)[:, None] * [1.0, 0.0, 0.0]
    rates = 0.1 * np.cos(time)[:, None] * [1.0, 0.0, 0.0]
    fault, there = STEP * (time[:, None] >= 2.0), np.ones(len(time), np.bool_)
    imu = ImuSample(quaternion_from_euler(angles + fault), rates, np.zeros_like(rates), there, there, there)
    inputs = FaultObserverInputs(imu, np.zeros_like(rates))
    _, estimates = fly_arrays(observer, inputs, 1.0 / 250)
    assert np.all(estimates.state[250:500] == HEALTHY)
    assert np.all(estimates.state[550:] == FAULTY)
    assert np.max(np.abs(estimates.fault - fault)[550:]) < np.radians(0.05)
    off = euler_from_quaternion(estimates.corrected.q_xyzw[-1]) - angles[-1]
    assert np.max(np.abs(off)) < np.radians(0.05)
    one = ImuSample(*(each[0] for each in imu))
    assert_step_is_traced(observer, FaultObserverInputs(one, np.zeros(3)))


def test_check_has_conditions_for_it(observer):
    importlib.import_module("published_observers.conditions")
    assert _judge.dispatch(type(observer)).__module__ == "published_observers.conditions"
