"""Static figures for papers."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from carm_kin.errors import InputError
from carm_kin.recording.formats import RecordingLike, as_recordings
from carm_kin.report.charts import charts
from carm_kin.report.comparison import comparison_of
from carm_kin.report.isocentre import wander_of
from carm_kin.report.marks import Figure
from carm_kin.report.matplotlib_figures import ENDINGS, draw, needs_matplotlib
from carm_kin.report.poses import Joints, poses_of, together
from carm_kin.report.scene import scene
from carm_kin.results.result import ResultLike, as_result
from carm_kin.steps import step


@step("draw the figures")
def write_figures(
    result: ResultLike,
    recording: RecordingLike | Sequence[RecordingLike],
    folder: str | os.PathLike,
    *,
    joints: Joints = Joints(),
    compared: Mapping[str, ResultLike] | None = None,
    truth: ResultLike | None = None,
) -> tuple[Path, ...]:
    """Write each figure of the report as SVG and as PNG, and give back the files.

    The arguments are those of `write_report`. Raises MissingDependencyError without matplotlib, InputError for another
    recording, and where the folder cannot be made or written to.
    """
    needs_matplotlib()
    result = as_result(result)
    poses = poses_of(result, together(as_recordings(recording)), joints)
    wander = wander_of(result)
    figures: list[Figure] = [scene(result, poses), *(wander.charts if wander else ()), *charts(result, poses)]
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
