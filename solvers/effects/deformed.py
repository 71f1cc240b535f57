"""The mount as a function of the angles: what the deformation of the C makes of it, and how well that is known.

A deformation ξ = [v, w] of the C at the sensor, in the carm frame, shifts the rotation centre in the sensor's frame by
-R_sensor_carm (v + p x w), p the sensor in the carm frame, and turns the carm frame there by -R_sensor_carm w. Of the
effects it is the mean over the ranges of the angles that belongs to the mount (docs/estimation.md, the gauge).
"""

import numpy as np

from solvers.effects.columns import OF_DEFORMATION, of_twist
from solvers.effects.process import grid
from solvers.effects.systematic import Systematic
from solvers.estimate import Deformed
from solvers.likelihood.covariance import reported_jacobian
from solvers.se3 import inverse, skew
from solvers.torus import Torus

NODES = 9
"""Angles of either joint."""
BEYOND_RAD = float(np.radians(15.0))
"""By which the nodes reach beyond the calibrated ranges; the ± grows there."""


def deformed(found: Systematic, torus: Torus) -> Deformed | None:
    """What the effects ``found`` say of the C's deformation beside the estimate ``torus``; None where there is none."""
    names = [name for name in OF_DEFORMATION if name in found.names]
    if not names:
        return None
    scene = found.scene
    low, high = scene.range
    angles = grid(low - BEYOND_RAD, high + BEYOND_RAD, NODES)
    every = np.zeros((len(angles), 6, len(found.model.group)))
    for name in names:
        moved = of_twist(OF_DEFORMATION[name](scene, angles.T)).displacement
        every[:, :, found.columns_of(name)] = moved.transpose(2, 0, 1)
    R, p = torus.T_sensor_carm[:3, :3], inverse(torus.T_sensor_carm)[:3, 3]
    by_shift = np.concatenate([-R, -R @ skew(p)], axis=1) @ every
    by_turn = np.concatenate([np.zeros((3, 3)), -R], axis=1) @ every
    active = scene.blocks.active
    J = np.zeros((len(angles), 3, found.model.unknowns + len(found.model.group)))
    J[:, :, : int(active.sum())] = reported_jacobian(torus)[0][:3, active]
    J[:, :, found.model.unknowns :] = by_shift
    covariance = J @ found.model.covariance @ J.swapaxes(1, 2)
    c = found.model.coefficients
    return Deformed(angles, by_shift @ c, by_turn @ c, covariance, low, high)
