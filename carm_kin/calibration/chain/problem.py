"""Recordings of a machine as the problem of the chain solver: which joint values are known, read, held or unknown."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from carm_kin.calibration.chain.model import ChainModel
from carm_kin.errors import InputError
from carm_kin.machine.urdf import listing
from carm_kin.recording.recording import Recording
from solvers.chain.problem import KINDS, ChainProblem
from solvers.estimate import Note
from solvers.se3 import transform

SENSOR = "sensor"
"""The column of a recording that names the sensor link of each pose."""

BETWEEN_S = 1e6
"""Time that is put between two recordings, whose clocks differ."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """Recordings taken together."""

    problem: ChainProblem
    placements: tuple[str, ...]
    """(P,) labels of the base placements."""
    notes: tuple[Note, ...]


def sensor_links_of(recordings: Sequence[Recording], sensor_link: str | None) -> tuple[str | None, ...]:
    """The sensor links that the recordings name in their column ``sensor``; first of all ``sensor_link`` where a
    recording has no such column."""
    columns = [recording.metadata.get(SENSOR) for recording in recordings]
    named = [str(name) for column in columns if column is not None for name in column if name]
    return tuple(dict.fromkeys([sensor_link, *named] if any(column is None for column in columns) else named))


def gather(
    recordings: Sequence[Recording], model: ChainModel, sigma: tuple[float | None, ...] = (None,) * KINDS
) -> Gathered:
    """All poses of the recordings as one problem.

    Placements of different recordings are different, but for those with the same label that is not empty. A joint
    that no recording mentions stands at zero. Raises InputError for names that the machine does not have.
    """
    parts = [_one(recording, model, k, len(recordings)) for k, recording in enumerate(recordings)]
    labels = tuple(dict.fromkeys(label for part in parts for label in part.labels))
    held, offset = [], 0
    for part in parts:
        held.append(np.where(part.held >= 0, part.held + offset, -1))
        offset += int(part.held.max(initial=-1)) + 1
    problem = ChainProblem(
        T_world_sensor=np.concatenate([part.T for part in parts]),
        placement=np.concatenate([[labels.index(label) for label in part.labels] for part in parts]).astype(int),
        sensor=np.concatenate([part.sensor for part in parts]),
        held=np.concatenate(held),
        label=np.concatenate([part.label for part in parts]),
        prismatic=model.machine.prismatic,
        sigma=sigma,
        time_s=_times(recordings),
    )
    return Gathered(problem, labels, _notes(model, parts))


def _times(recordings: Sequence[Recording]) -> np.ndarray | None:
    """(N,) on one clock, s, the recordings one `BETWEEN_S` after the other; None where one has no times."""
    times, start = [], 0.0
    for recording in recordings:
        if recording.time_s is None:
            return None
        times.append(recording.time_s - recording.time_s.min(initial=np.inf) + start)
        start = float(times[-1].max(initial=start)) + BETWEEN_S
    return np.concatenate(times)


@dataclass(frozen=True, eq=False)
class _Part:
    T: np.ndarray
    labels: list[str]
    sensor: np.ndarray
    held: np.ndarray
    label: np.ndarray
    in_play: np.ndarray


def _one(recording: Recording, model: ChainModel, number: int, of: int) -> _Part:
    file = recording.source.path if recording.source else None
    if recording.R_world_sensor is None:
        raise InputError("has no orientations (qw, qx, qy, qz), which the chain's calibration needs", file=file)
    moving = np.full(len(recording), "") if recording.moving is None else recording.moving
    mentioned = {*recording.joints, *moving} - {""}
    unknown = sorted(mentioned - set(model.names))
    if unknown:
        problem = f"names the joint {unknown[0]!r}, which the chain does not have; it has {listing(model.names)}"
        raise InputError(problem, file=file)
    for name in sorted(mentioned & set(recording.joints)):
        slides = bool(model.machine.prismatic[model.names.index(name)])
        if slides != (name in recording.prismatic):
            units = ("deg", "mm") if slides else ("mm", "deg")
            problem = f"joint {name!r} {'slides' if slides else 'turns'}: its column is q_{name}_{units[1]}"
            raise InputError(problem, file=file, column=f"q_{name}_{units[0]}")
    sensor = sensor_numbers(recording, model.sensor_links)
    n, J = len(recording), len(model.names)
    held, label = np.full((n, J), -1), np.full((n, J), np.nan)
    in_play = np.isin(model.names, list(mentioned))
    for s in np.unique(sensor):
        in_play[list(model.axes(int(s)))] = True
    for j, name in enumerate(model.names):
        if not in_play[j]:
            held[:, j], label[:, j] = 0, 0.0
            continue
        still = (moving != "") & (moving != name) & (recording.sweep_number >= 0)
        held[:, j] = np.where(still, recording.sweep_number, -1)
        if name in recording.joints:
            label[:, j] = recording.joints[name]
            label[still, j] = recording.sweep_labels[name][recording.sweep_number[still]]
    for s, path in enumerate(model.machine.paths):
        elsewhere = np.ix_(sensor == s, ~np.isin(np.arange(J), path))
        held[elsewhere], label[elsewhere] = 0, 0.0
    names = recording.placement if recording.placement is not None else np.full(n, "")
    labels = [str(label) or (str(number + 1) if of > 1 else "") for label in names]
    return _Part(transform(recording.R_world_sensor, recording.p_world_sensor), labels, sensor, held, label, in_play)


def sensor_numbers(recording: Recording, links: tuple[str, ...]) -> np.ndarray:
    """(N,) which of the ``links`` carries the sensor of each pose. Raises InputError where a pose names none."""
    if SENSOR not in recording.metadata:
        return np.zeros(len(recording), dtype=int)
    column = recording.metadata[SENSOR]
    empty = np.flatnonzero(column == "")
    if empty.size:
        file = recording.source.path if recording.source else None
        problem = f"pose {recording.pose_number[empty[0]]} names no sensor link"
        raise InputError(problem, file=file, column=SENSOR)
    return np.array([links.index(str(name)) for name in column], dtype=int)


def _notes(model: ChainModel, parts: list[_Part]) -> tuple[Note, ...]:
    silent = [name for j, name in enumerate(model.names) if not any(part.in_play[j] for part in parts)]
    if not silent:
        return ()
    return (Note("joints_at_zero", f"no recording mentions {listing(silent)}: taken to stand at zero throughout"),)
