"""Rigid motions against SciPy's rotations and matrix exponential, and the axioms of the groups."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from helpers.simulated import rigid
from solvers import se3

UNIT = st.floats(-1, 1)
VECTORS = st.tuples(UNIT, UNIT, UNIT).map(np.array)
SIZES = st.sampled_from([0.0, 1e-12, 1e-9, 1e-7, 1e-5, 0.99e-4, 1.01e-4, 1e-3, 0.5, 3.0])
TANGENTS = st.tuples(VECTORS, VECTORS, SIZES).map(lambda x: np.concatenate([x[0], x[1] * x[2]]))
DIRECTIONS = VECTORS.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


def hat(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


@given(VECTORS, VECTORS)
def test_skew_is_the_cross_product(u, v):
    np.testing.assert_allclose(se3.skew(u) @ v, np.cross(u, v), atol=1e-15)


@given(TANGENTS)
def test_exponentials_are_the_matrix_exponentials(xi):
    np.testing.assert_allclose(se3.exp_so3(xi[3:]), expm(hat(xi[3:])), atol=1e-14)
    np.testing.assert_allclose(se3.exp_se3(xi), rigid(xi), atol=1e-14)


@given(TANGENTS)
@example(np.array([0.3, -0.2, 0.1, 1e-7, 0, 0]))
@example(np.array([0.3, -0.2, 0.1, 0, 0, 0]))
def test_log_undoes_exp(xi):
    # 3 * sqrt(3) > pi: beyond a half turn the logarithm is another tangent of the same motion
    T = se3.exp_se3(xi)
    np.testing.assert_allclose(se3.exp_se3(se3.log_se3(T)), T, atol=1e-13)
    if np.linalg.norm(xi[3:]) < np.pi - 1e-6:
        np.testing.assert_allclose(se3.log_so3(T[:3, :3]), xi[3:], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(se3.log_se3(T), xi, rtol=1e-9, atol=1e-13)


@given(DIRECTIONS, st.sampled_from([0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3]))
def test_log_so3_keeps_its_precision_at_a_half_turn(axis, less):
    w = (np.pi - less) * axis
    found = se3.log_so3(Rotation.from_rotvec(w).as_matrix())
    found *= np.sign(found @ w)  # at pi both signs are right
    np.testing.assert_allclose(found, w, atol=1e-12 if less else 1e-8)
    assert np.linalg.norm(found) <= np.pi + 1e-12


@given(DIRECTIONS, st.sampled_from([0.0, 1e-12, 1e-9, 1e-8, 1e-7, 1e-4, 0.1, 1.0, 1.5]))
def test_log_so3_small_agrees_with_scipy(axis, angle):
    R = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(se3.log_so3_small(R), angle * axis, rtol=1e-12, atol=1e-16)


@given(TANGENTS, TANGENTS, TANGENTS)
def test_motions_form_a_group(x, y, z):
    A, B, C = se3.exp_se3(x), se3.exp_se3(y), se3.exp_se3(z)
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-13)
    np.testing.assert_allclose(A @ se3.inverse(A), np.eye(4), atol=1e-14)
    np.testing.assert_allclose(se3.inverse(A), np.linalg.inv(A), atol=1e-13)
    np.testing.assert_allclose(se3.inverse(A @ B), se3.inverse(B) @ se3.inverse(A), atol=1e-13)
    np.testing.assert_allclose(A[:3, :3] @ A[:3, :3].T, np.eye(3), atol=1e-14)
    assert np.linalg.det(A[:3, :3]) == pytest.approx(1, abs=1e-14)
    np.testing.assert_array_equal(A[3], [0, 0, 0, 1])


@given(TANGENTS)
def test_the_inverse_of_exp_is_exp_of_the_negative(xi):
    np.testing.assert_allclose(se3.inverse(se3.exp_se3(xi)), se3.exp_se3(-xi), atol=1e-14)


@given(TANGENTS, TANGENTS)
def test_adjoint_moves_a_tangent_from_right_to_left(x, y):
    T = rigid(x)
    np.testing.assert_allclose(T @ rigid(y), rigid(se3.adjoint(T) @ y) @ T, atol=1e-12)


def test_tangents_are_metres_first_and_act_on_the_right():
    quarter = np.array([[0, -1, 0, 1.0], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])  # z by 90 deg, then (1, 2, 3)
    step = np.array([0.5, 0, 0, 0, 0, np.pi / 2])
    # half a metre and a quarter turn in the moved frame, whose x axis is the world's y axis
    radius = 0.5 / (np.pi / 2)  # the path is an arc of length 0.5
    expected = np.array([[-1, 0, 0, 1 - radius], [0, -1, 0, 2 + radius], [0, 0, 1, 3], [0, 0, 0, 1]])
    np.testing.assert_allclose(quarter @ se3.exp_se3(step), expected, atol=1e-15)


@given(st.floats(-10, 10))
def test_elementary_rotations(angle):
    for k, rotation in enumerate((se3.rot_x, se3.rot_y, se3.rot_z)):
        np.testing.assert_allclose(rotation(angle), Rotation.from_rotvec(angle * np.eye(3)[k]).as_matrix(), atol=1e-14)


@given(DIRECTIONS, st.sampled_from([0.0, 1e-9, 1e-3, 1.0, 2.0, 3.0, np.pi - 1e-9, np.pi]))
def test_quaternions_are_w_first_and_go_round(axis, angle):
    q = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
    R = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(se3.rotation_from_quat_wxyz(q), R, atol=1e-14)
    np.testing.assert_allclose(se3.rotation_from_quat_wxyz(-7 * q), R, atol=1e-14)
    found = se3.quat_wxyz_from_rotation(R)
    assert found[0] >= 0
    assert np.linalg.norm(found) == pytest.approx(1, abs=1e-14)
    assert abs(found @ q) == pytest.approx(1, abs=1e-14)
    if angle < 3.1:
        np.testing.assert_allclose(found, q, atol=1e-14)


@given(st.integers(0, 10_000), st.sampled_from([1e-6, 0.1, 1.0]), st.booleans())
def test_project_so3_is_the_nearest_rotation(seed, size, mirrored):
    rng = np.random.default_rng(seed)
    M = Rotation.random(random_state=seed).as_matrix() + size * rng.normal(size=(3, 3))
    if mirrored:  # the nearest orthogonal matrix is then no rotation
        M = M @ np.diag([1, 1, -1])
    R = se3.project_so3(M)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(R) == pytest.approx(1, abs=1e-13)
    others = R @ Rotation.from_rotvec(rng.normal(size=(200, 3)) * rng.choice([1e-3, 0.1, 2.0], (200, 1))).as_matrix()
    distance = np.linalg.norm(others - M, axis=(1, 2))
    assert np.linalg.norm(R - M) <= distance.min() + 1e-12


@given(DIRECTIONS)
def test_orthonormal_complement_completes_a_right_handed_frame(n):
    F = np.column_stack([n, se3.orthonormal_complement(n)])
    np.testing.assert_allclose(F.T @ F, np.eye(3), atol=1e-14)
    assert np.linalg.det(F) == pytest.approx(1, abs=1e-14)


def test_arrays_of_any_leading_shape_give_what_their_entries_give():
    rng = np.random.default_rng(4)
    xi = 0.5 * rng.normal(size=(2, 3, 6))
    xi[0, 0] = 0
    T = se3.exp_se3(xi)
    back, quat = se3.log_se3(T), se3.quat_wxyz_from_rotation(T[..., :3, :3])
    inverse, adjoint = se3.inverse(T), se3.adjoint(T)
    projected, complement = se3.project_so3(T[..., :3, :3]), se3.orthonormal_complement(T[..., :3, 0])
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(T[i], rigid(xi[i]), atol=1e-14)
        np.testing.assert_allclose(back[i], xi[i], atol=1e-12)
        np.testing.assert_allclose(quat[i], se3.quat_wxyz_from_rotation(T[i][:3, :3]), atol=1e-15)
        np.testing.assert_allclose(inverse[i], np.linalg.inv(T[i]), atol=1e-14)
        np.testing.assert_allclose(adjoint[i], se3.adjoint(T[i]), atol=1e-15)
        np.testing.assert_allclose(projected[i], T[i][:3, :3], atol=1e-14)
        np.testing.assert_allclose(complement[i], se3.orthonormal_complement(T[i][:3, 0]), atol=1e-15)
