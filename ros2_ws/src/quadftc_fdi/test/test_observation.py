"""The law that runs a fault observer on received samples, on the test stand and in free flight."""

import jax
import numpy as np
import pytest

from quadftc_fdi.diagnosis import Diagnosis
from quadftc_fdi.fault_observer import fault_observers, is_usable_estimate
from quadftc_fdi.observation import Observation
from quadftc_model.rotors import wrench_from_speeds
from quadftc_model.samples import NO_PLACE, STARTING, RotorReading, level_sample
from quadftc_model.vehicle import load_vehicle

VEHICLE = load_vehicle("x500")
EVERY_CASE = pytest.mark.parametrize(
    ("name", "flies"), [(name, flies) for name in fault_observers.names() for flies in (False, True)]
)


def observation(name, flies=False):
    return Observation(fault_observers.get(name)(vehicle=VEHICLE), flies)


def test_commanded_speeds_become_torque_and_thrust_in_free_flight():
    law = observation("none", flies=True)
    command = np.array([500.0, 510.0, 490.0, 505.0])
    inputs = law.example()._replace(rotors=RotorReading(command, command, np.False_))
    seen = law.seen(inputs)
    torque, thrust = wrench_from_speeds(VEHICLE, command)
    np.testing.assert_array_equal(seen.torque, torque)
    assert seen.thrust == thrust
    assert seen.position is NO_PLACE
    assert seen.rotors is inputs.rotors


def test_what_cannot_be_used_of_a_sample_is_absent():
    law = observation("none")
    broken = level_sample()._replace(body_rate=np.array([np.nan, 0.0, 0.0]), q_xyzw=np.zeros(4))
    seen = law.seen(law.example()._replace(sample=broken)).imu
    assert (seen.rate_valid, seen.attitude_valid, seen.force_valid) == (False, False, True)
    assert np.all(np.isfinite(np.concatenate(seen[:3])))


@EVERY_CASE
def test_what_is_said_before_the_start_has_the_shape_of_an_estimate(name, flies):
    law = observation(name, flies)
    inputs = law.example()
    said = law.step(law.init(inputs), inputs, 0.0)[1]
    waiting = law.fallback(inputs, said)
    assert jax.tree.structure(said) == jax.tree.structure(waiting)
    for one, other in zip(jax.tree.leaves(said), jax.tree.leaves(waiting), strict=True):
        assert (np.shape(one), np.asarray(one).dtype) == (np.shape(other), np.asarray(other).dtype)
    assert waiting.state.tolist() == [STARTING] * 3
    assert (waiting.rotors is not None) == (flies and name in {"isolating", "bank"})


def test_observer_is_ready_at_a_sample_with_attitude_and_body_rate():
    law = observation("none")
    for changes, ready in (
        ({}, True),
        ({"rate_valid": np.False_}, False),
        ({"q_xyzw": np.zeros(4)}, False),
        ({"specific_force": np.full(3, np.nan)}, True),
    ):
        inputs = law.example()
        assert law.ready(inputs._replace(sample=inputs.sample._replace(**changes))) == ready


@EVERY_CASE
def test_estimate_with_a_number_that_is_none_is_unusable(name, flies):
    law = observation(name, flies)
    inputs = law.example()
    said = law.step(law.init(inputs), inputs, 0.0)[1]
    assert is_usable_estimate(said)
    assert not is_usable_estimate(said._replace(std_dev=np.array([0.0, np.nan, 0.0])))
    assert not is_usable_estimate(said._replace(fault=np.array([0.0, 1e7, 0.0])))
    if said.rotors is not None:
        weak = said.rotors._replace(effectiveness=np.array([1.0, np.inf, 1.0, 1.0]))
        assert not is_usable_estimate(said._replace(rotors=weak))


def test_usable_estimates_of_a_batch_are_told_one_by_one():
    law = observation("supervised")
    inputs = law.example()
    said = law.step(law.init(inputs), inputs, 0.0)[1]
    bad = said._replace(fault=np.full(3, np.nan))
    batch = jax.tree.map(lambda *rows: np.stack(rows), said, bad, said)
    assert is_usable_estimate(batch).tolist() == [True, False, True]


@pytest.mark.parametrize("flies", [False, True])
def test_diagnosis_restarts_at_the_sample_after_an_unusable_estimate(flies):
    diagnosis, starting = Diagnosis(fault_observers.get("isolating")(vehicle=VEHICLE), flies=flies), []
    speeds = np.full(4, VEHICLE.hover_speed)
    rotors = RotorReading(speeds, speeds, np.True_) if flies else None
    for index in range(30):
        torque = None if flies else np.full(3, np.nan if index == 20 else 0.0)
        sent = rotors._replace(command=speeds * np.nan) if flies and index == 20 else rotors
        estimate = diagnosis.diagnose(10**9 + 4_000_000 * index, level_sample(), torque, sent)
        assert is_usable_estimate(estimate)
        starting.append(diagnosis.state is None)
    assert diagnosis.replaced == 1
    assert np.flatnonzero(starting).tolist() == [20]
