"""What is to be exported: which transform, between frames of which names, and the facts that go with it."""

import os
import re
from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from carm_kin.errors import InputError, on_one_line
from carm_kin.machine.urdf import UrdfFile
from carm_kin.results.deformation import Deformation
from carm_kin.results.parts import Placement, PlacementSigma
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array, transform

SENSOR_CARM, WORLD_TORUS = "sensor-carm", "world-torus"
TRANSFORMS = (SENSOR_CARM, WORLD_TORUS)

_FRAME = re.compile(r"[A-Za-z][A-Za-z0-9_./-]{0,79}")


@dataclass(frozen=True)
class Wanted:
    """What an export is asked for."""

    transform: str = SENSOR_CARM
    """`SENSOR_CARM`: the C-arm's frame at the rotation centre in the sensor's frame. `WORLD_TORUS`: where the machine
    stands in the tracker's world."""
    placement: str | None = None
    """Label of the base placement, for `WORLD_TORUS`; None where there is one only."""
    parent_frame: str | None = None
    child_frame: str | None = None
    """Names of the two frames in the other program; None: those of the transform."""
    urdf: UrdfFile | str | os.PathLike | None = None
    """The URDF that was calibrated, for an export that writes it."""


@dataclass(frozen=True, eq=False)
class Subject:
    """One transform with its names and what is known of it. Lengths are m, angles rad."""

    T_parent_child: Array
    """(4, 4)."""
    parent: str
    child: str
    meaning: str
    """Which point and which axes the child frame has."""
    zero: str
    """Where the turn about the child's axis comes from."""
    sigma_translation: Array | None
    """(3,) in the parent's frame."""
    sigma_axis: float | None
    """Of the direction of the child's axis."""
    axis: str
    deformation: Deformation | None = None
    """How the child moves in the parent with the angles; None where it does not, as far as is known."""


def subject_of(result: CalibrationResult, wanted: Wanted) -> Subject:
    """The transform that is wanted. Raises InputError where the result does not hold it, or a name is no frame's."""
    if wanted.transform not in TRANSFORMS:
        raise InputError(f"no transform '{wanted.transform}'; choose from {', '.join(TRANSFORMS)}")
    if wanted.transform == WORLD_TORUS:
        subject = _torus(result, wanted.placement)
    elif wanted.placement is not None:
        raise InputError(f"a placement belongs to the transform '{WORLD_TORUS}'; '{SENSOR_CARM}' is the same in all")
    else:
        subject = _carm(result)
    parent, child = wanted.parent_frame or subject.parent, wanted.child_frame or subject.child
    for name in (parent, child):
        if not _FRAME.fullmatch(name):
            raise InputError(f"'{name}' is no name of a frame: a letter, then letters, digits and _ . / - are allowed")
    if parent == child:
        raise InputError(f"the parent and the child frame are both named '{parent}'")
    return replace(subject, parent=parent, child=child)


def _carm(result: CalibrationResult) -> Subject:
    sigma = result.sigma
    if result.offset_sensor_pivot_m is None:
        raise InputError(f"a result of the solver '{result.solver}' holds no offset to export; use 'kinematic'")
    if result.T_sensor_carm is None:
        T = transform(np.eye(3), result.offset_sensor_pivot_m)
        words = "the child's origin is the pivot; its axes are the sensor's, since a point has none"
        return Subject(T, "sensor", "pivot", words, "none", sigma.offset_sensor_pivot_m, None, "")
    return Subject(
        result.T_sensor_carm,
        "sensor",
        "carm",
        "the child's origin is the rotation centre of the C-arm, its y axis the orbital axis; "
        "at beta = 0 its z axis points along the common perpendicular of both axes",
        _zero("beta", result.orbital_referenced),
        sigma.offset_sensor_pivot_m,
        _length(sigma.orbital_axis_sensor),
        "y",
        result.deformation,
    )


def _torus(result: CalibrationResult, label: str | None) -> Subject:
    placement, sigma = _placement(result, label)
    if placement.T_world_torus is None:
        raise InputError(f"a result of the solver '{result.solver}' holds no complete chain; use 'kinematic'")
    return Subject(
        placement.T_world_torus,
        "world",
        "torus",
        "the child's origin is the centre of the circle on which the rotation centre moves, its x axis the angular "
        "axis; its z axis points to the rotation centre at alpha = 0",
        _zero("alpha", placement.referenced),
        sigma and sigma.torus_center_world_m,
        _length(sigma.angular_axis_world) if sigma else None,
        "x",
    )


def _placement(result: CalibrationResult, label: str | None) -> tuple[Placement, PlacementSigma | None]:
    labels = [placement.label for placement in result.placements]
    valid = ", ".join(f"'{name}'" for name in labels)
    if label is None and len(labels) > 1:
        raise InputError(f"the base stood in {len(labels)} placements; say which one: {valid}")
    if label is not None and label not in labels:
        raise InputError(f"no placement '{label}'; the result has {valid}")
    k = labels.index(label) if label is not None else 0
    return result.placements[k], result.sigma.placements[k] if result.sigma.placements else None


def _zero(angle: str, referenced: bool) -> str:
    if referenced:
        return f"{angle} = 0 is where the labels of the recording say"
    return f"no label tells where {angle} is zero: it is zero at the first pose, by convention"


def _length(sigma: Array | None) -> float | None:
    return None if sigma is None else float(np.linalg.norm(sigma))


def facts(result: CalibrationResult, subject: Subject, convention: str, units: str) -> tuple[str, ...]:
    """What every export says of itself, one printable line a fact."""
    lines = (
        f"carm-kin {result.provenance.versions.get('carm-kin', '')}: calibration of a C-arm by the solver "
        f"'{result.solver}'",
        f"convention: {convention}",
        f"meaning: {subject.meaning}",
        f"zero: {subject.zero}",
        f"units: {units}",
        f"sigma: {sigma_words(subject)}",
        *((f"deformation: {deformation_words(subject.deformation)}",) if subject.deformation else ()),
        *facts_of_origin(result),
    )
    return tuple(on_one_line(line) for line in lines)


def facts_of_origin(result: CalibrationResult) -> tuple[str, ...]:
    """Poses, residuals, input and date."""
    residuals, source = result.residuals, result.provenance
    return (
        f"poses: {result.used} of {result.poses} used, residuals {residuals.translation_rms_m * 1e3:.4f} mm rms",
        f"input: {source.input_name or 'no file'}, sha256 {source.input_sha256 or 'unknown'}",
        f"date: {source.date}",
    )


def sigma_words(subject: Subject) -> str:
    """One standard deviation of the translation and of the axis, in mm and degrees."""
    if subject.sigma_translation is None:
        return "unknown, the solver gives none"
    x, y, z = subject.sigma_translation * 1e3
    words = f"one standard deviation of the translation x {x:.4f}, y {y:.4f}, z {z:.4f} mm"
    if subject.sigma_axis is None:
        return words
    return f"{words}; of the direction of the {subject.axis} axis {degrees(subject.sigma_axis):.5f} deg"


def deformation_words(bent: Deformation) -> str:
    """What a rigid transform leaves out of a C that bends."""
    return (
        f"the C bends: the rigid transform is that of a deformation of mean zero over {bent.ranges}, over which the "
        f"rotation centre walks up to {bent.walk_m * 1e3:.2f} mm in the sensor's frame; the export json and the result "
        "itself have it over the angles"
    )


def in_xml_comment(text: str) -> str:
    """The text as it may stand in an XML comment, which must not hold two hyphens in a row."""
    return re.sub(r"-(?=-)", "- ", on_one_line(text)).removesuffix("-")
