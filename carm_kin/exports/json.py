"""The transform and the whole result as JSON."""

import json
from pathlib import Path

import numpy as np

from carm_kin.exports._wanted import Subject, Wanted, deformation_words, subject_of
from carm_kin.files import write_atomically
from carm_kin.results.deformation import Deformation
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array, quat_wxyz_from_rotation

ENDING = ".json"
SUMMARY = "The transform as matrix and quaternion, with its sigma, over the angles where the C bends; the whole result."
TAKES = ("transform", "placement", "parent_frame", "child_frame")
SCHEMA = "carm-kin/export/1"


def write(result: CalibrationResult, out: Path, wanted: Wanted) -> None:
    """Write the file; translations in mm, angles in degrees."""
    subject, source = subject_of(result, wanted), result.provenance
    content = {
        "schema": SCHEMA,
        "convention": "p_parent = T_parent_child p_child; column vectors, right-handed",
        "meaning": subject.meaning,
        "zero": subject.zero,
        "units": {"translation": "mm", "rotation": "1", "angles": "deg"},
        **_numbers(subject),
        "deformation": None if subject.deformation is None else _deformation(subject, subject.deformation),
        "input_name": source.input_name,
        "input_sha256": source.input_sha256,
        "date": source.date,
        "result": result.to_dict(),
    }
    write_atomically(out, json.dumps(content, indent=2, allow_nan=False) + "\n")


def _numbers(subject: Subject) -> dict[str, object]:
    T, sigma, angle = subject.T_parent_child, subject.sigma_translation, subject.sigma_axis
    return {
        "parent_frame": subject.parent,
        "child_frame": subject.child,
        "T_parent_child": (T * np.where(np.arange(4) == 3, [[1e3], [1e3], [1e3], [1.0]], 1.0)).tolist(),
        **_pose(T),
        "sigma_translation_mm": None if sigma is None else (sigma * 1e3).tolist(),
        "sigma_axis_deg": None if angle is None else float(np.degrees(angle)),
    }


def _pose(T: Array) -> dict[str, object]:
    w, x, y, z = quat_wxyz_from_rotation(T[:3, :3])
    return {"translation_mm": (T[:3, 3] * 1e3).tolist(), "quat_xyzw": [float(q) for q in (x, y, z, w)]}


def _deformation(subject: Subject, bent: Deformation) -> dict[str, object]:
    """The transform at each pair of angles of a grid, beta running faster."""
    angles = np.array([[node.alpha_rad, node.beta_rad] for node in bent.nodes])
    T, outside = bent.T_sensor_carm(subject.T_parent_child, *angles.T), bent.extrapolated(*angles.T)
    return {
        "meaning": deformation_words(bent),
        "alpha_range_deg": np.degrees(bent.alpha_range_rad).tolist(),
        "beta_range_deg": np.degrees(bent.beta_range_rad).tolist(),
        "grid": [
            {
                "alpha_deg": float(np.degrees(node.alpha_rad)),
                "beta_deg": float(np.degrees(node.beta_rad)),
                **_pose(pose),
                "sigma_translation_mm": (node.sigma_offset_sensor_pivot_m * 1e3).tolist(),
                "extrapolated": bool(beyond),
            }
            for node, pose, beyond in zip(bent.nodes, T, outside, strict=True)
        ],
    }
