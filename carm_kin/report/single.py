"""The page of one calibration."""

import os
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path

import numpy as np

from carm_kin.recording.formats import RecordingLike, as_recordings
from carm_kin.report import words
from carm_kin.report.charts import charts
from carm_kin.report.comparison import comparison_of
from carm_kin.report.isocentre import wander_of
from carm_kin.report.page import write_page
from carm_kin.report.poses import Joints, poses_of, together
from carm_kin.report.scene import scene
from carm_kin.results.chain_result import ChainCalibration
from carm_kin.results.held_out import HeldOut
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from carm_kin.results.shown import NOT_DETERMINED, determined
from carm_kin.results.summary import MOST_SIGMA
from carm_kin.steps import step
from carm_kin.version import __version__

MOST_LISTED = 60
"""Numbers of poses that are written out."""


@step("write the report")
def write_report(
    result: ResultLike,
    recording: RecordingLike | Sequence[RecordingLike],
    out: str | os.PathLike,
    *,
    joints: Joints = Joints(),
    compared: Mapping[str, ResultLike] | None = None,
    truth: ResultLike | None = None,
) -> None:
    """Write the page of a result and the recording, or several of a chain, that it was made from; all may be paths.

    ``compared`` are other results of the same recording by their names, ``truth`` is what they should be. Raises
    InputError for another recording, and where the place cannot be written.
    """
    result = as_result(result)
    poses = poses_of(result, together(as_recordings(recording)), joints)
    write_page(
        "report.html",
        Path(out),
        title=f"C-arm calibration: {result.provenance.input_name or result.status}",
        version=__version__,
        subject=result.provenance.input_name,
        result=result,
        verdict=words.verdict(result),
        rows=words.rows_of(result),
        placements=words.placement_rows(result),
        quality=words.quality_rows(result),
        scene=scene(result, poses),
        charts=charts(result, poses),
        why=poses.why,
        outliers=_outliers(result),
        sweeps=_sweeps(result),
        isocentre=wander_of(result),
        held_out=_held_out(result),
        joints=_joints(result.chain) if result.chain else [],
        comparison=comparison_of(compared, truth) if compared else None,
        provenance=_provenance(result),
    )


def _outliers(result: CalibrationResult) -> list[list[str]]:
    reasons = [(reason.reason, reason.indices) for reason in result.outliers.reasons]
    named = {pose for _, indices in reasons for pose in indices}
    rest = tuple(pose for pose in result.outliers.indices if pose not in named)
    return [[reason, str(len(poses)), _listed(poses)] for reason, poses in [*reasons, ("", rest)] if poses]


def _listed(poses: tuple[int, ...]) -> str:
    more = f" and {len(poses) - MOST_LISTED} more" if len(poses) > MOST_LISTED else ""
    return ", ".join(map(str, poses[:MOST_LISTED])) + more


def _sweeps(result: CalibrationResult) -> list[list[str]]:
    return [
        [row.label, str(row.poses), *_errors(row.translation_rms_m, row.rotation_rms_rad)]
        for row in result.residuals_per_sweep
    ]


def _held_out(result: CalibrationResult) -> list[list[str]]:
    found = result.cross_validation
    return [_held_out_row(row) for row in (found.overall, *found.per_fold)] if found else []


def _held_out_row(row: HeldOut) -> list[str]:
    sweeps = f" (sweeps {', '.join(row.sweeps)})" if row.sweeps and row.label != "overall" else ""
    if row.refusal:
        return [row.label + sweeps, str(row.poses), f"refused: {row.refusal.message}", "", ""]
    chi2 = "" if row.chi2_per_dof is None else f"{row.chi2_per_dof:.2f}"
    return [row.label + sweeps, str(row.poses), *_errors(row.translation_rms_m, row.rotation_rms_rad), chi2]


def _errors(length_m: float | None, angle_rad: float | None) -> list[str]:
    return [
        "" if length_m is None else f"{length_m * 1e3:.3f}",
        "" if angle_rad is None else f"{degrees(angle_rad):.3f}",
    ]


def _joints(chain: ChainCalibration) -> list[list[str]]:
    """What of the URDF changed, one number a line."""
    lines = []
    for joint in chain.joints:
        rows = [*zip("xyz", joint.shift_m * 1e3, joint.shift_sigma_m * 1e3, ["mm"] * 3, strict=True)]
        rows += zip(
            ("rx", "ry", "rz"), np.degrees(joint.turn_rad), np.degrees(joint.turn_sigma_rad), ["deg"] * 3, strict=True
        )
        if joint.zero_rad is not None and joint.zero_sigma_rad is not None:
            rows.append(("zero", degrees(joint.zero_rad), degrees(joint.zero_sigma_rad), "deg"))
        if joint.zero_m is not None and joint.zero_sigma_m is not None:
            rows.append(("zero", joint.zero_m * 1e3, joint.zero_sigma_m * 1e3, "mm"))
        rows.append(("gain", joint.gain * 1e2, joint.gain_sigma * 1e2, "%"))
        lines += [
            [joint.joint, name, *_number(float(value), float(sigma), unit)]
            for name, value, sigma, unit in rows
            if name in joint.estimated
        ]
    return lines


def _number(value: float, sigma: float, unit: str) -> tuple[str, str, str]:
    """The value, its sigma and its unit."""
    if not determined(sigma, MOST_SIGMA.get(unit, np.inf)):
        return NOT_DETERMINED, "", ""
    return *words.with_sigma(value, sigma), unit


def _provenance(result: CalibrationResult) -> list[list[str]]:
    source = result.provenance
    rows = {
        "recording": source.input_name,
        "SHA-256": source.input_sha256,
        "date": source.date,
        "command": source.command,
        "seed": None if source.seed is None else str(source.seed),
        "solver": result.solver,
        "options": ", ".join(f"{name} = {value}" for name, value in result.options.items()),
        "versions": ", ".join(f"{name} {version}" for name, version in source.versions.items()),
    }
    return [[name, value] for name, value in rows.items() if value]
