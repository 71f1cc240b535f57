"""Rigid motions: SO(3) and SE(3) on arrays of any leading shape.

Conventions, said once for the whole project:

* ``T_a_b`` is a homogeneous 4x4 matrix that maps b-coordinates to a-coordinates.
* A tangent of SE(3) is ``[v, w]``: metres first, radians second.
* A perturbation acts on the right: ``T (+) xi = T @ exp_se3(xi)``.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SMALL = 1e-4
"""Below this angle (rad) a Taylor series of two terms is exact to 1e-17."""


def skew(w: ArrayLike) -> Array:
    """Cross-product matrix ``[w]x`` of ``w`` (..., 3) -> (..., 3, 3)."""
    w = np.asarray(w, dtype=float)
    S = np.zeros((*w.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return S - np.swapaxes(S, -1, -2)


def _coefficients(theta: Array) -> tuple[Array, Array, Array]:
    """sin(x)/x, (1-cos(x))/x^2 and (x-sin(x))/x^3, smooth through zero."""
    small = theta < _SMALL
    x = np.where(small, 1.0, theta)
    a = np.where(small, 1 - theta**2 / 6, np.sin(x) / x)
    b = np.where(small, 0.5 - theta**2 / 24, 2 * (np.sin(x / 2) / x) ** 2)
    c = np.where(small, 1 / 6 - theta**2 / 120, (x - np.sin(x)) / x**3)
    return a, b, c


def exp_so3(w: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) of the rotation vector ``w`` (..., 3), rad (Rodrigues)."""
    w = np.asarray(w, dtype=float)
    a, b, _ = _coefficients(np.linalg.norm(w, axis=-1))
    W = skew(w)
    return np.eye(3) + a[..., None, None] * W + b[..., None, None] * (W @ W)


def log_so3(R: ArrayLike) -> Array:
    """Rotation vector (..., 3), rad, of length at most pi, of ``R`` (..., 3, 3).

    Goes through the unit quaternion, which keeps full precision at 0 and at pi.
    """
    q = quat_wxyz_from_rotation(R)
    w, v = q[..., 0], q[..., 1:]
    sine = np.linalg.norm(v, axis=-1)
    angle = 2 * np.arctan2(sine, w)
    scale = np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 2.0)
    return scale[..., None] * v


def log_so3_small(R: Array) -> Array:
    """`log_so3` for rotations below about 90 degrees, from the skew part alone; three times faster."""
    v = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine = np.linalg.norm(v, axis=-1)
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1)
    angle = np.arctan2(sine, cosine)
    return np.where(sine > 1e-9, angle / np.where(sine > 1e-9, sine, 1.0), 1.0)[..., None] * v


def rotation_from_quat_wxyz(quat_wxyz: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) of a quaternion (..., 4), w first, normalised here."""
    q = np.asarray(quat_wxyz, dtype=float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0], R[..., 1, 1], R[..., 2, 2] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y)
    R[..., 0, 1], R[..., 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    R[..., 0, 2], R[..., 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    R[..., 1, 2], R[..., 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return R


def quat_wxyz_from_rotation(R: ArrayLike) -> Array:
    """Unit quaternion (..., 4), w first and not negative, of ``R`` (..., 3, 3).

    Of the four columns of 4 q qT the one with the largest diagonal is taken, so no root of a
    small number is ever used (Shepperd 1978).
    """
    R = np.asarray(R, dtype=float)
    d = np.stack([R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]], axis=-1)
    trace = d.sum(axis=-1)
    K = np.empty((*R.shape[:-2], 4, 4))
    K[..., 0, 0] = 1 + trace
    antisymmetric = (
        R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    )  # fmt: skip
    for i in range(3):
        K[..., 0, i + 1] = K[..., i + 1, 0] = antisymmetric[i]
        K[..., i + 1, i + 1] = 1 + 2 * d[..., i] - trace
        for j in range(i):
            K[..., i + 1, j + 1] = K[..., j + 1, i + 1] = R[..., i, j] + R[..., j, i]
    largest = np.argmax(np.diagonal(K, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(K, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def project_so3(M: ArrayLike) -> Array:
    """The rotation nearest to ``M`` (..., 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(np.asarray(M, dtype=float))
    D = np.ones(U.shape[:-1])
    D[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return (U * D[..., None, :]) @ Vt


def rot_x(angle: ArrayLike) -> Array:
    """Rotation about x by ``angle`` (...), rad -> (..., 3, 3)."""
    return _elementary(angle, 0)


def rot_y(angle: ArrayLike) -> Array:
    """Rotation about y by ``angle`` (...), rad -> (..., 3, 3)."""
    return _elementary(angle, 1)


def rot_z(angle: ArrayLike) -> Array:
    """Rotation about z by ``angle`` (...), rad -> (..., 3, 3)."""
    return _elementary(angle, 2)


def _elementary(angle: ArrayLike, axis: int) -> Array:
    angle = np.asarray(angle, dtype=float)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*angle.shape, 3, 3))
    R[..., axis, axis] = 1
    R[..., i, i] = R[..., j, j] = np.cos(angle)
    R[..., j, i] = np.sin(angle)
    R[..., i, j] = -R[..., j, i]
    return R


def transform(R: ArrayLike, p: ArrayLike) -> Array:
    """Homogeneous matrix (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3), m."""
    R, p = np.asarray(R, dtype=float), np.asarray(p, dtype=float)
    shape = np.broadcast_shapes(R.shape[:-2], p.shape[:-1])
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1
    return T


def inverse(T: ArrayLike) -> Array:
    """Inverse of a rigid motion ``T`` (..., 4, 4): ``T_b_a`` of ``T_a_b``."""
    T = np.asarray(T, dtype=float)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def exp_se3(xi: ArrayLike) -> Array:
    """Rigid motion (..., 4, 4) of the tangent ``xi = [v, w]`` (..., 6)."""
    xi = np.asarray(xi, dtype=float)
    v, w = xi[..., :3], xi[..., 3:]
    _, b, c = _coefficients(np.linalg.norm(w, axis=-1))
    W = skew(w)
    V = np.eye(3) + b[..., None, None] * W + c[..., None, None] * (W @ W)
    return transform(exp_so3(w), (V @ v[..., None])[..., 0])


def log_se3(T: ArrayLike) -> Array:
    """Tangent ``[v, w]`` (..., 6) with ``exp_se3(log_se3(T)) == T``, for ``T`` (..., 4, 4)."""
    T = np.asarray(T, dtype=float)
    w = log_so3(T[..., :3, :3])
    _, b, c = _coefficients(np.linalg.norm(w, axis=-1))
    W = skew(w)
    V = np.eye(3) + b[..., None, None] * W + c[..., None, None] * (W @ W)
    v = np.asarray(np.linalg.solve(V, T[..., :3, 3:])[..., 0], dtype=float)
    return np.concatenate([v, w], axis=-1)


def adjoint(T: ArrayLike) -> Array:
    """Adjoint (..., 6, 6): ``T @ exp_se3(xi) == exp_se3(adjoint(T) @ xi) @ T``."""
    T = np.asarray(T, dtype=float)
    R = T[..., :3, :3]
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    A[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return A


def orthonormal_complement(n: ArrayLike) -> Array:
    """Two unit columns (..., 3, 2) with which the unit vector ``n`` (..., 3), placed first, makes a right-handed frame.

    Without branches or square roots: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017.
    """
    x, y, z = np.moveaxis(np.asarray(n, dtype=float), -1, 0)
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    B = np.empty((*np.shape(x), 3, 2))
    B[..., 0, 0], B[..., 1, 0], B[..., 2, 0] = 1 + sign * x * x * a, sign * b, -sign * x
    B[..., 0, 1], B[..., 1, 1], B[..., 2, 1] = b, sign + y * y * a, -y
    return B
