"""An empty matplotlib figure, which is asked for where it is missing."""

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.errors import MissingDependencyError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(width: float, height: float) -> "Figure":
    """An empty figure, inches, which a notebook shows. Raises MissingDependencyError without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        words = "a figure needs the package 'matplotlib': pip install 'carm-kin[figures]'"
        raise MissingDependencyError(words) from None

    class Shown(Figure):
        def _repr_png_(self) -> bytes:
            data = io.BytesIO()
            self.savefig(data, format="png")
            return data.getvalue()

    return Shown(figsize=(width, height), layout="constrained")


def in_space(axes: Any, title: str) -> None:
    """Finish a view of space, in mm: the same scale along all three axes."""
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm", title=title)
    limits = [axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=0.85)
