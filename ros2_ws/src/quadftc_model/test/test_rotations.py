"""Rotations: identities that hold for every attitude, and derivatives against numerical ones."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadftc_model.rigid_body import rk4
from quadftc_model.rotations import (
    MIN_COS_PITCH,
    body_acceleration,
    body_rates,
    earth_z_in_body,
    euler_from_quaternion,
    euler_rates,
    normalise,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
    quaternion_rate,
    to_body,
    to_earth,
    wrap,
)

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def vectors(bound):
    number = st.floats(-bound, bound, allow_nan=False)
    return st.tuples(number, number, number).map(np.array)


ANGLES = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)).map(np.array)


def rotation_matrix(angles):
    """Rz(yaw) Ry(pitch) Rx(roll), body to earth, from its definition."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def rotated(q_xyzw, vector):
    """The vector in earth axes: q (v, 0) q*."""
    conjugate = q_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    return quaternion_product(quaternion_product(q_xyzw, np.append(vector, 0.0)), conjugate)[:3]


def motion(time):
    """Euler angles of a smooth motion with their first two derivatives."""
    amplitude, frequency = np.array([0.7, 0.5, 1.1]), np.array([1.3, 0.9, 0.7])
    angle = frequency * time + np.array([0.3, 1.0, 2.0])
    return (
        amplitude * np.sin(angle),
        amplitude * frequency * np.cos(angle),
        -amplitude * frequency**2 * np.sin(angle),
    )


@given(ANGLES)
def test_euler_angles_survive_the_way_through_a_quaternion(angles):
    np.testing.assert_allclose(euler_from_quaternion(quaternion_from_euler(angles)), angles, atol=1e-13)


@given(ANGLES, vectors(10.0))
def test_quaternion_rotates_as_the_matrices_of_the_three_angles(angles, vector):
    expected = rotation_matrix(angles) @ vector
    np.testing.assert_allclose(rotated(quaternion_from_euler(angles), vector), expected, atol=1e-13)


@given(ANGLES, ANGLES)
def test_quaternion_product_is_the_product_of_the_rotations(first, second):
    product = quaternion_product(quaternion_from_euler(second), quaternion_from_euler(first))
    expected = rotation_matrix(second) @ rotation_matrix(first)
    actual = np.stack([rotated(product, axis) for axis in np.eye(3)], axis=-1)
    np.testing.assert_allclose(actual, expected, atol=1e-13)


@given(ANGLES)
def test_earth_vertical_is_the_third_row_of_the_rotation_matrix(angles):
    actual = earth_z_in_body(quaternion_from_euler(angles))
    np.testing.assert_allclose(actual, rotation_matrix(angles)[2], atol=1e-14)


@given(ANGLES, vectors(20.0))
def test_euler_rates_invert_body_rates(angles, rates):
    scale = 1.0 / np.cos(angles[1])
    np.testing.assert_allclose(euler_rates(angles, body_rates(angles, rates)), rates, atol=1e-13 * scale)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_euler_rates_stay_bounded_at_the_singularity(pitch):
    rates = euler_rates(np.array([0.3, pitch, 0.2]), np.array([1.0, -2.0, 0.5]))
    assert np.all(np.abs(rates) <= 3.0 / MIN_COS_PITCH)


@pytest.mark.parametrize("time", [0.0, 0.8, 2.3])
def test_body_rates_are_the_rotation_matrix_differentiated(time):
    step = 1e-6
    angles, angle_rates, _ = motion(time)
    slope = (rotation_matrix(motion(time + step)[0]) - rotation_matrix(motion(time - step)[0])) / (2 * step)
    cross = rotation_matrix(angles).T @ slope  # R' = R [omega]x
    expected = np.array([cross[2, 1], cross[0, 2], cross[1, 0]])
    np.testing.assert_allclose(body_rates(angles, angle_rates), expected, atol=1e-8)


@pytest.mark.parametrize("time", [0.0, 0.8, 2.3])
def test_body_acceleration_is_the_derivative_of_body_rates(time):
    step = 1e-6
    after, before = motion(time + step), motion(time - step)
    expected = (body_rates(*after[:2]) - body_rates(*before[:2])) / (2 * step)
    np.testing.assert_allclose(body_acceleration(*motion(time)), expected, atol=1e-8)


def test_quaternion_kinematics_give_the_motion_of_equation_4():
    def rate(time):
        return np.array([np.sin(2.0 * time), 0.8 * np.cos(time), 0.5])

    angles, q_xyzw = (np.array([0.2, -0.3, 0.5]),), (quaternion_from_euler(np.array([0.2, -0.3, 0.5])),)
    for index in range(1000):
        time = 0.002 * index
        angles = rk4(lambda t, x: (euler_rates(x[0], rate(t)),), time, angles, 0.002)
        q_xyzw = rk4(lambda t, x: (quaternion_rate(x[0], rate(t)),), time, q_xyzw, 0.002)
    np.testing.assert_allclose(euler_from_quaternion(normalise(q_xyzw[0])), angles[0], atol=1e-10)


@given(vectors(3.0))
def test_rotation_vector_turns_by_its_length_about_itself(vector):
    q_xyzw = quaternion_from_rotation_vector(vector)
    angle = np.linalg.norm(vector)
    np.testing.assert_allclose(q_xyzw[3], math.cos(angle / 2), atol=1e-15)
    np.testing.assert_allclose(q_xyzw[:3] * angle, vector * math.sin(angle / 2), atol=1e-15)


def test_rotation_vector_of_zero_is_exactly_level():
    assert np.array_equal(quaternion_from_rotation_vector(np.zeros(3)), LEVEL)


@given(st.floats(-1e3, 1e3))
def test_wrap_lands_within_half_a_turn_of_the_same_direction(angle):
    wrapped = float(wrap(np.array(angle)))
    assert abs(wrapped) <= math.pi + 1e-12
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


@given(st.floats(-math.pi, math.pi))
def test_wrap_leaves_angles_inside_unchanged(angle):
    assert float(wrap(np.array(angle))) == angle


@pytest.mark.parametrize(
    ("function", "widths"),
    [
        (wrap, (3,)),
        (quaternion_from_euler, (3,)),
        (euler_from_quaternion, (4,)),
        (quaternion_product, (4, 4)),
        (quaternion_rate, (4, 3)),
        (quaternion_from_rotation_vector, (3,)),
        (normalise, (4,)),
        (earth_z_in_body, (4,)),
        (euler_rates, (3, 3)),
        (body_rates, (3, 3)),
        (body_acceleration, (3, 3, 3)),
    ],
)
def test_batch_equals_the_loop(function, widths):
    generator = np.random.default_rng(1)
    batch = [0.5 * generator.standard_normal((5, 2, width)) for width in widths]
    batch = [normalise(array) if array.shape[-1] == 4 else array for array in batch]
    loop = [function(*(array[i, j] for array in batch)) for i in range(5) for j in range(2)]
    result = function(*batch)
    np.testing.assert_allclose(result.reshape(10, -1), np.array(loop), rtol=1e-12, atol=1e-14)


@given(ANGLES, vectors(10.0))
def test_vectors_turn_to_earth_as_by_the_quaternion_product_and_back(angles, vector):
    q_xyzw = quaternion_from_euler(angles)
    np.testing.assert_allclose(to_earth(q_xyzw, vector), rotated(q_xyzw, vector), atol=1e-12)
    np.testing.assert_allclose(to_body(q_xyzw, to_earth(q_xyzw, vector)), vector, atol=1e-12)
