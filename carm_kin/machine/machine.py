"""A machine by its URDF: joints, limits, nominal geometry, forward kinematics and Jacobian in one place."""

import os

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.machine.chain import Chain, NominalGeometry, chain_of, nominal_geometry
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import UrdfFile, as_urdf
from solvers.se3 import Array


class Machine:
    """The chain of a URDF from its base to one sensor link. J joints, m and rad; nothing is ever modified.

    machine = Machine("mobile_skewed")
    machine.joints, machine.limits, machine.nominal.major_radius
    T_base_sensor = machine.forward_kinematics(np.zeros((1, len(machine.joints))))
    """

    urdf: UrdfFile
    chain: Chain

    def __init__(
        self,
        urdf: UrdfFile | str | os.PathLike,
        sensor_link: str | None = None,
        *,
        angular: str | None = None,
        orbital: str | None = None,
    ):
        """``urdf`` is a path, the name of a bundled machine or what `read_urdf` gives; names default as in `chain_of`.

        Raises InputError for a broken file and for a name that is wrong or missing.
        """
        self.urdf = as_urdf(urdf)
        self.chain = chain_of(self.urdf, sensor_link, angular, orbital)

    def __repr__(self) -> str:
        first, second = self.axes
        ends = f"{self.chain.base_link} to {self.chain.sensor_link}"
        return f"Machine {self.urdf.path.name}: {ends}, {len(self.joints)} joints, axes {first} and {second}"

    @property
    def joints(self) -> tuple[str, ...]:
        """(J,) the names of the moving joints from the base to the sensor: the order of every ``q``."""
        return self.chain.names

    @property
    def axes(self) -> tuple[str, str]:
        """The joint of alpha (nearer the base) and the joint of beta."""
        return self.joints[self.chain.angular], self.joints[self.chain.orbital]

    @property
    def limits(self) -> Array:
        """(J, 2) lower and upper, rad or m for sliding joints; infinite where there is none."""
        return np.stack([self.chain.lower, self.chain.upper], axis=1)

    @property
    def nominal(self) -> NominalGeometry:
        """The geometry of the two axes, the other joints at zero. Raises InputError for parallel axes."""
        return nominal_geometry(self.chain)

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """T_base_sensor (N, 4, 4), m, at q (N, J), rad or m. Raises InputError for a wrong number of joint values."""
        return self.chain.forward_kinematics(np.atleast_2d(self.chain.configurations(q)))

    def jacobian(self, q: ArrayLike) -> Array:
        """(N, 6, J) the tangent [v, w] in the sensor's frame for each joint's motion at q (N, J).

        Raises InputError as `forward_kinematics` does, MissingDependencyError without Pinocchio.
        """
        return Model(self.urdf, self.chain).jacobian(q)
