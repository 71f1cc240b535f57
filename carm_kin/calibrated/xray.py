"""The projection of a C-arm's X-ray source onto its detector, from a URDF's links and a calibration.

    lambda (u, v, 1)^T = P (X, 1)^T,    P = K [E | -E s]

with X in metres, lambda the depth in metres, s the source, and E the rows of the detector's x and y axes and of its
normal, which points from the source to the detector. K has the focal length over the pixel's size on its diagonal,
and in its last column the principal point: the pixel in which the normal from the source meets the detector.
docs/conventions.md states the signs and the pixel's origin.
"""

import os
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.calibrated.rotation_centre import RotationCentre
from carm_kin.calibration.cross_validate import torus_of
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.urdf import UrdfFile, as_urdf
from carm_kin.recording.checks import transforms
from carm_kin.results.result import ResultLike, as_result
from solvers.se3 import Array, inverse
from solvers.torus import SENSE_RADIUS_M, Torus

LEAST_FOCAL_LENGTH_M = 1e-3
"""A source that is nearer the detector's plane casts no image."""


@dataclass(frozen=True)
class Detector:
    """A flat detector with square pixels. Raises InputError for a size that is none."""

    pixel_m: float
    """Side of a pixel, m."""
    columns: int
    """Pixels along the detector's x axis."""
    rows: int
    """Pixels along the detector's y axis."""

    def __post_init__(self) -> None:
        if not 0 < self.pixel_m < np.inf:
            raise InputError(f"pixel_m must be a finite length above 0, not {self.pixel_m}")
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
                raise InputError(f"{name} must be a whole number above 0, not {count!r}")

    @property
    def middle(self) -> Array:
        """(2,) u and v of the middle of the face, px."""
        return np.array([self.columns - 1, self.rows - 1]) / 2


@dataclass(frozen=True, eq=False)
class Xray:
    """A source and a detector that turn with the C. Raises InputError where the source lies in the detector's plane."""

    detector: Detector
    T_carm_source: Array
    """(4, 4), m: its origin is the focal spot; its axes have no meaning here."""
    T_carm_detector: Array
    """(4, 4), m: origin in the middle of the face, x along the rows of pixels, y along the columns, z its normal."""
    major_radius_m: float
    """R of the machine that these belong to, signed as in its chain."""

    def __post_init__(self) -> None:
        if self.focal_length_m < LEAST_FOCAL_LENGTH_M:
            raise InputError("the source lies in the plane of the detector: there is no image")

    @staticmethod
    def of_urdf(
        urdf: UrdfFile | str | os.PathLike,
        detector: Detector,
        *,
        source_link: str = "source",
        detector_link: str = "detector",
        sensor_link: str | None = None,
        angular: str | None = None,
        orbital: str | None = None,
    ) -> "Xray":
        """The nominal place of two links in the C-arm frame; ``urdf`` is a path or a bundled name.

        A machine with several planes has a source and a detector link for each. Raises InputError for a broken
        file, an unknown link, and where a moving joint lies between one of the links and the sensor.
        """
        file = as_urdf(urdf)
        chain = chain_of(file, sensor_link, angular, orbital)
        geometry = nominal_geometry(chain)
        T_carm_sensor = inverse(geometry.T_sensor_carm)
        source, face = (
            T_carm_sensor @ _rigid_with(file, chain.sensor_link, link) for link in (source_link, detector_link)
        )
        return Xray(detector, source, face, geometry.major_radius)

    @property
    def source_detector_m(self) -> Array:
        """(3,) the source in the detector's frame, m."""
        return (inverse(self.T_carm_detector) @ self.T_carm_source)[:3, 3]

    @property
    def focal_length_m(self) -> float:
        """Distance from the source to the detector along its normal."""
        return float(abs(self.source_detector_m[2]))

    @property
    def K(self) -> Array:
        """(3, 3) the intrinsic matrix, px."""
        x, y, _ = self.source_detector_m
        scale = 1 / self.detector.pixel_m
        u, v = self.detector.middle + np.array([x, y]) * scale
        f = self.focal_length_m * scale
        return np.array([[f, 0, u], [0, f, v], [0, 0, 1]])

    @property
    def P_image_carm(self) -> Array:
        """(3, 4) from the C-arm frame, m, to pixels."""
        E = self.T_carm_detector[:3, :3].T.copy()
        E[2] *= -np.sign(self.source_detector_m[2])
        return self.K @ E @ np.concatenate([np.eye(3), -self.T_carm_source[:3, 3:]], axis=1)

    def P_image_sensor(self, result: ResultLike) -> Array:
        """(3, 4) from the sensor's frame, m, to pixels: the same at every pose of a C that does not bend.

        ``result`` may be a path.

        Raises InputError where the calibration holds no complete chain or does not tell where beta is zero and which
        way it counts, so that it does not fix the C-arm frame in which the URDF has source and detector.
        """
        result = as_result(result)
        torus = torus_of(result, tuple(placement.label for placement in result.placements))
        self._check_frame(torus)
        return self.P_image_carm @ inverse(torus.T_sensor_carm)

    def P_image_world(self, result: ResultLike, T_world_sensor: ArrayLike, placement: str | None = None) -> Array:
        """(N, 3, 4) from the world, m, to pixels, for poses (N, 4, 4), m.

        Where the calibration found the C to bend, the C-arm frame is that at the pose, and a calibration of several
        placements needs the name of the one. Raises InputError as `P_image_sensor` does, where the name is missing, and
        for poses that are no rigid motions.
        """
        result = as_result(result)
        rigid, T = self.P_image_sensor(result), transforms("T_world_sensor", T_world_sensor)
        if result.deformation is None:
            return rigid @ inverse(T)
        return rigid @ inverse(RotationCentre(result, placement).unbent(T))

    def _check_frame(self, torus: Torus) -> None:
        """Raise InputError unless labels make the calibration's C-arm frame that of the URDF."""
        label = "give its angle, as the URDF counts it, in 'q_{}_deg' of sweeps that hold it at two angles or more"
        if not torus.orbital_referenced:
            wanted = label.format("orbital")
            raise InputError(f"the calibration does not tell where the orbital joint stands at zero: {wanted}")
        radii = torus.major_radius, self.major_radius_m
        clear = min(np.abs(radii)) > SENSE_RADIUS_M
        if radii[0] * radii[1] < 0 if clear else not torus.referenced.any():
            problem = "the calibration's C-arm frame may be that of the URDF turned by half a turn"
            raise InputError(f"{problem}: no label tells which way the angular joint turns; {label.format('angular')}")


def _rigid_with(file: UrdfFile, sensor_link: str, link: str) -> Array:
    """T_sensor_link (4, 4), m. Raises InputError unless only fixed joints lie between the two."""
    paths = [file.joints_to(name) for name in (sensor_link, link)]
    moving = [[joint.name for joint in path if joint.type != "fixed"] for path in paths]
    if between := sorted({*moving[0]} ^ {*moving[1]}):
        problem = f"the joint {between[0]!r} moves between the links {sensor_link!r} and {link!r}"
        raise InputError(f"{problem}; name links that are rigid with the sensor", file=file.path)
    T_base_sensor, T_base_link = (reduce(np.matmul, (joint.origin for joint in path), np.eye(4)) for path in paths)
    return inverse(T_base_sensor) @ T_base_link
