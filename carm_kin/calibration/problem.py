"""From a recording to the problem that the two-axis solvers take."""

import difflib

import numpy as np

from carm_kin.errors import InputError
from carm_kin.recording.checks import numbered
from carm_kin.recording.recording import Recording
from solvers.problem import ANGULAR, ORBITAL, Problem


def to_problem(
    recording: Recording, angular: str = "angular", orbital: str = "orbital", sigma_label_rad: float | None = None
) -> Problem:
    """The problem that the two-axis solvers take; `angular` and `orbital` name the joints of the two axes.

    A joint is held through a sweep in which the other one moves, at the sweep's label where that is known.
    Both are free where the sweep or its moving joint is unknown. ``sigma_label_rad`` is the standard deviation of the
    labels, 0 exact; by default what their digits tell (`Recording.sweep_label_sigma`). Raises InputError where
    a third joint moves. Every other joint is taken to stand still in a placement; `Recording.warnings` tells
    where it does not.
    """
    file = recording.source.path if recording.source else None
    held, label = np.full((len(recording), 2), -1), np.full((len(recording), 2), np.nan)
    sigma_label = np.full((len(recording), 2), sigma_label_rad or 0.0)
    for column, (joint, other) in {ANGULAR: (angular, orbital), ORBITAL: (orbital, angular)}.items():
        if joint in recording.prismatic:
            raise InputError(f"joint '{joint}' turns: its values are angles, not lengths", file=file)
        if recording.moving is not None:
            held[:, column] = np.where(recording.moving == other, recording.sweep_number, -1)
        if joint in recording.joints:
            label[:, column] = recording.joints[joint]
            poses = np.flatnonzero(held[:, column] >= 0)
            label[poses, column] = recording.sweep_labels[joint][held[poses, column]]
            if sigma_label_rad is None:
                sigma_label[poses, column] = recording.sweep_label_sigma[joint][held[poses, column]]
    for moving in () if recording.moving is None else numbered(recording.moving)[0]:
        if moving not in ("", angular, orbital):
            close = difflib.get_close_matches(moving, (angular, orbital), 1)
            meant = f"did you mean '{close[0]}'? Otherwise " if close else ""
            raise InputError(
                f"pose {np.argmax(recording.moving == moving)} moves '{moving}', which is neither '{angular}' nor "
                f"'{orbital}': {meant}these poses need the chain's calibration, with --urdf",
                file=file,
                column="moving",
            )
    return Problem(
        recording.p_world_sensor,
        recording.R_world_sensor,
        recording.placement_number,
        held,
        label,
        time_s=recording.time_s,
        sigma_label=sigma_label if np.nan_to_num(sigma_label).any() else None,
    )
