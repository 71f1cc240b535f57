"""Forward kinematics, Jacobians and placement regressors by Pinocchio, for whole arrays of configurations."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.machine.chain import Chain
from carm_kin.machine.urdf import UrdfFile, kinematic_text, listing
from solvers.se3 import Array


class Model:
    """The chain of a URDF in Pinocchio, joints in the chain's order.

    Pinocchio sees only the bare chain of the checked file. It takes one configuration a call, some
    microseconds each; the loops over configurations are here and nowhere else. An instance holds
    scratch memory: one for each thread.
    """

    def __init__(self, urdf: UrdfFile, chain: Chain):
        """Raises `InputError` where the chain is not of this URDF, `MissingDependencyError` without Pinocchio."""
        self._pin = _pinocchio()
        self._chain = chain
        self._model = self._pin.buildModelFromXML(kinematic_text(urdf, chain.sensor_link))
        self._data = self._model.createData()
        names = tuple(self._model.names)[1:]
        if names != chain.names:
            problem = f"the chain has the joints {listing(chain.names)}, the file {listing(names)}"
            raise InputError(f"{problem}; make the chain of this file", file=urdf.path)
        self._frame = self._model.getFrameId(chain.sensor_link, self._pin.FrameType.BODY)

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """T_base_sensor (N, 4, 4) at q (N, J), m. Raises `InputError` for a wrong number of joint values."""
        pin, model, data, frame = self._pin, self._model, self._data, self._frame
        configurations = self._configurations(q)
        T = np.empty((len(configurations), 4, 4))
        for i, configuration in enumerate(configurations):
            pin.forwardKinematics(model, data, configuration)
            T[i] = pin.updateFramePlacement(model, data, frame).homogeneous
        return T

    def jacobian(self, q: ArrayLike) -> Array:
        """(N, 6, J): the tangent [v, w] in the sensor's frame for each joint's motion at q (N, J).

        T(q + dq) = T(q) exp_se3(J dq) to first order. Raises `InputError` as `forward_kinematics` does.
        """
        pin, model, data, frame = self._pin, self._model, self._data, self._frame
        configurations = self._configurations(q)
        J = np.empty((len(configurations), 6, model.nv))
        for i, configuration in enumerate(configurations):
            J[i] = pin.computeFrameJacobian(model, data, configuration, frame, pin.LOCAL)
        return J

    def placement_regressor(self, q: ArrayLike) -> Array:
        """(N, 6, 6 J): the same tangent for small changes of the joints' placements, at q (N, J).

        Columns 6 j to 6 j + 5 belong to ``placements[j] @ exp_se3([v, w])`` of the chain. There are none for
        T_last_sensor. Raises `InputError` as `forward_kinematics` does.
        """
        pin, model, data, frame = self._pin, self._model, self._data, self._frame
        configurations = self._configurations(q)
        K = np.empty((len(configurations), 6, 6 * model.nv))
        for i, configuration in enumerate(configurations):
            pin.forwardKinematics(model, data, configuration)
            K[i] = pin.computeFrameKinematicRegressor(model, data, frame, pin.LOCAL)
        return K

    def _configurations(self, q: ArrayLike) -> Array:
        """q (N, J) in Pinocchio's layout (N, nq), where a continuous joint is a cosine and a sine."""
        q = np.atleast_2d(self._chain.configurations(q))
        columns = []
        for values, type_ in zip(q.T, self._chain.types, strict=True):
            columns += [np.cos(values), np.sin(values)] if type_ == "continuous" else [values]
        return np.stack(columns, axis=1)


def _pinocchio() -> Any:
    """The library, if it is there; a package of another purpose bears the same name."""
    try:
        import pinocchio
    except ImportError as error:
        problem = "needs Pinocchio: pip install pin (not available on Windows; use Linux, macOS or WSL)"
        raise MissingDependencyError(problem) from error
    if not hasattr(pinocchio, "buildModelFromXML"):
        problem = "the module `pinocchio` is not the kinematics library: pip uninstall pinocchio && pip install pin"
        raise MissingDependencyError(problem)
    return pinocchio
