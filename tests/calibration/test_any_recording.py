"""Whatever is recorded, there is a result of finite numbers, a refusal, or an InputError; no other exception ever."""

import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import carm_kin
import solvers
from carm_kin.errors import InputError, RefusedError
from carm_kin.recording.recording import Recording
from helpers.simulated import machine
from solvers import loci

KINDS = ("two axes", "two axes", "one axis", "no turn", "at random", "still")
SIZES = (0, 1, 2, 3, 5, 6, 7, 12, 15, 20, 40)
SCALES = (1.0, 1.0, 1.0, 1e-9, 1e-3, 1e3, 1e9)
ARCS = (0.0, 1e-3, 0.02, 0.2, 1.5, 6.3)
NOISES = (0.0, 1e-9, 1e-4, 1e-2)
LEVELS = (0.0, 1e3, 1e9)
JOINTS = ("angular", "orbital")


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Poses of every kind and size, repeated or shuffled, their labels at random."""
    n, kind = draw(st.sampled_from(SIZES)), draw(st.sampled_from(KINDS))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    arcs = [draw(st.sampled_from(ARCS)) for _ in JOINTS]
    angles = arcs * rng.random((n, 2))
    p, R = poses(kind, angles, rng)
    p = p + draw(st.sampled_from(NOISES)) * rng.normal(size=p.shape)
    turn = draw(st.sampled_from(NOISES)) * rng.normal(size=p.shape)
    R = (Rotation.from_matrix(R) * Rotation.from_rotvec(turn)).as_matrix() if n else R
    p = p * draw(st.sampled_from(SCALES)) + draw(st.sampled_from(LEVELS))
    if n and draw(st.booleans()):
        again = rng.integers(n, size=n)
        p, R, angles = p[again], R[again], angles[again]
    orientations = draw(st.integers(0, 9)) > 0
    return Recording(p, R if orientations else None, **draw(labels(n, angles, rng)))


def poses(kind: str, angles: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and orientations (N, 3, 3) of a kind of motion."""
    n = len(angles)
    if n == 0:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    p, R = machine(int(rng.integers(9)), R=float(rng.choice([0.0, 0.1]))).poses(angles, np.zeros(n, dtype=int))
    if kind == "one axis":
        R = Rotation.from_rotvec(angles[:, :1] * [0, 0, 1]).as_matrix()
        p = R @ np.array([0.1, 0.2, 0.3])
    elif kind == "no turn":
        p, R = rng.normal(size=(n, 3)), np.repeat(R[:1], n, axis=0)
    elif kind == "at random":
        p, R = rng.normal(size=(n, 3)), Rotation.from_quat(rng.normal(size=(n, 4))).as_matrix()
    elif kind == "still":
        p, R = np.repeat(p[:1], n, axis=0), np.repeat(R[:1], n, axis=0)
    return p, R


@st.composite
def labels(draw: st.DrawFn, n: int, angles: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Placements of few poses, or sweeps whose labels contradict the motion, or nothing."""
    what = draw(st.sampled_from(("nothing", "placements", "sweeps", "sweeps at placements")))
    if what == "nothing":
        return {}
    if what == "placements":
        return {"placement": rng.integers(3, size=n).astype(str)}
    sweep = np.sort(rng.integers(4, size=n))
    moving = rng.integers(2, size=4)[sweep]
    held = 1 - moving
    known = np.full((n, 2), np.nan)
    known[np.arange(n), held] = rng.normal(size=4)[sweep]
    if draw(st.booleans()):
        known[np.arange(n), moving] = angles[np.arange(n), moving]
    told = {
        "sweep": sweep.astype(str),
        "moving": np.array(JOINTS)[moving],
        "joints": dict(zip(JOINTS, known.T, strict=True)),
    }
    return told | ({"placement": (sweep // 2).astype(str)} if what == "sweeps at placements" else {})


@cache
def saved() -> carm_kin.CalibrationResult:
    """A calibration for `check` and `virtual_centre`."""
    angles = np.random.default_rng(0).uniform(-1, 1, (40, 2))
    return carm_kin.calibrate(Recording(*machine(1).poses(angles, np.zeros(40, dtype=int))))


def by(solver: str, **options: Any) -> Callable[[Recording], Any]:
    return lambda recording: carm_kin.calibrate(recording, solver, **options)


WAYS: dict[str, Callable[[Recording], Any]] = {
    **{name: by(name) for name in solvers.solver_names()},
    **{f"locus {name}": by("direct", locus=name) for name in loci.by_option(loci.locus_names())},
    "published gauge": by("direct", gauge="published"),
    "noise given": by("kinematic", sigma_t_m=1e-3, sigma_r_rad=1e-3),
    "cross_validate": lambda recording: carm_kin.cross_validate(recording, 2),
    "check": lambda recording: carm_kin.check(saved(), recording),
    "virtual_centre": lambda recording: carm_kin.virtual_centre(saved(), recording),
    "chain": lambda recording: carm_kin.calibrate_chain(recording, "mobile_isocentric", free="axes"),
}
NUMBERS = ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "centre_carm_m", "centre_world_m")


def verdict(way: str, recording: Recording) -> str:
    """The status. The result's numbers are finite, and it says nothing with a number of many digits."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            result = WAYS[way](recording)
        except InputError as error:
            return f"input: {error}"
        except RefusedError as error:
            return error.code
    for name in NUMBERS:
        value = getattr(result, name, None)
        assert value is None or np.isfinite(value).all(), name
    covariance = getattr(result, "covariance", None)
    assert covariance is None or np.isfinite(covariance.matrix).all()
    notes = [*getattr(result, "warnings", ()), *filter(None, [getattr(result, "refusal", None)])]
    long = [word for note in notes for word in note.message.split() if len(word.strip("-.0123456789")) < len(word) - 20]
    assert not long
    return getattr(result, "status", "ok")


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=15)
@given(recordings())
def test_any_recording_has_a_verdict(way, recording):
    assert verdict(way, recording)


@pytest.mark.study
@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=400)
@given(recordings())
def test_many_recordings_have_a_verdict(way, recording):
    assert verdict(way, recording)
