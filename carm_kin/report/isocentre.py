"""The wander of the rotation centre over both angles, as a picture."""

from pathlib import Path

import numpy as np

from carm_kin.report import static
from carm_kin.results.isocentre_result import Isocentre

STEPS = 60


def draw_isocentre(found: Isocentre, path: Path) -> None:
    """Draw the shift of the rotation centre in the sensor's frame over the calibrated range: its length and components.

    Raises InputError for another extension than those of `static.FORMATS`, MissingDependencyError without matplotlib.
    """
    static.check_figure(path)
    bent = found.deformation
    assert bent is not None
    alpha, beta = (np.linspace(x[0], x[1], STEPS) for x in (found.alpha_range_rad, found.beta_range_rad))
    pairs = np.repeat(alpha, STEPS), np.tile(beta, STEPS)
    shift_mm = (bent.shift_m(*pairs) * 1e3).reshape(STEPS, STEPS, 3)
    length, degrees = np.linalg.norm(shift_mm, axis=2), (np.degrees(alpha), np.degrees(beta))
    drawn = static.figure(7.0, 5.6)
    panels = drawn.subplots(2, 2, sharex=True, sharey=True)
    shown = [("length", length), *((axis, shift_mm[..., k]) for k, axis in enumerate("xyz"))]
    most = max(float(length.max()), 1e-6)
    for panel, (name, values) in zip(np.ravel(panels), shown, strict=True):
        scale = {"cmap": "viridis", "vmin": 0, "vmax": most}
        if name != "length":
            scale = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
        mesh = panel.pcolormesh(*degrees, values.T, shading="gouraud", rasterized=True, **scale)
        drawn.colorbar(mesh, ax=panel, label="mm")
        panel.set_title(f"shift, {name}", fontsize=9)
        panel.set(xlabel="alpha, deg", ylabel="beta, deg")
        panel.label_outer()
    static.save(drawn, path)
