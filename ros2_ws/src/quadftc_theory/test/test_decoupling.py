"""Lemma 1 for any model, and what it refuses."""

import numpy as np
import pytest

from quadftc_theory.linear_model import AffineModel, attitude_model, augment, decouple


def random_model(seed):
    """A model of any size that has a transformation, and its counts."""
    rng = np.random.default_rng(seed)
    n, r, q = (int(rng.integers(low, high)) for low, high in ((3, 9), (1, 3), (1, 3)))
    p = int(rng.integers(r + q, max(r + q, n) + 1))
    n = max(n, p)
    F = rng.normal(size=(p, q))
    model = AffineModel(
        A=rng.normal(size=(n, n)),
        W=rng.normal(size=(n, r)),
        C=rng.normal(size=(p, n)),
        F=F,
        fault_names=tuple(f"f{k}" for k in range(q)),
    )
    return model, (n, p, q, r)


@pytest.mark.parametrize("seed", range(30))
def test_lemma_1_brings_any_model_into_the_form_of_11(seed):
    model, (n, p, q, r) = random_model(seed)
    parts = decouple(model)
    A, W, C, F, _ = parts.model
    T_inverse = np.linalg.inv(parts.T)
    np.testing.assert_allclose(parts.T @ model.A @ T_inverse, A)
    np.testing.assert_allclose(parts.T @ model.W, W)
    np.testing.assert_allclose(parts.S @ model.C @ T_inverse, C)
    np.testing.assert_allclose(parts.S @ model.F, F)
    assert parts.r == r
    for block in (W[r:], F[:r], C[:r, r:], C[r:, :r]):
        np.testing.assert_allclose(block, 0.0, atol=1e-9)
    assert np.linalg.matrix_rank(C[:r, :r]) == np.linalg.matrix_rank(W[:r]) == r
    assert np.linalg.matrix_rank(parts.S) == p
    assert F[r:].shape == (p - r, q)
    assert A[r:].shape == (n - r, n)


def test_disturbances_that_depend_on_each_other_count_once():
    model = attitude_model()
    double = model._replace(W=np.hstack([model.W, model.W[:, :1]]))
    parts = decouple(double)
    assert parts.residual < 1e-12
    assert parts.model.W[: parts.r].shape == (3, 4)


def test_with_the_imu_as_output_the_transformations_are_permutations():
    parts = decouple(attitude_model())
    for matrix in (parts.T, parts.S):
        assert sorted(matrix.sum(axis=0)) == sorted(matrix.sum(axis=1)) == [1.0] * 6
        assert set(matrix.ravel()) == {0.0, 1.0}
    A, W, C, F, _ = parts.model
    for matrix in (C[:3, :3], C[3:, 3:], F[3:], W[:3], A[3:, :3]):
        np.testing.assert_array_equal(matrix, np.eye(3))


def test_the_augmented_system_integrates_the_second_output():
    system = augment(decouple(attitude_model()))
    expected = np.zeros((6, 6))
    expected[3:, :3] = np.eye(3)
    np.testing.assert_array_equal(system.A, expected)


@pytest.mark.parametrize(
    ("output", "faulty", "reason"),
    [
        ("angles", ("roll", "pitch", "yaw"), r"rank\(C W\) = 0 < rank\(W\) = 3"),
        ("imu", ("roll", "p"), r"rank \[C W, F\] = 4 < rank\(W\) \+ rank\(F\) = 5"),
    ],
)
def test_a_model_without_a_transformation_is_refused_with_the_rank_that_fails(output, faulty, reason):
    with pytest.raises(ValueError, match=reason):
        decouple(attitude_model(output, faulty))


def test_a_fault_on_an_output_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="faulty = 'p': the outputs are roll, pitch, yaw"):
        attitude_model("angles", ("p",))
