"""How likely modes are beside each other, and which of them is believed."""

import numpy as np
import pytest

from quadftc_fdi.bank import decide, hypotheses, inference, modes, trust
from quadftc_fdi.bank.decide import Probabilities
from quadftc_fdi.bank.hypotheses import OF_GYRO, Bank
from quadftc_fdi.bank.motion import BETA, THETA, start_motion
from quadftc_fdi.bank.noise import noise_of, start_learning
from quadftc_model.rotations import euler_from_quaternion

NONE, EACH = np.zeros(3), np.ones(3, bool)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
X, Y = 0, 1
SHOWN, KNOWN = 1e3, 1e4  # of a step of the gyro: log-likelihoods of 50


def shown(*explained: tuple[int, int]) -> Bank:
    """Return a bank that has seen a gyro step; pairs are axes of a mode and of what it explains."""
    bank = hypotheses.start_bank(NONE)
    worth = bank.age[modes.EFFECT] + hypotheses.LOWEST
    bank = hypotheses.open_slots(bank, worth, EACH & False, np.True_, 1.0)
    J, d = np.zeros_like(bank.J), np.zeros_like(bank.d)
    for axis, seen_on in explained:
        J[OF_GYRO, seen_on, 3 * modes.GYRO + axis] = KNOWN
        d[OF_GYRO, seen_on, 3 * modes.GYRO + axis] = SHOWN
    return bank._replace(J=J, d=d)


def weighed(bank: Bank) -> Probabilities:
    driven, failing = np.ones(1, bool)[0], EACH & False
    return decide.probabilities(bank, inference.believe(bank, EACH, EACH, driven, failing, 0.0))


def of_gyro(of_modes: np.ndarray, axis: int) -> float:
    return of_modes[(modes.NAME == modes.GYRO) & (axis == modes.AXIS)].sum()


def test_what_two_axes_show_is_two_faults_and_neither_waits_for_the_other() -> None:
    both = weighed(shown((X, X), (Y, Y)))
    one = weighed(shown((X, X)))
    for axis in (X, Y):
        assert of_gyro(both.of_modes, axis) == pytest.approx(1.0, abs=1e-6)
        assert of_gyro(both.alone, axis) == pytest.approx(0.5, abs=1e-6)
    own = np.flatnonzero((modes.NAME == modes.GYRO) & (modes.AXIS == X))
    assert both.left[own] == pytest.approx(one.left[own], rel=1e-6)


def test_what_one_axis_shows_is_one_fault_of_which_two_axes_are_suspect() -> None:
    either = weighed(shown((X, X), (Y, X)))
    for axis in (X, Y):
        assert of_gyro(either.of_modes, axis) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("alike", [1, 4])
def test_onsets_that_are_alike_are_believed_once(alike: int) -> None:
    """They are where a fault has shown since evidence was dropped, and they have led to the same motion."""
    bank, mode, size = hypotheses.start_bank(NONE), 3 * modes.LATE, 0.1
    U = bank.U.copy()
    U[THETA, X, mode], U[BETA, X, mode] = 0.2, 0.3
    bank = bank._replace(U=U, age=bank.age * 0.0 + 2.0)
    weight = np.full((modes.MODES, len(hypotheses.RING)), hypotheses.LOWEST)
    weight[mode, :alike] = 50.0
    b, covariance = np.zeros((2, *weight.shape)), np.zeros((3, *weight.shape))
    b[0, mode] = size
    posterior = inference.Posterior(weight, b, covariance, NONE, NONE + 1.0)
    before = start_motion(LEVEL, NONE, noise_of(start_learning(LEVEL, NONE), np.True_, 0.0))
    named, added = np.arange(modes.MODES) == mode, np.zeros((3, modes.EFFECTS))
    believed, _, age = trust.take_over(before, bank, posterior, named, added, EACH & False, np.True_)
    assert euler_from_quaternion(believed.q_xyzw)[X] == pytest.approx(0.2 * size)
    assert believed.bias[X] == pytest.approx(0.3 * size)
    assert age == pytest.approx(2.0)
