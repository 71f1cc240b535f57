"""What must not change a solver's answer, or must change it in a known way: other frames, units, orders."""

import dataclasses
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import solvers
from carm_kin.testing.truth import DATA, EXACT, SIGMA_R, SIGMA_T, assert_close, shuffled
from solvers.problem import Problem
from solvers.se3 import Array

SHIFT = np.array([1.3, -0.7, 0.4])
"""m."""
NEAR = 1e-2
"""Of the noise of one pose: what iterations that stop at 1e-3 sigma can promise."""


def moves_with_the_world_frame(name: str, seed: int = 0, shift: Array = SHIFT) -> None:
    """Poses in another world frame: the world part follows, all else stays."""
    Q = _rotation(seed)
    there = dataclasses.replace(
        DATA, p_world_sensor=DATA.p_world_sensor @ Q.T + shift, R_world_sensor=Q @ DATA.rotations
    )
    one, other = _solve(name, DATA), _solve(name, there)
    back: dict[str, Any] = {"center": (other.center - shift) @ Q}
    if other.angular_axis is not None:
        back["angular_axis"] = _directed(other.angular_axis @ Q, one.angular_axis, other.torus)
    if other.torus is not None:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Q, shift
        moved = np.linalg.inv(T) @ other.torus.T_world_torus
        back["torus"] = dataclasses.replace(other.torus, T_world_torus=moved)
    _same(one, dataclasses.replace(other, **back))


def moves_with_the_sensor_frame(name: str, seed: int = 0, shift: Array = SHIFT) -> None:
    """The sensor elsewhere on the C: the offset follows, all else stays.

    The new sensor frame stands at ``move`` in the old one; positions are then those of another point, whose
    errors are no longer isotropic and independent of the orientations, so the data have none.
    """
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = _rotation(seed), 0.1 * shift
    p = EXACT.p_world_sensor + EXACT.rotations @ move[:3, 3]
    there = dataclasses.replace(EXACT, p_world_sensor=p, R_world_sensor=EXACT.rotations @ move[:3, :3])
    one, other = _solve(name, EXACT), _solve(name, there)
    assert_close(one.center, other.center, 1e-6, "center")
    assert_close(abs(one.major_radius), abs(other.major_radius), 1e-6, "major_radius")
    if one.offset is not None:
        assert_close(move[:3, :3] @ other.offset + move[:3, 3], one.offset, 1e-6, "offset")
    if one.torus is not None:
        assert_close(move @ other.torus.T_sensor_carm, one.torus.T_sensor_carm, 1e-6, "T_sensor_carm")
        assert_close(other.torus.T_world_torus, one.torus.T_world_torus, 1e-6, "T_world_torus")


def turns_with_the_sensor_frame(name: str, seed: int = 0) -> None:
    """The sensor turned where it is: isotropic noise stays what it is, and the offset turns."""
    Q = _rotation(seed)
    one, other = _solve(name, DATA), _solve(name, dataclasses.replace(DATA, R_world_sensor=DATA.rotations @ Q))
    back = {}
    if other.offset is not None:
        back["offset"] = Q @ other.offset
    if other.torus is not None:
        T = np.eye(4)
        T[:3, :3] = Q
        back["torus"] = dataclasses.replace(other.torus, T_sensor_carm=T @ other.torus.T_sensor_carm)
    _same(one, dataclasses.replace(other, **back))


def scales_with_lengths(name: str, factor: float = 0.7) -> None:
    """Positions times a factor: every length is, too."""
    one = _solve(name, DATA)
    other = _solve(name, dataclasses.replace(DATA, p_world_sensor=factor * DATA.p_world_sensor))
    lengths = ("center", "offset", "major_radius", "minor_radius", "sigma_t")
    back = {k: getattr(other, k) / factor for k in lengths if getattr(other, k) is not None}
    if other.torus is not None:
        tori, mount = other.torus.T_world_torus.copy(), other.torus.T_sensor_carm.copy()
        tori[:, :3, 3] /= factor
        mount[:3, 3] /= factor
        back["torus"] = dataclasses.replace(other.torus, T_world_torus=tori, T_sensor_carm=mount)
    _same(one, dataclasses.replace(other, **back))


def does_not_depend_on_the_order(name: str, seed: int = 0) -> None:
    """Poses in another order: the same, but for the sense of an axis that nothing tells."""
    one, other = _solve(name, DATA), _solve(name, shuffled(DATA, seed))
    if other.angular_axis is not None:
        axis = _directed(other.angular_axis, one.angular_axis, other.torus)
        other = dataclasses.replace(other, angular_axis=axis)
    _same(one, other)


def does_not_depend_on_the_order_without_labels(name: str, seed: int = 0) -> None:
    """Without labels the order changes the zeros of the angles alone."""
    data = dataclasses.replace(DATA, label=np.full(DATA.label.shape, np.nan))
    one, other = _solve(name, data), _solve(name, shuffled(data, seed))
    assert_close(one.center, other.center, NEAR * SIGMA_T, "center")
    assert_close(abs(one.major_radius), abs(other.major_radius), NEAR * SIGMA_T, "major_radius")
    if one.offset is not None:
        assert_close(one.offset, other.offset, NEAR * SIGMA_T, "offset")
    if one.torus is not None:
        assert_close(abs(one.torus.orbital_axis @ other.torus.orbital_axis), 1, 1e-6, "orbital_axis")
        assert not other.torus.referenced.any(), "alpha has a zero that no label tells"
        assert not other.torus.orbital_referenced, "beta has a zero that no label tells"


def _solve(name: str, data: Problem) -> Any:
    """With the solver's defaults, its random sampling off where it has one: sampling follows the order and the
    rounding of the poses, and the invariances are those of the estimator."""
    module = solvers.solver(name)
    known = {f.name for f in dataclasses.fields(module.Options)}
    plain = module.Options(iterations=0) if {"seed", "iterations"} <= known else module.Options()
    return module.solve(data, plain)


def _same(one: Any, other: Any) -> None:
    """Equal to a hundredth of the noise of one pose."""
    near, turn = NEAR * SIGMA_T, NEAR * SIGMA_R
    assert_close(one.center, other.center, near, "center")
    assert_close(one.major_radius, other.major_radius, near, "major_radius")
    for field, atol in (("offset", near), ("minor_radius", near), ("angular_axis", turn), ("sigma_t", near)):
        a, b = getattr(one, field), getattr(other, field)
        assert (a is None) == (b is None), f"{field} is there in one case alone"
        if a is not None:
            assert_close(a, b, atol, field)
    if one.torus is not None:
        assert_close(one.torus.T_world_torus, other.torus.T_world_torus, near, "T_world_torus")
        assert_close(one.torus.T_sensor_carm, other.torus.T_sensor_carm, near, "T_sensor_carm")
    if one.covariance is not None:
        assert one.covariance.names == other.covariance.names, "the covariance has other names"


def _rotation(seed: int) -> Array:
    return Rotation.from_quat(np.random.default_rng(seed).normal(size=4)).as_matrix()


def _directed(axis: Array, like: Array, torus: Any) -> Array:
    """Without a chain the direction of an axis is a convention."""
    return axis if torus is not None else axis * np.sign((axis * like).sum(axis=1, keepdims=True))
