"""Ranks, zeros and what is said of them, on systems whose answers are known."""

import numpy as np
import pytest

from quadftc_theory.conditions import Verdict
from quadftc_theory.linear_model import (
    AffineModel,
    attitude_model,
    invariant_zeros,
    stable,
    structure_conditions,
    unobservable_modes,
    zero_directions,
)


def companion(numerator, denominator):
    """(A, B, C) of a transfer function with a monic denominator."""
    n = len(denominator) - 1
    A = np.vstack([np.hstack([np.zeros((n - 1, 1)), np.eye(n - 1)]), -np.array(denominator[:0:-1])])
    C = np.zeros((1, n))
    C[0, : len(numerator)] = numerator[::-1]
    return A, np.eye(n)[:, -1:], C


@pytest.mark.parametrize("zeros", [[2.0], [-3.0, 0.5], [0.0, 0.0], [-1.0 + 2.0j, -1.0 - 2.0j]])
def test_invariant_zeros_are_the_roots_of_the_numerator(zeros):
    system = companion(np.real(np.poly(zeros)), np.poly([-4.0, -5.0, -6.0, -7.0]))
    found, normal_rank = invariant_zeros(*system)
    by_place = sorted(found, key=lambda s: (round(s.real, 3), s.imag))
    np.testing.assert_allclose(by_place, np.sort_complex(np.array(zeros, complex)), atol=1e-6)
    assert normal_rank == 1


def test_a_system_that_is_not_square_has_the_zeros_common_to_its_outputs():
    A, B, C = companion([1.0, -1.0], np.poly([-4.0, -5.0, -6.0]))  # zero at 1
    both = np.vstack([C, C @ A])  # the derivative has it, too
    np.testing.assert_allclose(invariant_zeros(A, B, both)[0], [1.0], atol=1e-9)
    assert len(invariant_zeros(A, B, np.vstack([C, [1.0, 0.0, 0.0]]))[0]) == 0


def test_a_zero_direction_leaves_no_trace_in_the_output():
    A, B, C = companion([1.0, 2.0], np.poly([-4.0, -5.0]))
    assert zero_directions(A, B, C, -2.0).shape == (1, 1)
    assert zero_directions(A, B, C, -1.0).shape == (0, 1)


def test_the_modes_that_the_output_does_not_see_are_found():
    A = np.diag([-1.0, -2.0, 3.0])
    np.testing.assert_allclose(unobservable_modes(A, np.array([[1.0, 1.0, 0.0]])), [3.0])
    assert not stable(A)
    assert stable(A[:2, :2])
    assert not stable(np.zeros((1, 1)))


def verdicts(model):
    return {item.name.split(":")[0]: item.verdict for item in structure_conditions(model)}


def test_with_the_imu_the_ranks_hold_and_the_zeros_depend():
    found = verdicts(attitude_model())
    assert found.pop("invariant zeros of (A-bar, F-bar, C-bar)") is Verdict.DEPENDS
    assert found.pop("(34)") is Verdict.DEPENDS
    assert set(found.values()) == {Verdict.PASS}
    assert len(found) == 4


def test_the_papers_own_output_fails_assumption_1_the_count_and_the_lemma():
    found = structure_conditions(attitude_model("angles"))
    assert [item.verdict for item in found] == [Verdict.FAIL] * 3
    assert "infeasible" in found[-1].text
    assert all(item.failed for item in found)


def decaying_angle(rate):
    """One disturbed, measured state; one other whose error decays at ``rate``, with a fault on its sensor."""
    return AffineModel(
        A=np.array([[0.0, 0.0], [1.0, -rate]]),
        W=np.array([[1.0], [0.0]]),
        C=np.eye(2),
        F=np.array([[0.0], [1.0]]),
        fault_names=("b",),
    )


@pytest.mark.parametrize(("rate", "verdict"), [(2.0, Verdict.PASS), (-2.0, Verdict.FAIL)])
def test_a_zero_passes_where_hidden_faults_die_out_and_fails_where_they_grow(rate, verdict):
    found = structure_conditions(decaying_angle(rate))
    zeros = next(item for item in found if item.name.startswith("invariant zeros"))
    matching = next(item for item in found if item.name.startswith("(34)"))
    assert zeros.verdict is matching.verdict is verdict
    np.testing.assert_allclose(zeros.numbers["zeros"], [[-rate, 0.0]], atol=1e-12)


def test_the_papers_lyapunov_matrix_does_not_exist():
    """(34) by hand: F-bar' P = F0 C-bar makes P block diagonal, and V2' is then at best semi-definite."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        L1, L2, p1, p2 = rng.uniform(0.01, 10.0, 4)
        closed = np.array([[0.0, -L1], [1.0, -L2]])
        P = np.diag([p1, p2])
        assert np.linalg.eigvalsh(closed.T @ P + P @ closed).max() >= -1e-12
