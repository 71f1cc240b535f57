"""Simulated recordings: a chain, a protocol, noise and a seed give a recording and its truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carm_kin import result as r
from carm_kin.chain import Chain, NominalGeometry, chain_of, nominal_geometry
from carm_kin.errors import InputError
from carm_kin.model import Model
from carm_kin.protocols import Motion, motions
from carm_kin.provenance import provenance_of
from carm_kin.recording import ROTATION_TOLERANCE, Recording
from carm_kin.urdf import UrdfFile, read_urdf
from solvers.estimate import Note
from solvers.se3 import Array, exp_so3, inverse, rotation_from_quat_wxyz, transform

OUTLIER_M = (0.05, 0.5)
"""A gross outlier lies off by a distance between these and has a random orientation."""
MAX_SIGMA_T_M = 10.0
"""Larger noise is taken for a wrong unit."""
WORLD_M = 1.0
"""The torus centre is drawn from a cube of this half-width about the tracker's origin."""


@dataclass(frozen=True)
class Noise:
    """What disturbs the poses."""

    sigma_t_m: float = 0.0
    """Position noise, one standard deviation an axis."""
    sigma_r_rad: float = 0.0
    """Orientation noise: a rotation vector in the sensor frame, one standard deviation an axis."""
    outliers: float = 0.0
    """Share of poses that are replaced by gross outliers."""
    missing: float = 0.0
    """Share of frames in which the sensor is not seen."""


def simulate(
    urdf: str | Path | UrdfFile,
    protocol: str | Path = "clinical",
    *,
    sigma_t_m: float = 0.0,
    sigma_r_rad: float = 0.0,
    outliers: float = 0.0,
    missing: float = 0.0,
    labels: bool = True,
    T_world_torus: Array | None = None,
    T_sensor_mount: Array | None = None,
    angular: str | None = None,
    orbital: str | None = None,
    sensor_link: str | None = None,
    seed: int = 0,
) -> tuple[Recording, r.CalibrationResult]:
    """A recording of the C-arm in ``urdf`` (a path or a bundled name) and its truth.

    ``protocol`` is paper, clinical, minimal, free or a TOML file. ``T_world_torus`` (4, 4), m, is drawn
    from the seed unless given. ``T_sensor_mount`` (4, 4) turns and moves the sensor in its link. Without
    ``labels`` the recording tells nothing of the joints. The truth is a result of the solver ``truth``,
    whose outliers are the poses that were replaced. Raises InputError for bad input.
    """
    noise = _checked(Noise(sigma_t_m, sigma_r_rad, outliers, missing))
    if seed < 0:
        raise InputError(f"the seed must be at least 0, not {seed}")
    for name, T in (("T_world_torus", T_world_torus), ("T_sensor_mount", T_sensor_mount)):
        _check_rigid(name, T)
    rng = np.random.default_rng(seed)
    file = urdf if isinstance(urdf, UrdfFile) else read_urdf(urdf)
    chain = chain_of(file, sensor_link, angular, orbital)
    if chain.angular > chain.orbital:
        raise InputError("the angular joint must stand nearer the base than the orbital one", file=file.path)
    plan, notes = motions(chain, protocol, rng)
    if T_world_torus is None:
        T_world_torus = transform(rotation_from_quat_wxyz(rng.normal(size=4)), rng.uniform(-WORLD_M, WORLD_M, 3))
    mount = np.eye(4) if T_sensor_mount is None else T_sensor_mount
    q = np.concatenate([motion.q for motion in plan])
    stations, placement = _stations(chain, q)
    geometries = [nominal_geometry(chain, station) for station in stations]
    T_world_base = T_world_torus @ inverse(geometries[0].T_base_torus)
    T = T_world_base @ Model(file, chain).forward_kinematics(q) @ mount
    p, R, replaced = _disturbed(T, noise, rng)
    seen = rng.random(len(q)) >= noise.missing
    recording = _recording(chain, plan, placement, p, R, labels).select(seen)
    return replace(recording, missing=int((~seen).sum())), _truth(
        geometries,
        T_world_base,
        mount,
        noise,
        outliers=np.flatnonzero(replaced & seen),
        poses=len(recording),
        notes=(*(Note("urdf", note) for note in file.notes), *notes),
        seed=seed,
    )


def _stations(chain: Chain, q: Array) -> tuple[Array, np.ndarray]:
    """The distinct positions (K, J) of all joints but the two axes, and the number (N,) of each pose's.

    Each is a base placement of its own, since the torus stands elsewhere.
    """
    others = q.copy()
    others[:, [chain.angular, chain.orbital]] = 0
    _, first, number = np.unique(others, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))
    return others[np.sort(first)], order[number.ravel()]


def _checked(noise: Noise) -> Noise:
    for name, share in (("outliers", noise.outliers), ("missing", noise.missing)):
        if not 0 <= share < 1:
            raise InputError(f"{name} must be a share of the poses, from 0 to below 1, not {share}")
    for name, sigma, most in (("sigma_t_m", noise.sigma_t_m, MAX_SIGMA_T_M), ("sigma_r_rad", noise.sigma_r_rad, np.pi)):
        if not 0 <= sigma <= most:
            raise InputError(f"{name} must be from 0 to {most:.3g}, not {sigma}")
    return noise


def _check_rigid(name: str, T: Array | None) -> None:
    """Raise InputError where a transform is given that is none."""
    if T is None:
        return
    if np.shape(T) != (4, 4) or not np.isfinite(T).all() or (np.asarray(T)[3] != (0, 0, 0, 1)).any():
        raise InputError(f"{name} must be a finite (4, 4) transform with the last row 0 0 0 1")
    R = np.asarray(T)[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise InputError(f"{name} holds no rotation matrix")


def _disturbed(T: Array, noise: Noise, rng: np.random.Generator) -> tuple[Array, Array, np.ndarray]:
    n = len(T)
    p = T[:, :3, 3] + noise.sigma_t_m * rng.normal(size=(n, 3))
    R = T[:, :3, :3] @ exp_so3(noise.sigma_r_rad * rng.normal(size=(n, 3)))
    replaced = np.zeros(n, dtype=bool)
    replaced[rng.permutation(n)[: round(noise.outliers * n)]] = True
    k = int(replaced.sum())
    direction = rng.normal(size=(k, 3))
    p[replaced] += direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(*OUTLIER_M, size=(k, 1))
    R[replaced] = rotation_from_quat_wxyz(rng.normal(size=(k, 4)))
    return p, R, replaced


def _recording(chain: Chain, plan: list[Motion], placement: np.ndarray, p: Array, R: Array, labels: bool) -> Recording:
    placements = (placement + 1).astype(str) if placement.any() else None
    if not labels:
        return Recording(p, R, placement=placements)
    sizes = [len(motion.q) for motion in plan]
    q = np.concatenate([motion.q for motion in plan])
    joints = {}
    for j in (chain.angular, chain.orbital):
        held = np.repeat([motion.moving not in ("", chain.names[j]) for motion in plan], sizes)
        joints[chain.names[j]] = np.where(held, q[:, j], np.nan)
    return Recording(
        p,
        R,
        sweep=np.repeat([motion.sweep for motion in plan], sizes),
        moving=np.repeat([motion.moving for motion in plan], sizes),
        placement=placements,
        joints=joints,
    )


def _truth(
    geometries: list[NominalGeometry],
    T_world_base: Array,
    mount: Array,
    noise: Noise,
    *,
    outliers: np.ndarray,
    poses: int,
    notes: tuple[Note, ...],
    seed: int,
) -> r.CalibrationResult:
    geometry = geometries[0]
    T_sensor_carm = inverse(mount) @ geometry.T_sensor_carm
    tori = [T_world_base @ g.T_base_torus for g in geometries]
    labels = [""] if len(tori) == 1 else [str(k + 1) for k in range(len(tori))]
    offset, axis = T_sensor_carm[:3, 3], T_sensor_carm[:3, 1]
    return r.CalibrationResult(
        status="ok",
        solver="truth",
        options={"outliers": noise.outliers, "missing": noise.missing},
        offset_sensor_pivot_m=offset,
        major_radius_m=abs(geometry.major_radius),
        major_radius_signed_m=geometry.major_radius,
        minor_radius_m=float(np.linalg.norm(np.cross(offset, axis))),
        axis_non_orthogonality_rad=geometry.non_orthogonality,
        orbital_axis_sensor=axis,
        placements=tuple(
            r.Placement(label, T[:3, 3], T[:3, 0], T, referenced=True) for label, T in zip(labels, tori, strict=True)
        ),
        T_sensor_carm=T_sensor_carm,
        orbital_referenced=True,
        sigma=r.Sigma(),
        covariance=None,
        noise=r.NoiseLevel(noise.sigma_t_m, noise.sigma_r_rad, estimated=False),
        residuals=r.Residuals("overall", 0.0, 0.0, None, poses),
        residuals_per_sweep=(),
        poses=poses,
        used=poses - len(outliers),
        outliers=r.Outliers(len(outliers), tuple(int(i) for i in outliers)),
        observability=r.Observability(np.zeros(0), None, ()),
        warnings=notes,
        refusal=None,
        provenance=provenance_of(None, None, seed),
    )
