"""Missing inputs in real time: what is believed, what fades, and when it ends."""

import numpy as np
import pytest

from quadftc_control.input_monitor import HeldTorque, InputMonitor, Mode, Patience

ESTIMATE = np.array([1.0, -2.0, 0.5])
SECOND = 1_000_000_000  # ns


PERIOD = 4_000_000  # ns


@pytest.fixture
def monitor():
    return InputMonitor(
        Patience(
            corrected_samples=3,
            return_samples=4,
            starting=0.1,
            disturbance_age=0.05,
            disturbance_fade=0.5,
            blend=0.2,
            hold=0.1,
            off=0.5,
        )
    )


def lost(monitor, until=5):
    """So many samples of imu/data alone."""
    return [monitor.use_raw(SECOND + k * PERIOD) for k in range(until)]


def pairs(monitor, first, count, starting=False):
    """So many samples of both; whether imu/corrected is used."""
    stamps = [SECOND + k * PERIOD for k in range(first, first + count)]
    return [(monitor.use_raw(stamp), monitor.use_corrected(stamp, starting))[1] for stamp in stamps]


def test_raw_imu_is_used_from_so_many_samples_without_a_corrected_one_on(monitor):
    assert lost(monitor) == [False, False, True, True, True]


def test_corrected_imu_is_believed_again_after_so_many_samples_in_a_row(monitor):
    lost(monitor)
    assert pairs(monitor, 5, 2) == [False, False]
    lost(monitor, 3)
    assert pairs(monitor, 10, 5) == [False, False, False, True, True]
    assert not monitor.undiagnosed


def test_single_corrected_samples_do_not_make_the_mode_flap(monitor):
    lost(monitor)
    used = []
    for k in range(5, 200, 4):  # one in four
        used += pairs(monitor, k, 1)
        used += [not monitor.use_raw(SECOND + (k + j) * PERIOD) for j in range(1, 4)]
    assert not any(used)


def test_corrected_imu_that_comes_late_does_not_count(monitor):
    for k in range(30):
        monitor.use_raw(SECOND + k * PERIOD)
        assert not monitor.is_late(SECOND + (k - 12) * PERIOD)  # 48 ms
        assert monitor.is_late(SECOND + (k - 13) * PERIOD)
        assert not monitor.use_corrected(SECOND + (k - 13) * PERIOD, starting=False)
    assert monitor.undiagnosed


def test_one_sample_behind_is_not_late(monitor):
    for k in range(1, 10):
        assert not monitor.use_raw(SECOND + k * PERIOD)
        assert monitor.use_corrected(SECOND + (k - 1) * PERIOD, starting=False)


def test_observer_that_starts_is_waited_for_but_not_for_ever(monitor):
    lost(monitor)
    used = pairs(monitor, 5, 40, starting=True)
    assert used.index(True) == 26  # the first after 0.1 s


def test_disturbance_estimate_fades_when_it_gets_old_and_comes_back_gradually(monitor):
    monitor.estimate = SECOND, ESTIMATE
    shares = {}
    for k in range(0, 1000, 4):  # ms
        stamp = SECOND + k * 1_000_000
        if k >= 600:
            monitor.estimate = stamp, ESTIMATE
        estimate, share, trusted = monitor.disturbance_at(stamp)
        np.testing.assert_allclose(estimate, share * ESTIMATE, atol=1e-12)
        shares[k] = share, trusted
    assert shares[0] == (1.0, True)  # the first is used at once
    assert shares[48] == (1.0, True)
    assert shares[300] == (pytest.approx(0.5, abs=0.01), False)
    assert shares[596] == (0.0, False)
    assert shares[608] == (0.0, False)  # not yet
    assert shares[612][1]
    assert shares[712] == (pytest.approx(0.5, abs=0.03), True)
    assert shares[996] == (1.0, True)
    changes = np.diff([share for share, _ in shares.values()])
    assert np.max(np.abs(changes)) <= 0.004 / 0.2 * 1.001


def test_estimate_that_never_came_is_zero_and_not_trusted(monitor):
    estimate, share, trusted = monitor.disturbance_at(SECOND)
    assert (estimate.tolist(), share, trusted) == ([0.0] * 3, 0.0, False)


def test_off_ends_with_so_many_samples_in_a_row(monitor):
    assert monitor.silence(9.0) is Mode.OFF
    flicker = [monitor.is_back(SECOND + k * SECOND // 5) for k in range(10)]  # one every 0.2 s
    assert not any(flicker)
    assert [monitor.is_back(9 * SECOND + k * PERIOD) for k in range(4)] == [False, False, False, True]


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


def test_torque_that_is_held_is_that_of_the_last_samples_without_their_noise():
    held, noise = HeldTorque(), np.random.default_rng(4)
    assert not held.mean.any()
    for k in range(500):
        held.add(1 + k * PERIOD, np.array([3.0, 0.0, 0.0]))
    for k in range(500, 1000):
        held.add(1 + k * PERIOD, np.array([1.0, -2.0, 0.5]) + noise.standard_normal(3))
    np.testing.assert_allclose(held.mean, [1.0, -2.0, 0.5], atol=0.5)
    after_gap = np.array([0.0, 7.0, 0.0])
    held.add(1 + 2000 * PERIOD, after_gap)
    np.testing.assert_allclose(held.mean, after_gap, atol=1e-12)
