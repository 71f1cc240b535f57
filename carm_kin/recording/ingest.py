"""From what a file says to a recording: the same steps for every format, each frame kept or counted.

The tool and its reference are chosen, the conventions of the file applied, frames without a pose dropped by reason,
rotations rounded by the file projected, the reference composed, ``T_reference_tool = inv(T_tracker_reference)
T_tracker_tool``, and frames that repeat the one before dropped.
"""

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording import ingest_checks
from carm_kin.recording.checks import repeated
from carm_kin.recording.declarations import EULER_ORDERS, UNITS_M, Declarations
from carm_kin.recording.intake import Dropped, Intake
from carm_kin.recording.raw import Raw, Track
from carm_kin.recording.recording import ROTATION_TOLERANCE, Recording
from solvers.se3 import Array, project_so3, rotation_from_quat_wxyz

QUATERNION_TOLERANCE = 1e-3
"""How far the norm of a quaternion may be from 1."""
PROJECTED = 1e-9
"""A rotation matrix that is off by more than this is projected."""
ABSURD = 1e20
"""Greater numbers mean that there is none; NDI writes -3.7e28."""
GOOD = ("", "OK")
"""What a file says of a frame that counts."""
REPEATED = "identical to the frame before"
CUT_OFF = "cut off"
_MIRROR = np.array([1.0, 1.0, -1.0])
"""From a left-handed frame to a right-handed one and back: z is negated."""


@dataclass(frozen=True, eq=False)
class Poses:
    """One tool's frames, in metres and right-handed; the identity where there is a reason to drop the frame."""

    p: Array
    R: Array
    reason: np.ndarray
    """(N,) str, "" where the frame is kept."""
    projected: np.ndarray
    """(N,) bool."""


def ingest(raw: Raw, declared: Declarations, format: str) -> Recording:
    """The recording of one tool of a file.

    Raises InputError that names the option where the file is silent, or where no frame is left.
    """
    try:
        return _ingested(raw, declared, format)
    except InputError as error:
        raise InputError(str(error), file=raw.source.path) from None


def _ingested(raw: Raw, declared: Declarations, format: str) -> Recording:
    if not len(raw):
        raise InputError("the file holds no whole frame")
    tool, reference = _chosen(raw, declared)
    track = raw.tracks[tool]
    poses = _poses(track, raw, declared)
    if raw.time_s is not None:
        _mark(poses.reason, ~np.isfinite(raw.time_s), "without a time")
    poses = _without_repeated(poses)
    if reference is not None:
        poses = _relative(poses, _poses(raw.tracks[reference], raw, declared))
    if declared.invert:
        p = -np.einsum("nji,nj->ni", poses.R, poses.p)
        poses = replace(poses, p=p, R=np.swapaxes(poses.R, 1, 2))
    kept = np.flatnonzero(poses.reason == "")
    intake = _intake(raw, poses, kept, tool, declared.reference or track.parent, declared, format)
    if not kept.size:
        raise InputError(f"no pose of '{tool}' is left of {intake.frames} frames: {intake.in_words()}")
    recording = Recording(
        poses.p[kept],
        poses.R[kept],
        time_s=None if raw.time_s is None else raw.time_s[kept],
        metadata={name: values[kept] for name, values in raw.metadata.items()},
        missing=intake.frames - len(kept),
        pose_number=kept,
        source=raw.source,
        intakes=(intake,),
    )
    return replace(recording, notes=(*raw.notes, *ingest_checks.notes_of(recording, raw, declared)))


def applied(recording: Recording, declared: Declarations) -> Recording:
    """A recording whose file states its own conventions, inverted or mirrored as declared.

    Raises InputError for an option that such a file has no use for.
    """
    for option in ("tool", "reference", "unit", "quaternion", "euler"):
        if getattr(declared, option) is not None:
            file = recording.source.path if recording.source else None
            raise InputError(
                f"--{option}: this format states its own conventions and one sensor; leave it out", file=file
            )
    p, R = recording.p_world_sensor, recording.R_world_sensor
    if declared.left_handed:
        p, R = p * _MIRROR, None if R is None else R * np.outer(_MIRROR, _MIRROR)
    if declared.invert:
        if R is None:
            raise InputError("--invert needs orientations, which the recording has not")
        p, R = -np.einsum("nji,nj->ni", R, p), np.swapaxes(R, 1, 2)
    intakes = tuple(replace(one, stated=declared.stated()) for one in recording.intakes)
    return replace(recording, p_world_sensor=p, R_world_sensor=R, intakes=intakes)


def _chosen(raw: Raw, declared: Declarations) -> tuple[str, str | None]:
    """The names of the tool and of the reference to compose, None where the poses are already relative to it."""
    names = list(raw.tracks)
    reference = declared.reference
    if reference is not None and reference not in {track.parent for track in raw.tracks.values()}:
        reference = named("reference", reference, raw.tracks)
    others = [name for name in names if name != reference]
    if declared.tool is not None:
        tool = named("tool", declared.tool, raw.tracks)
    elif len(others) == 1:
        tool = others[0]
    else:
        counts = "; ".join(f"{name} ({n} frames)" for name, n in _seen(raw))
        raise InputError(f"the file has {len(others)} tools; say with --tool which one is fixed to the C: {counts}")
    if tool == reference:
        raise InputError(f"--tool and --reference both name '{tool}'; they must differ")
    if reference is None or raw.tracks[tool].parent == reference:
        return tool, None
    if reference not in raw.tracks:
        parents = {raw.tracks[tool].parent, ""} - {""}
        raise InputError(f"--reference: '{tool}' is not given relative to '{reference}', only to {', '.join(parents)}")
    if raw.tracks[tool].parent != raw.tracks[reference].parent:
        frames = f"'{raw.tracks[tool].parent}' and '{raw.tracks[reference].parent}'"
        raise InputError(f"--reference: '{tool}' and '{reference}' are given in different frames, {frames}")
    return tool, reference


def named(option: str, name: str, tracks: Mapping[str, object]) -> str:
    """The tool of that name, in any case, or the only one whose name holds it. Raises InputError that lists them."""
    for fits in (str.__eq__, lambda a, b: a.lower() == b.lower(), lambda a, b: b.lower() in a.lower()):
        found = [known for known in tracks if fits(known, name)]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"--{option} '{name}' fits several tools: {', '.join(found)}")
    close = difflib.get_close_matches(name, tracks, 1)
    meant = f" did you mean '{close[0]}'?" if close else ""
    raise InputError(f"--{option}: no tool '{name}';{meant} the file has {', '.join(tracks) or 'none'}")


def _seen(raw: Raw) -> Iterator[tuple[str, int]]:
    """Every tool and in how many frames the file has numbers for it and calls them good."""
    for name, track in raw.tracks.items():
        seen = np.isfinite(track.position).all(axis=1) & track.position.any(axis=1)
        if track.status is not None:
            seen &= np.isin(track.status, GOOD)
        yield name, int(seen.sum())


def _poses(track: Track, raw: Raw, declared: Declarations) -> Poses:
    """The frames of a track in our conventions, with the reasons to drop some."""
    n = len(track)
    flat = track.rotation.reshape(n, -1)
    reason = np.full(n, "", object) if track.status is None else np.where(np.isin(track.status, GOOD), "", track.status)
    finite = np.all(np.abs(flat) < ABSURD, axis=1) & np.all(np.abs(track.position) < ABSURD, axis=1)
    _mark(reason, ~finite, "without numbers")
    at_zero = np.all(track.position == 0, axis=1)
    if track.rotation.shape[1:] != (3,):
        _mark(reason, at_zero & np.all(flat == 0, axis=1), "all zero")
    rotation = np.where(np.expand_dims(reason == "", tuple(range(1, track.rotation.ndim))), track.rotation, np.nan)
    R, no_rotation, projected = _rotations(rotation, raw, declared)
    _mark(reason, no_rotation, "not a rotation")
    _mark(reason, at_zero & np.all(np.eye(3) == R, axis=(1, 2)), "identity placeholder")
    p = track.position * _scale(raw, declared)
    left_handed = raw.left_handed if declared.left_handed is None else declared.left_handed
    if left_handed is None:
        raise InputError("the file does not tell the handedness of its frames; say it: --left-handed or --right-handed")
    if left_handed:
        p, R = p * _MIRROR, R * np.outer(_MIRROR, _MIRROR)
    kept = reason == ""
    return Poses(np.where(kept[:, None], p, 0.0), np.where(kept[:, None, None], R, np.eye(3)), reason, projected & kept)


def _mark(reason: np.ndarray, frames: np.ndarray, why: str) -> None:
    """Give the frames the reason where they have none yet."""
    reason[frames & (reason == "")] = why


def _scale(raw: Raw, declared: Declarations) -> float:
    unit = declared.unit or raw.unit
    if unit is None:
        raise InputError("the file does not tell the unit of its positions; say it: --unit mm, cm or m")
    return UNITS_M[unit]


def _rotations(rotation: Array, raw: Raw, declared: Declarations) -> tuple[Array, np.ndarray, np.ndarray]:
    """(N, 3, 3) rotations, the identity where a row is NaN or no rotation; masks of the latter and of the projected."""
    known = np.isfinite(rotation.reshape(len(rotation), -1)).all(axis=1)
    R = np.tile(np.eye(3), (len(rotation), 1, 1))
    bad, projected = np.zeros(len(rotation), dtype=bool), np.zeros(len(rotation), dtype=bool)
    if rotation.shape[1:] == (4,):
        order = declared.quaternion or raw.quaternion
        if order is None:
            raise InputError("the file does not tell the order of its quaternions; say it: --quaternion wxyz or xyzw")
        quat_wxyz = rotation if order == "wxyz" else np.roll(rotation, 1, axis=1)
        bad = known & (np.abs(np.linalg.norm(rotation, axis=1) - 1) > QUATERNION_TOLERANCE)
        R[known & ~bad] = rotation_from_quat_wxyz(quat_wxyz[known & ~bad])
    elif rotation.shape[1:] == (3,):
        R[known] = _of_euler(rotation[known], declared.euler or raw.euler)
    else:
        error = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
        mirrored = np.linalg.det(np.nan_to_num(rotation)) < 0
        bad = known & ((error > ROTATION_TOLERANCE) | mirrored)
        projected = known & ~bad & (error > PROJECTED)
        R[known & ~bad] = rotation[known & ~bad]
        R[projected] = project_so3(R[projected])
    return R, bad, projected


def _of_euler(xyz_deg: Array, order: str | None) -> Array:
    """(M, 3, 3) of the angles (M, 3) about x, y and z."""
    if order is None:
        orders = ", ".join(EULER_ORDERS)
        raise InputError(f"the file does not tell the order of its Euler angles; say it with --euler: {orders}")
    from scipy.spatial.transform import Rotation

    columns = ["XYZ".index(axis) for axis in order]
    return Rotation.from_euler(order, xyz_deg[:, columns], degrees=True).as_matrix()


def _without_repeated(poses: Poses) -> Poses:
    """Frames in which the tracker had nothing new to say of the tool, marked."""
    kept = np.flatnonzero(poses.reason == "")
    again = np.zeros(len(poses.reason), dtype=bool)
    again[kept] = repeated(poses.p[kept], poses.R[kept])
    _mark(poses.reason, again, REPEATED)
    return poses


def _relative(tool: Poses, reference: Poses) -> Poses:
    """``inv(T_tracker_reference) T_tracker_tool``, frame by frame."""
    lost = np.flatnonzero((reference.reason != "") & (tool.reason == ""))
    tool.reason[lost] = [f"reference {why}" for why in reference.reason[lost]]
    p = np.einsum("nji,nj->ni", reference.R, tool.p - reference.p)
    return Poses(p, np.swapaxes(reference.R, 1, 2) @ tool.R, tool.reason, tool.projected | reference.projected)


def _intake(
    raw: Raw, poses: Poses, kept: np.ndarray, tool: str, reference: str, declared: Declarations, format: str
) -> Intake:
    why, count = np.unique(poses.reason[poses.reason != ""].astype(str), return_counts=True)
    dropped = [Dropped(str(w), int(c)) for w, c in sorted(zip(why, count, strict=True), key=lambda x: -x[1])]
    return Intake(
        format=format,
        tool=tool,
        reference=reference,
        stated=declared.stated(),
        frames=len(raw) + raw.cut_off,
        kept=len(kept),
        dropped=(*dropped, Dropped(CUT_OFF, raw.cut_off)),
        projected=int(poses.projected[kept].sum()),
    )
