"""Static figures for papers."""

import os
from collections.abc import Mapping
from pathlib import Path

from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.report.charts import charts
from carm_kin.report.comparison import comparison_of
from carm_kin.report.marks import Figure
from carm_kin.report.matplotlib_figures import ENDINGS, draw, needs_matplotlib
from carm_kin.report.poses import Joints, poses_of
from carm_kin.report.scene import scene
from carm_kin.results.result import CalibrationResult
from carm_kin.steps import step


@step("draw the figures")
def write_figures(
    result: CalibrationResult,
    recording: Recording,
    folder: str | os.PathLike,
    *,
    joints: Joints = Joints(),
    compared: Mapping[str, CalibrationResult] | None = None,
    truth: CalibrationResult | None = None,
) -> tuple[Path, ...]:
    """Write each figure of the report as SVG and as PNG, and give back the files.

    Raises MissingDependencyError without matplotlib, InputError where the folder cannot be made or written to.
    """
    needs_matplotlib()
    poses = poses_of(result, recording, joints)
    figures: list[Figure] = [scene(result, poses), *charts(result, poses)]
    figures += comparison_of(compared, truth).charts if compared else ()
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / f"{figure.name}{ending}" for figure in figures for ending in ENDINGS]
        for figure in figures:
            draw(figure, [file for file in files if file.stem == figure.name])
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=folder) from None
    return tuple(files)
