"""Stops of the C: their frames averaged to one pose each, with what the frames tell of its uncertainty.

Within a stop, frames differ by the tracker's fast noise only, and neighbouring frames agree more than noise would. With
s² the variance of a frame an axis and tau = 1 + 2 sum rho_k the sum of its correlations over time, the mean of m frames
has the variance ``v = s² tau / m``. What is the same in all frames of a stop (the tracker's error at that place, flex)
no frame shows: it stays in the noise that the solver estimates from stop to stop, and does not shrink with m.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.checks import first_known
from carm_kin.recording.formats._folder import FILE
from carm_kin.recording.intake import Dropped
from carm_kin.recording.recording import Recording
from solvers.estimate import Estimate
from solvers.problem import Problem
from solvers.se3 import Array, exp_so3, log_so3, project_so3

STILL_M, STILL_RAD = 2e-3, float(np.radians(0.3))
"""Means of the frames before and after a moment that differ by less show no motion: far above the noise of such means,
far below what a C moves in the time."""
HALF_S, HALF, MOST_HALF = 0.3, 8, 300
"""Seconds, least and most frames of these means."""
LEAST_FRAMES = 10
"""A shorter rest is no stop; a stop of fewer frames takes the variance of all stops together."""
WIDE = 3.0
"""A rest that spans more than this many times what shows motion is a slow motion."""
UNCORRELATED = 0.05
"""Correlations are summed until the first below this."""
OUTSIDE = "not in a stop of the C"


def at_stations(recording: Recording) -> Recording:
    """One pose for every stop of the C, with `Recording.variance`.

    Every file of a folder is a stop; else the stops are found, within the sweeps and placements. The poses of a result
    are then numbered by stop. Raises InputError where there is no stop, or the C moved during a file.
    """
    if recording.R_world_sensor is None:
        raise InputError("--stations needs orientations", file=_file(recording))
    by_file = recording.sweep is None and FILE in recording.metadata
    station = _of_files(recording) if by_file else _found(recording, recording.R_world_sensor)
    kept = np.flatnonzero(station >= 0)
    if not kept.size:
        raise InputError(
            f"--stations: the C stands still nowhere for {LEAST_FRAMES} frames; leave it out", file=_file(recording)
        )
    first, number = np.unique(station[kept], return_index=True, return_inverse=True)[1:]
    averaged = _averaged(recording, kept, kept[first], number)
    intakes = list(recording.intakes)
    if intakes:
        dropped = (*intakes[-1].dropped, Dropped(OUTSIDE, len(recording) - len(kept)))
        less = intakes[-1].kept - len(recording) + len(kept)
        intakes[-1] = replace(intakes[-1], kept=less, dropped=dropped, stations=len(first))
    return replace(averaged, intakes=tuple(intakes))


def refitted(problem: Problem, estimate: Estimate, variance: Array) -> Problem:
    """The problem with the noise of each pose (N, 2) over the common one: ``sqrt(b + v)`` over its root mean square.

    b is the part of the estimated variance that the frames of the stops do not explain.
    """
    scale = np.ones((2, len(problem)))
    for kind, sigma in enumerate((estimate.sigma_t, estimate.sigma_r)):
        v = variance[:, kind]
        total = max((sigma or 0.0) ** 2 - v.mean(), 0.0) + v
        if total.mean() > 0:
            scale[kind] = np.sqrt(np.maximum(total / total.mean(), 1e-6))
    return replace(problem, scale=scale)


def _file(recording: Recording) -> str | None:
    return recording.source.path if recording.source else None


def _of_files(recording: Recording) -> np.ndarray:
    """(N,) the number of each frame's file. Raises InputError where the C moved in one."""
    files, number = np.unique(recording.metadata[FILE].astype(str), return_inverse=True)
    for k, name in enumerate(files):
        span = float(np.ptp(recording.p_world_sensor[number == k], axis=0).max())
        if span > WIDE * STILL_M:
            problem = f"--stations: the sensor moves by {span * 1e3:.3g} mm in '{name}'; each file must be one stop"
            raise InputError(problem, file=_file(recording))
    return number


def _found(recording: Recording, R: Array) -> np.ndarray:
    """(N,) the number of the stop of each frame, -1 in motion."""
    station, count, half = np.full(len(recording), -1), 0, _half(recording)
    for part in _parts(recording):
        turns = R[part].reshape(-1, 9) / (np.sqrt(2) * STILL_RAD)
        x = np.column_stack([recording.p_world_sensor[part] / STILL_M, turns])
        for start, stop in _rests(x, half):
            station[part[start:stop]] = count
            count += 1
    return station


def _parts(recording: Recording) -> Iterator[np.ndarray]:
    """The frames that follow each other in one sweep and placement."""
    change = np.diff(recording.sweep_number) != 0
    change |= np.diff(recording.placement_number) != 0
    yield from np.split(np.arange(len(recording)), np.flatnonzero(change) + 1)


def _rests(x: Array, half: int) -> Iterator[tuple[int, int]]:
    """First and last frame, exclusive, of every rest of a path (n, 12) of positions and rotations over what shows
    motion, judged from the means of ``half`` frames before and after."""
    if len(x) < 2 * half + LEAST_FRAMES:
        return
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x - x[0], axis=0)])
    mean = (total[half:] - total[:-half]) / half
    step = mean[half:] - mean[:-half]
    still = (np.linalg.norm(step[:, :3], axis=1) <= 1) & (np.linalg.norm(step[:, 3:], axis=1) <= 1)
    edge = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    for start, stop in zip(edge[::2] + half, edge[1::2] + half, strict=True):
        wide = np.ptp(mean[start : max(start + 1, stop - half), :3], axis=0).max()
        if stop - start >= LEAST_FRAMES and wide <= WIDE:
            yield int(start), int(stop)


def _half(recording: Recording) -> int:
    """Frames in `HALF_S`, at least `HALF`."""
    step = 0.0 if recording.time_s is None or len(recording) < 2 else float(np.median(np.diff(recording.time_s)))
    return HALF if step <= 0 else int(np.clip(round(HALF_S / step), HALF, MOST_HALF))


def _averaged(recording: Recording, kept: np.ndarray, first: np.ndarray, number: np.ndarray) -> Recording:
    """The means of the ``kept`` frames by stop; labels are those of the ``first`` frame of each."""
    R = recording.R_world_sensor
    assert R is not None
    count = np.bincount(number)
    p = _means(recording.p_world_sensor[kept], number, count)
    middle = project_so3(_means(R[kept].reshape(-1, 9), number, count).reshape(-1, 3, 3))
    for _ in range(2):
        turn = log_so3(np.swapaxes(middle[number], 1, 2) @ R[kept])
        middle = middle @ exp_so3(_means(turn, number, count))
    turn = log_so3(np.swapaxes(middle[number], 1, 2) @ R[kept])
    variance = [_variance(e, number, count) for e in (recording.p_world_sensor[kept] - p[number], turn)]
    one = recording.select(first)
    time_s = recording.time_s
    return replace(
        one,
        p_world_sensor=p,
        R_world_sensor=middle,
        time_s=None if time_s is None else _means(time_s[kept, None], number, count)[:, 0],
        joints={joint: _mean_of_known(values[kept], number, len(count)) for joint, values in recording.joints.items()},
        metadata={**one.metadata, "frames": count.astype(str)},
        variance=np.column_stack(variance),
        pose_number=np.arange(len(count)),
    )


def _means(values: Array, number: np.ndarray, count: np.ndarray) -> Array:
    """(K, D) means of the rows (M, D) by stop."""
    sums = np.stack([np.bincount(number, column) for column in values.T], axis=1)
    return sums / count[:, None]


def _mean_of_known(values: Array, number: np.ndarray, stations: int) -> Array:
    """(K,) means of the known values by stop, NaN where there is none; a value that is the same in all stays exact."""
    known = np.isfinite(values)
    first = first_known(values, number, stations)
    sums = np.bincount(number, np.where(known, values - first[number], 0.0), stations)
    return first + sums / np.maximum(np.bincount(number, known, stations), 1)


def _variance(error: Array, number: np.ndarray, count: np.ndarray) -> Array:
    """(K,) variance an axis of the mean of each stop, from the errors (M, 3) of its frames against it."""
    squares = np.bincount(number, (error**2).sum(axis=1)) / 3
    tau = _correlation_time(error, number, float((count**2).sum() / count.sum()))
    pooled = squares.sum() / max((count - np.minimum(count, tau)).sum(), 1.0)
    own = squares / np.maximum(count - tau, 1.0)
    frame = np.where(count >= max(LEAST_FRAMES, 2 * tau), own, pooled)
    return frame / np.maximum(count / tau, 1.0)


def _correlation_time(error: Array, number: np.ndarray, frames: float) -> float:
    """``tau`` of stops of so many frames.

    The errors are against the stop's own mean, whose variance V their covariances at every lag lack; it is put back.
    """
    covariance = list(_covariances(error, number, int(frames) // 2))
    tau = 1.0
    for _ in range(10):
        lacking = covariance[0] * tau / max(frames - tau, 1.0)
        rho = (np.array(covariance) + lacking) / max(covariance[0] + lacking, 1e-300)
        last = int(np.argmax(rho < UNCORRELATED)) if (rho < UNCORRELATED).any() else len(rho)
        tau = min(1 + 2 * float(rho[1:last].sum()), frames / 2)
    return tau


def _covariances(error: Array, number: np.ndarray, most: int) -> Iterator[float]:
    """Of frames of a stop that are 0, 1, 2 ... apart, up to the first that is not above 0."""
    yield float((error**2).sum(axis=1).mean())
    for lag in range(1, most):
        same = number[lag:] == number[:-lag]
        if not same.any():
            return
        covariance = float((error[lag:][same] * error[:-lag][same]).sum(axis=1).mean())
        if covariance <= 0:
            return
        yield covariance
