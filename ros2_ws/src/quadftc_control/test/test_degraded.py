"""Missing inputs in real time: what is believed, what fades, and when it ends."""

import numpy as np
import pytest

from quadftc_control.degraded import InputMonitor, Mode, Patience

ESTIMATE = np.array([1.0, -2.0, 0.5])
SECOND = 1_000_000_000  # ns


@pytest.fixture
def monitor():
    return InputMonitor(
        Patience(corrected_samples=3, disturbance_age=0.05, disturbance_fade=0.5, hold=0.1, off=0.5)
    )


def test_raw_imu_is_used_from_so_many_samples_without_a_corrected_one_on(monitor):
    assert [monitor.use_raw() for _ in range(5)] == [False, False, True, True, True]


def test_corrected_imu_is_believed_again_as_soon_as_it_comes(monitor):
    for _ in range(5):
        monitor.use_raw()
    monitor.corrected()
    assert monitor.use_raw() is False


@pytest.mark.parametrize(
    ("age", "share", "fresh"),
    [(0.0, 1.0, True), (0.05, 1.0, True), (0.3, 0.5, False), (0.55, 0.0, False), (9.0, 0.0, False)],
)
def test_disturbance_estimate_fades_when_it_gets_old(monitor, age, share, fresh):
    monitor.estimated(SECOND, ESTIMATE)
    estimate, is_fresh = monitor.disturbance_at(SECOND + round(age * 1e9))
    np.testing.assert_allclose(estimate, share * ESTIMATE, atol=1e-12)
    assert is_fresh is fresh


@pytest.mark.parametrize(
    ("silence", "mode"),
    [
        (0.0, Mode.FULL),
        (0.099, Mode.FULL),
        (0.1, Mode.HOLD),
        (0.499, Mode.HOLD),
        (0.5, Mode.OFF),
        (9.0, Mode.OFF),
    ],
)
def test_silence_of_the_imu_ends_in_hold_and_then_off(monitor, silence, mode):
    assert monitor.silence(silence) is mode


def test_patience_that_gives_up_before_it_holds_is_refused():
    with pytest.raises(ValueError, match=r"off = 0.05 s: must not be less than hold = 0.1 s"):
        Patience(hold=0.1, off=0.05)
