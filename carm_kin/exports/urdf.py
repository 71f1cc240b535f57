"""The calibrated machine as a URDF.

A result of `carm_kin.calibration.chain.calibrate` gives back the URDF that was calibrated, with its calibrated
origins. Any other one gives a small URDF of the two axes: torus, angular joint, orbital joint, and the sensor on the
C-arm.
"""

import os
from dataclasses import replace
from math import degrees
from pathlib import Path

from carm_kin.calibration.chain.calibrated_urdf import calibrated_urdf
from carm_kin.errors import InputError
from carm_kin.exports._wanted import Wanted, facts, facts_of_origin, in_xml_comment, subject_of
from carm_kin.machine.urdf import UrdfFile, add_comment, as_urdf, parse_urdf, patch_origins, write_urdf
from carm_kin.results.chain_result import ChainCalibration, JointChange
from carm_kin.results.result import CalibrationResult
from solvers.se3 import inverse, rot_z, transform

ENDING = ".urdf"
SUMMARY = "Calibrated URDF: the one that was calibrated (with its file), or the two axes alone."
TAKES = ("urdf",)

_UNITS = "m, rad"
_TWO_AXES = b"""<?xml version="1.0"?>
<robot name="c_arm">
  <link name="torus"/>
  <joint name="angular" type="continuous">
    <parent link="torus"/>
    <child link="swivel"/>
    <axis xyz="1 0 0"/>
  </joint>
  <link name="swivel"/>
  <joint name="orbital" type="continuous">
    <parent link="swivel"/>
    <child link="carm"/>
    <origin xyz="0 0 0" rpy="0 0 0"/>
    <axis xyz="0 1 0"/>
  </joint>
  <link name="carm"/>
  <joint name="sensor_mount" type="fixed">
    <parent link="carm"/>
    <child link="sensor"/>
    <origin xyz="0 0 0" rpy="0 0 0"/>
  </joint>
  <link name="sensor"/>
</robot>
"""


def write(result: CalibrationResult, out: Path, wanted: Wanted) -> None:
    """Write the file."""
    file, lines = _chain(result, wanted.urdf) if result.chain else _two_axes(result, wanted)
    write_urdf(add_comment(file, [in_xml_comment(line) for line in lines]), out)


def _chain(result: CalibrationResult, urdf: UrdfFile | str | os.PathLike | None) -> tuple[UrdfFile, list[str]]:
    chain = result.chain
    assert chain is not None
    if urdf is None:
        raise InputError(f"the chain of {chain.urdf} was calibrated: give that file by --urdf")
    return calibrated_urdf(as_urdf(urdf), chain), _chain_facts(result, chain)


def _chain_facts(result: CalibrationResult, chain: ChainCalibration) -> list[str]:
    return [
        f"carm-kin {result.provenance.versions.get('carm-kin', '')}: calibrated origins of {chain.urdf}",
        "convention: an origin maps coordinates of the joint's frame to those of its parent link",
        f"units: {_UNITS}",
        *(f"sigma of joint {change.joint}: {_sigma(change)}" for change in chain.joints),
        *facts_of_origin(result),
    ]


def _sigma(change: JointChange) -> str:
    """One standard deviation of what was estimated, in the frame of the nominal joint."""
    values = [(f"{n} {s * 1e3:.4f} mm", n) for n, s in zip("xyz", change.shift_sigma_m, strict=True)]
    turns = zip(("rx", "ry", "rz"), change.turn_sigma_rad, strict=True)
    values += [(f"{n} {degrees(s):.5f} deg", n) for n, s in turns]
    return ", ".join(words for words, name in values if name in change.estimated) or "not estimated"


def _two_axes(result: CalibrationResult, wanted: Wanted) -> tuple[UrdfFile, list[str]]:
    if wanted.urdf is not None:
        raise InputError(f"{wanted.urdf} was not calibrated; calibrate with --urdf, or leave it out for the two axes")
    if result.T_sensor_carm is None or result.major_radius_signed_m is None:
        raise InputError(f"a result of the solver '{result.solver}' holds no complete chain; use 'kinematic'")
    meaning = "the link 'carm' has its origin at the rotation centre and y along the orbital axis"
    subject = replace(subject_of(result, wanted), meaning=meaning)
    convention = (
        "T_torus_sensor = Rx(alpha) Tz(R) Rz(epsilon) Ry(beta) T_carm_sensor; alpha is the joint 'angular', beta "
        "the joint 'orbital'"
    )
    epsilon, radius = result.axis_non_orthogonality_rad or 0.0, result.major_radius_signed_m
    origins = {
        "orbital": transform(rot_z(epsilon), [0.0, 0.0, radius]),
        "sensor_mount": inverse(result.T_sensor_carm),
    }
    lines = [*facts(result, subject, convention, _UNITS), f"sigma of R and epsilon: {_shape_sigma(result)}"]
    return patch_origins(parse_urdf(_TWO_AXES, Path("c_arm.urdf")), origins), lines


def _shape_sigma(result: CalibrationResult) -> str:
    radius, epsilon = result.sigma.major_radius_m, result.sigma.axis_non_orthogonality_rad
    words = [] if radius is None else [f"{radius * 1e3:.4f} mm"]
    words += [] if epsilon is None else [f"{degrees(epsilon):.5f} deg"]
    words += [f"{quantity} fixed" for quantity in result.fixed]
    return ", ".join(words) or "unknown, the solver gives none"
