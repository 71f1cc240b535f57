"""The options `--report` and `--figures`, and what they write."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carm_kin.cli.arguments import writable
from carm_kin.cli.output import written
from carm_kin.errors import InputError

if TYPE_CHECKING:
    from carm_kin.recording.recording import Recording
    from carm_kin.results.result import CalibrationResult


@dataclass(frozen=True)
class ReportOptions:
    """Where the page and the static figures go."""

    page: Path | None
    figures: Path | None

    def check(self) -> None:
        """Raise InputError where something could not be written, before the work starts."""
        if self.page is not None:
            writable(self.page)
        if self.figures is not None and self.figures.exists() and not self.figures.is_dir():
            raise InputError("is a file; --figures takes a folder", file=self.figures)

    def write(
        self,
        result: "CalibrationResult",
        recordings: "Sequence[Recording]",
        joints: tuple[str, str] = ("angular", "orbital"),
        compared: "Mapping[str, CalibrationResult] | None" = None,
        truth: "CalibrationResult | None" = None,
    ) -> None:
        """Write what was asked for; ``joints`` are the names of the two axes in the recordings."""
        if self.page is None and self.figures is None:
            return
        from carm_kin.report import Joints, together, write_figures, write_report

        poses, names = together(recordings), Joints(*joints)
        if self.page is not None:
            write_report(result, poses, self.page, joints=names, compared=compared, truth=truth)
            written(self.page)
        if self.figures is not None:
            for file in write_figures(result, poses, self.figures, joints=names, compared=compared, truth=truth):
                written(file)


def report_options(
    report: Annotated[Path | None, typer.Option(help="Write a page about the result here, one HTML file.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Folder for the page's figures as SVG and PNG.")] = None,
) -> ReportOptions:
    """The options. Raises MissingDependencyError where figures cannot be drawn."""
    if figures is not None:
        from carm_kin.report.matplotlib_figures import needs_matplotlib

        needs_matplotlib()
    return ReportOptions(report, figures)
