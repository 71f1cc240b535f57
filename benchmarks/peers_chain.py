"""The same arm calibrated by carm-kin, figaroh and robotkinecal, each as its own documentation has it.

All get the nominal URDF, joint readings (N, J) and poses of the tool (N, 4, 4) in a frame near the arm's base, and give
back what predicts the poses at other readings. Metres and radians.
"""

import contextlib
import importlib
import io
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from carm_kin.calibration.chain.calibrate import calibrate_chain
from carm_kin.machine.chain import chain_of
from carm_kin.machine.urdf import parse_urdf, patch_origins
from carm_kin.recording.recording import Recording
from solvers.se3 import Array

Predictor = Callable[[Array], Array]
TOOL = "tool"
FIGAROH_CONFIG = """
robot: {{name: arm}}
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    kinematics: {{base_frame: universe, tool_frame: {tool}}}
    measurements:
      markers: [{{measurable_dof: [true, true, true, true, true, true]}}]
      poses: {{base_pose: null, tool_pose: null}}
    parameters: {{calibration_level: full_params}}
    data: {{source_file: {data}}}
"""


class Diverged(Exception):
    """A peer that says itself that it did not succeed."""


def carm_kin_fit(urdf: Path, q: Array, T: Array, sigma: tuple[float, float]) -> Predictor:
    """Default options: all origins, noise and reading errors estimated, outliers told from the poses alone."""
    file = parse_urdf(urdf.read_bytes(), urdf)
    names = chain_of(file, TOOL).names
    recording = Recording(T[:, :3, 3], T[:, :3, :3], joints=dict(zip(names, q.T, strict=True)))
    result = calibrate_chain(recording, file, sensor_link=TOOL)
    if result.chain is None:
        raise Diverged(result.refusal.message if result.refusal else "")
    base = result.chain.bases[0].T_world_base
    chain = chain_of(patch_origins(file, {o.joint: o.T_parent_joint for o in result.chain.origins}), TOOL)
    return lambda values: base @ chain.forward_kinematics(values)


def figaroh_fit(urdf: Path, q: Array, T: Array, sigma: tuple[float, float]) -> Predictor:
    """`BaseCalibration` with base and tool frame unknown, the residuals weighted with the true noise, its own default
    rejection of outliers (50 mm)."""
    import pandas  # pyright: ignore[reportMissingImports]
    from figaroh.calibration.base_calibration import BaseCalibration  # pyright: ignore[reportMissingImports]
    from figaroh.calibration.calibration_tools import calc_updated_fkm  # pyright: ignore[reportMissingImports]

    pin: Any = importlib.import_module("pinocchio")

    class Calibration(BaseCalibration):
        def cost_function(self, var: Array) -> Array:
            poses = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            off = self._compute_logmap_residuals(self.PEE_measured, poses)
            return self.apply_measurement_weighting(off, pos_weight=1 / sigma[0], orient_weight=1 / sigma[1])

    model = pin.buildModelFromUrdf(str(urdf))
    robot = SimpleNamespace(model=model, data=model.createData(), q0=pin.neutral(model))
    rpy = np.array([pin.rpy.matrixToRpy(R) for R in T[:, :3, :3]])
    columns = ["x1", "y1", "z1", "phix1", "phiy1", "phiz1", *list(model.names)[1:]]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        data, config = Path(folder) / "data.csv", Path(folder) / "config.yaml"
        pandas.DataFrame(np.concatenate([T[:, :3, 3], rpy, q], axis=1), columns=columns).to_csv(data, index=False)
        config.write_text(FIGAROH_CONFIG.format(tool=TOOL, data=data), encoding="utf-8")
        found = Calibration(robot, str(config))
        found.calib_config |= {"known_baseframe": False, "known_tipframe": False}
        found.initialize()
        result = found.solve(enable_logging=False)
    if found.STATUS != "CALIBRATED":
        raise Diverged(found.STATUS)

    def predict(values: Array) -> Array:
        settings = found.calib_config | {"NbSample": len(values)}
        rows = calc_updated_fkm(model, robot.data, result.x, values, settings).reshape(6, -1).T
        poses = np.tile(np.eye(4), (len(values), 1, 1))
        poses[:, :3, 3] = rows[:, :3]
        poses[:, :3, :3] = [pin.rpy.rpyToMatrix(row) for row in rows[:, 3:]]
        return poses

    return predict


def robotkinecal_fit(urdf: Path, q: Array, T: Array, sigma: tuple[float, float]) -> Predictor:
    """`SerialRobotKineCal` on the URDF; it has neither weights nor a rejection of outliers."""
    from roboticstoolbox import Robot  # pyright: ignore[reportMissingImports]
    from roboticstoolbox.models.URDF.URDFRobot import URDF_read  # pyright: ignore[reportMissingImports]
    from robotkinecal import SerialRobotKineCal  # pyright: ignore[reportMissingImports]
    from spatialmath import SE3  # pyright: ignore[reportMissingImports]

    with contextlib.redirect_stdout(io.StringIO()):
        links, name, _ = URDF_read(urdf)
        calibration = SerialRobotKineCal(Robot(links, name=name), ee_name=TOOL)
        calibration.set_observations(list(q), [SE3(pose, check=False) for pose in T])
        result = calibration.solve()
    if not result.has_converged:
        raise Diverged("diverges" if result.is_diverging else "does not converge")
    joints = calibration.N_JOINTS + 1
    return lambda values: np.array([calibration.forward_kinematics(joints, one).A for one in values])


def nominal(urdf: Path, q: Array, T: Array, sigma: tuple[float, float]) -> Predictor:
    """The URDF as it is."""
    return chain_of(parse_urdf(urdf.read_bytes(), urdf), TOOL).forward_kinematics


PEERS = {
    "nominal URDF": nominal,
    "carm-kin": carm_kin_fit,
    "figaroh": figaroh_fit,
    "robotkinecal": robotkinecal_fit,
}


def fitted(name: str, urdf: Path, q: Array, T: Array, sigma: tuple[float, float]) -> Predictor:
    """The predictor of one of `PEERS`. Raises Diverged where it says itself that it failed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return PEERS[name](urdf, q, T, sigma)
