"""Zeros of systems with as many outputs as inputs, more and fewer: A, B and C, rows parted by semicolons."""

import numpy as np
import pytest

from quadftc_theory.invariant_zeros import invariant_zeros

# Random integers of -2 to 2, half of them zero. Ranks and zeros [rad/s] are from AB08ND of slycot 0.7.1.
BY_SLICOT = (
    ("0 0 0 -1; 0 -2 0 -2; 0 0 1 2; 0 1 0 0", "0; 0; 0; 0", "2 0 0 -1", 0, [1.0]),
    (
        "2 0 0 0 0; -2 -2 -2 -2 0; 0 0 0 0 0; 0 0 0 0 2; 0 0 1 -2 0",
        "2 -2; 0 0; 0 1; 0 0; -1 0",
        "0 -2 -2 1 -1; 0 -2 0 0 0",
        2,
        [0.33333333 + 2.80871659j, 0.33333333 - 2.80871659j],
    ),
    (
        "0 0 1 2 -2; -2 2 0 -1 -1; 0 0 0 0 -1; 0 0 0 -2 0; 0 0 0 0 0",
        "-1 0; 0 0; 0 0; 0 0; 0 -1",
        "0 0 0 0 0; 0 -2 0 0 0; 2 2 0 -1 0",
        2,
        [-2.0, 0.0],
    ),
    (
        "0 2 0 2 0 0; 0 0 2 0 0 -1; 0 0 0 -2 -2 -2; 0 2 -2 0 1 0; -1 0 0 0 0 2; 1 0 -2 0 1 0",
        "0 -1 0; 0 -1 0; 1 -1 0; 1 0 0; 0 0 0; 0 2 0",
        "0 2 2 0 0 0; 1 0 1 0 1 -1",
        2,
        [-0.52830942, 0.23976324 + 1.200894j, 0.23976324 - 1.200894j, 5.04878293],
    ),
    (
        "0 0 1 2 0 1; 2 0 -2 0 0 0; 2 -2 0 2 0 1; -2 0 0 -1 -1 0; 0 0 0 0 0 0; 0 0 0 0 2 1",
        "0 0; 0 -2; -1 2; 0 -1; 0 2; 0 0",
        "0 0 0 1 0 -2; 2 0 0 0 1 0; 2 0 -1 -2 0 0; 1 0 0 0 0 0",
        2,
        [0.0],
    ),
    (
        "0 0 0 0 0 0 0; 0 -1 1 0 0 0 0; 0 -2 2 2 1 0 -1; "
        "0 0 2 -2 1 0 -1; -1 0 1 0 0 0 0; 0 0 0 0 2 0 0; 2 0 -1 0 -2 0 0",
        "0 0 0 0; -1 0 0 0; 1 0 1 0; -1 2 -1 1; 0 0 0 -2; 1 0 -2 2; 1 0 2 0",
        "0 -2 0 0 0 0 0; 0 2 0 0 1 0 0",
        2,
        [0.0],
    ),
    (
        "2 0 0 0 0; -2 -2 -2 -2 0; 0 0 0 0 0; 0 0 0 0 2; 0 0 1 -2 0",
        "0 -2 0; 0 0 0; 0 0 -1; 1 0 0; 0 1 -1",
        "0 0 0 0 2; 0 1 0 0 0; 0 1 0 -2 0",
        3,
        [0.0],
    ),
    ("0 0 0; 0 0 0; -2 0 -2", "2; 0; 0", "0 0 0; 0 0 0; 0 0 -2", 1, [0.0]),
)

# AB08ND finds no zero here. Exact arithmetic finds s (s - 2) (s^2 - 6 s + 6).
MISSED = (
    "0 0 3 1 0 0 0 0; 0 2 0 -2 0 0 0 0; 0 0 0 -2 -2 0 -1 -2; "
    "-2 0 -2 0 0 0 0 0; 0 0 1 -3 0 0 0 1; 0 0 1 0 3 2 0 0; 0 0 0 -3 0 0 0 -2; -2 0 0 -2 0 0 0 0",
    "0 0 0; 0 0 0; 3 2 -2; 0 0 0; -1 0 0; 1 0 0; 2 -1 0; 0 0 0",
    "-2 0 1 0 0 0 0 0",
)


def matrices(*texts):
    return [np.array([row.split() for row in text.split(";")], float) for text in texts]


@pytest.mark.parametrize(("A", "B", "C", "normal_rank", "zeros"), BY_SLICOT)
def test_zeros_and_normal_rank_are_those_of_slicot(A, B, C, normal_rank, zeros):
    found, rank = invariant_zeros(*matrices(A, B, C))
    assert rank == normal_rank
    assert len(found) == len(zeros)
    np.testing.assert_allclose(np.poly(found), np.poly(zeros), atol=1e-6)


def test_zeros_are_found_however_many_steps_lead_to_them():
    found, rank = invariant_zeros(*matrices(*MISSED))
    assert rank == 1
    np.testing.assert_allclose(found, [0.0, 3.0 - np.sqrt(3.0), 2.0, 3.0 + np.sqrt(3.0)], atol=1e-9)


@pytest.mark.parametrize("case", BY_SLICOT, ids=range(len(BY_SLICOT)))
def test_the_dual_system_has_the_same_zeros(case):
    A, B, C = matrices(*case[:3])
    np.testing.assert_allclose(
        *(np.poly(invariant_zeros(*s)[0]) for s in ((A, B, C), (A.T, C.T, B.T))), atol=1e-9
    )


def test_a_system_without_faults_has_the_zeros_of_what_its_outputs_do_not_see():
    A, C = np.diag([-1.0, -2.0, 3.0]), np.array([[1.0, 1.0, 0.0]])
    found, rank = invariant_zeros(A, np.zeros((3, 0)), C)
    np.testing.assert_allclose(found, [3.0], atol=1e-9)
    assert rank == 0
