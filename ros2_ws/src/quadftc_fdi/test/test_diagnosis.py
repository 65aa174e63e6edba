"""Diagnosis of a stream: when it starts, and what it does with samples that cannot be used."""

import numpy as np
import pytest

from quadftc_fdi.diagnosis import Diagnosis, describe_axes
from quadftc_fdi.fault_observer import fault_observers
from quadftc_model.rotations import euler_from_quaternion, quaternion_from_euler
from quadftc_model.samples import FAULTY, HEALTHY, STARTING, FaultEstimate, ImuSample
from quadftc_model.vehicle import load_vehicle

START, PERIOD = 1_000_000_000, 4_000_000  # ns
ANGLES = np.array([0.3, -0.2, 0.4])
TRUE, FALSE = np.bool_(True), np.bool_(False)
NO_TORQUE = np.zeros(3)


@pytest.fixture
def diagnosis():
    return Diagnosis(fault_observers.get("sliding_mode")(vehicle=load_vehicle("qball_x4")))


def sample(**changes):
    """A vehicle that hangs still at an angle."""
    force = np.array([0.0, 0.0, 9.8])
    return ImuSample(quaternion_from_euler(ANGLES), np.zeros(3), force, TRUE, TRUE, TRUE)._replace(**changes)


@pytest.mark.parametrize(
    "changes", [{"attitude_valid": FALSE}, {"rate_valid": FALSE}, {"q_xyzw": np.full(4, np.nan)}]
)
def test_start_waits_for_attitude_and_rate(diagnosis, changes):
    assert diagnosis.diagnose(START, sample(**changes), NO_TORQUE).state.tolist() == [STARTING] * 3
    assert diagnosis.diagnose(START + PERIOD, sample(), NO_TORQUE).state.tolist() == [HEALTHY] * 3


def test_start_without_attitude_leaves_no_fault_behind(diagnosis):
    diagnosis.diagnose(START, sample(attitude_valid=FALSE), NO_TORQUE)
    estimate = diagnosis.diagnose(START + PERIOD, sample(), NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-12)


@pytest.mark.parametrize("gap", [2_000_000_000, -2_000_000_000])
def test_start_after_a_gap_waits_for_attitude_too(diagnosis, gap):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    blind = diagnosis.diagnose(START + gap, sample(attitude_valid=FALSE), NO_TORQUE)
    assert blind.state.tolist() == [STARTING] * 3
    estimate = diagnosis.diagnose(START + gap + PERIOD, sample(), NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-12)


def test_sample_with_a_stamp_that_is_not_new_gives_none(diagnosis):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    assert diagnosis.diagnose(START, sample(), NO_TORQUE) is None
    assert diagnosis.diagnose(START - PERIOD, sample(), NO_TORQUE) is None


@pytest.mark.parametrize("channel", ["q_xyzw", "body_rate", "specific_force"])
def test_not_a_number_does_not_reach_the_corrected_sample(diagnosis, channel):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    broken = sample(**{channel: np.full_like(getattr(sample(), channel), np.nan)})
    estimate = diagnosis.diagnose(START + PERIOD, broken, NO_TORQUE)
    np.testing.assert_allclose(euler_from_quaternion(estimate.corrected.q_xyzw), ANGLES, atol=1e-9)
    for array in (estimate.fault, *estimate.corrected):
        assert np.all(np.isfinite(array))


def test_reset_starts_anew_at_the_next_sample(diagnosis):
    diagnosis.diagnose(START, sample(), NO_TORQUE)
    diagnosis.restart()
    turned = sample(q_xyzw=quaternion_from_euler(ANGLES + 0.5))
    np.testing.assert_allclose(diagnosis.diagnose(START + PERIOD, turned, NO_TORQUE).fault, 0.0, atol=1e-12)


def test_new_law_goes_on_with_the_state_of_the_old(diagnosis):
    for index in range(100):
        diagnosis.diagnose(START + index * PERIOD, sample(), NO_TORQUE)
    diagnosis.law = fault_observers.get("sliding_mode")(vehicle=load_vehicle("qball_x4"), epsilon_s=0.7)
    turned = sample(q_xyzw=quaternion_from_euler(ANGLES + 0.01))
    for index in range(100, 150):
        estimate = diagnosis.diagnose(START + index * PERIOD, turned, NO_TORQUE)
    np.testing.assert_allclose(estimate.fault, 0.01, atol=1e-4)


def test_axes_are_described_without_what_is_not_known():
    estimate = FaultEstimate(
        fault=np.array([np.radians(1.5), -1e-9, 0.0]),
        std_dev=np.array([np.radians(0.1), -1.0, -1.0]),
        state=np.array([FAULTY, HEALTHY, STARTING], np.uint8),
        onset_age=np.array([2.5, -1.0, -1.0]),
        corrected=sample(),
    )
    assert list(describe_axes(estimate)) == [
        ("roll", FAULTY, {"size_deg": "1.500", "sigma_deg": "0.100", "age_s": "2.50"}),
        ("pitch", HEALTHY, {"size_deg": "0.000"}),
        ("yaw", STARTING, {"size_deg": "0.000"}),
    ]
