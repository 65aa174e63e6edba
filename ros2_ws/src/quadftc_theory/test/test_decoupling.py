"""Lemma 1 for any model, and what it refuses."""

import numpy as np
import pytest

from quadftc_theory.linear_model import AffineModel, attitude_model, augment, decouple

INERTIA = np.array([0.03, 0.03, 0.04])


def random_model(seed):
    """A model of any size that has a transformation, and its counts."""
    rng = np.random.default_rng(seed)
    n, r, q = (int(rng.integers(low, high)) for low, high in ((3, 9), (1, 3), (1, 3)))
    p = int(rng.integers(r + q, max(r + q, n) + 1))
    n = max(n, p)
    F = rng.normal(size=(p, q))
    model = AffineModel(
        A=rng.normal(size=(n, n)),
        B=rng.normal(size=(n, 2)),
        D=rng.normal(size=(n, 2)),
        W=rng.normal(size=(n, r)),
        C=rng.normal(size=(p, n)),
        F=F,
        output_names=tuple(f"y{k}" for k in range(p)),
        fault_names=tuple(f"f{k}" for k in range(q)),
    )
    return model, (n, p, q, r)


@pytest.mark.parametrize("seed", range(30))
def test_lemma_1_brings_any_model_into_the_form_of_11(seed):
    model, (n, p, q, r) = random_model(seed)
    parts = decouple(model)
    T_inverse = np.linalg.inv(parts.T)
    zeros = np.zeros
    np.testing.assert_allclose(parts.T @ model.W, np.vstack([parts.W1, zeros((n - r, r))]), atol=1e-9)
    np.testing.assert_allclose(parts.S @ model.F, np.vstack([zeros((r, q)), parts.F2]), atol=1e-9)
    wanted = np.block([[parts.C1, zeros((r, n - r))], [zeros((p - r, r)), parts.C4]])
    np.testing.assert_allclose(parts.S @ model.C @ T_inverse, wanted, atol=1e-9)
    np.testing.assert_allclose(
        parts.T @ model.A @ T_inverse, np.block([[parts.A1, parts.A2], [parts.A3, parts.A4]])
    )
    assert np.linalg.matrix_rank(parts.C1) == np.linalg.matrix_rank(parts.W1) == r
    assert np.linalg.matrix_rank(parts.S) == p


def test_the_parts_move_as_the_whole():
    """(12)-(13) against (6): the derivative of z = T x at a random point."""
    model, (_, _, _, r) = random_model(4)
    parts = decouple(model)
    rng = np.random.default_rng(0)
    x, u, f, d = (rng.normal(size=matrix.shape[1]) for matrix in (model.A, model.B, model.D, model.W))
    x_dot = model.A @ x + model.D @ f + model.B @ u + model.W @ d
    z1, z2 = np.split(parts.T @ x, [r])
    z1_dot = parts.A1 @ z1 + parts.A2 @ z2 + parts.D1 @ f + parts.B1 @ u + parts.W1 @ d
    z2_dot = parts.A3 @ z1 + parts.A4 @ z2 + parts.D2 @ f + parts.B2 @ u
    np.testing.assert_allclose(parts.T @ x_dot, np.concatenate([z1_dot, z2_dot]), atol=1e-9)


def test_disturbances_that_depend_on_each_other_count_once():
    model = attitude_model(INERTIA)
    double = model._replace(W=np.hstack([model.W, model.W[:, :1]]))
    parts = decouple(double)
    assert parts.residual < 1e-12
    assert parts.W1.shape == (3, 4)


def test_with_the_imu_as_output_the_transformations_are_permutations():
    parts = decouple(attitude_model(INERTIA))
    for matrix in (parts.T, parts.S):
        assert sorted(matrix.sum(axis=0)) == sorted(matrix.sum(axis=1)) == [1.0] * 6
        assert set(matrix.ravel()) == {0.0, 1.0}
    for matrix in (parts.C1, parts.C4, parts.F2, parts.W1, parts.A3):
        np.testing.assert_array_equal(matrix, np.eye(3))


def test_the_augmented_system_integrates_the_second_output():
    system = augment(decouple(attitude_model(INERTIA)))
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
        decouple(attitude_model(INERTIA, output, faulty))


def test_a_fault_on_an_output_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="faulty = 'p': the outputs are roll, pitch, yaw"):
        attitude_model(INERTIA, "angles", ("p",))
