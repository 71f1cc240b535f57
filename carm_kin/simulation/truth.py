"""The truth of a simulated recording, under the keys of a result."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.errors import InputError
from carm_kin.machine.chain import Chain, nominal_geometry
from carm_kin.results.deformation import Deformation
from carm_kin.results.parts import NoiseLevel, Observability, Outliers, Placement, Residuals, Sigma
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult
from carm_kin.simulation.noise import Noise
from carm_kin.simulation.plan import Plan
from solvers.estimate import Note
from solvers.se3 import Array, inverse


def truth_of(
    plan: Plan,
    T_world_base: Array,
    mount: Array,
    *,
    options: Mapping[str, Any],
    noise: Noise,
    deformation: Deformation | None,
    outliers: np.ndarray,
    poses: int,
    notes: tuple[Note, ...],
    seed: int,
) -> CalibrationResult:
    """The truth of a simulation in the two-axis form, as a result of the solver ``truth``.

    ``options`` are the protocol and all that disturbs it, by the keywords of `carm_kin.simulate`. The rigid numbers are
    those that are true in the mean over the ``deformation``.
    """
    geometry = plan.geometries[0]
    T_sensor_carm = inverse(mount) @ geometry.T_sensor_carm
    tori = [T_world_base @ g.T_base_torus for g in plan.geometries]
    labels = [""] if len(tori) == 1 else [str(k + 1) for k in range(len(tori))]
    offset, axis = T_sensor_carm[:3, 3], T_sensor_carm[:3, 1]
    return CalibrationResult(
        status="ok",
        solver="truth",
        options=options,
        offset_sensor_pivot_m=offset,
        major_radius_m=abs(geometry.major_radius),
        major_radius_signed_m=geometry.major_radius,
        minor_radius_m=float(np.linalg.norm(np.cross(offset, axis))),
        axis_non_orthogonality_rad=geometry.non_orthogonality,
        orbital_axis_sensor=axis,
        placements=tuple(
            Placement(label, T[:3, 3], T[:3, 0], T, referenced=True) for label, T in zip(labels, tori, strict=True)
        ),
        T_sensor_carm=T_sensor_carm,
        orbital_referenced=True,
        sigma=Sigma(),
        covariance=None,
        noise=NoiseLevel(noise.sigma_t_m, noise.sigma_r_rad, estimated=False),
        residuals=Residuals("overall", 0.0, 0.0, None, poses),
        residuals_per_sweep=(),
        poses=poses,
        used=poses - len(outliers),
        outliers=Outliers(len(outliers), tuple(int(i) for i in outliers)),
        observability=Observability(np.zeros(0), None, ()),
        warnings=(*notes, *plan.notes),
        refusal=None,
        deformation=deformation,
        provenance=provenance_of(None, None, seed),
    )


def chain_ends(truth: CalibrationResult, chain: Chain, q: ArrayLike | None = None) -> tuple[Array, Array]:
    """T_world_base and T_link_sensor (4, 4), m, of a truth: the two ends of T_world_base FK(q) T_link_sensor.

    ``chain`` is that of the simulated machine, with the joints other than its two axes at zero, or at ``q`` (J,),
    in the first placement. Raises InputError as `carm_kin.machine.chain.nominal_geometry` does.
    """
    geometry = nominal_geometry(chain, q)
    T_world_torus, T_sensor_carm = truth.placements[0].T_world_torus, truth.T_sensor_carm
    if T_world_torus is None or T_sensor_carm is None:
        raise InputError("this result has no complete chain; it is no truth")
    return T_world_torus @ inverse(geometry.T_base_torus), geometry.T_sensor_carm @ inverse(T_sensor_carm)
