"""A URDF as the machine that the chain solver calibrates: one path of joints to each sensor link."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from carm_kin.machine.chain import Chain, chain_of
from carm_kin.machine.urdf import UrdfFile, patch_origins
from solvers.chain.machine import Machine
from solvers.se3 import Array, exp_so3, transform


@dataclass(frozen=True, eq=False)
class ChainModel:
    """The chains from the base to S sensor links, their joints J taken together."""

    urdf: UrdfFile
    chains: tuple[Chain, ...]
    """(S,) one for each sensor link."""
    names: tuple[str, ...]
    """(J,) joints in the order in which the chains name them first."""
    machine: Machine
    """The nominal one, with one base, the world's frame."""

    @property
    def sensor_links(self) -> tuple[str, ...]:
        """(S,)."""
        return tuple(chain.sensor_link for chain in self.chains)

    def axes(self, sensor: int) -> tuple[int, int]:
        """The numbers of the first (alpha) and of the second axis (beta) of a sensor's chain."""
        chain, path = self.chains[sensor], self.machine.paths[sensor]
        first, second = sorted((chain.angular, chain.orbital))
        return int(path[first]), int(path[second])

    def chain(self, machine: Machine, sensor: int) -> Chain:
        """The sensor's chain with the numbers of ``machine``, zero offsets in the placements."""
        path, original = machine.paths[sensor], self.chains[sensor]
        turned = machine.placements @ _zero_motions(machine)
        return replace(original, placements=turned[path], T_last_sensor=machine.T_last_sensor[sensor])

    @property
    def carried(self) -> np.ndarray:
        """(J,) joints whose placement stands in an ``<origin>`` of the file: not the inner parts of a planar joint."""
        found = np.ones(len(self.names), dtype=bool)
        for chain, path in zip(self.chains, self.machine.paths, strict=True):
            found[path] = [joint is not None for joint in chain.origin_joints[:-1]]
        return found

    def origins(self, machine: Machine, joints: np.ndarray) -> dict[str, Array]:
        """The URDF origins, joint name -> T_parent_joint, of the ``joints`` (numbers) and the sensor mounts that are
        not the nominal ones. Raises InputError where no ``<origin>`` can carry a change.

        A sensor may stand on another one's link, so the mounts are found one after the other, the nearest to the base
        first.
        """
        urdf, found = self.urdf, {}
        for sensor in sorted(range(len(self.chains)), key=lambda s: len(urdf.joints_to(self.sensor_links[s]))):
            nominal, calibrated = self.chains[sensor], self.chain(machine, sensor)
            kept = np.isin(machine.paths[sensor], joints)
            placements = np.where(kept[:, None, None], calibrated.placements, nominal.placements)
            carried = nominal.origin_joints[-1] is not None
            axes = nominal.names[nominal.angular], nominal.names[nominal.orbital]
            before = chain_of(urdf, nominal.sensor_link, *axes) if found else nominal
            changed = before.origins(placements, calibrated.T_last_sensor if carried else nominal.T_last_sensor)
            found = changed | found
            urdf = patch_origins(self.urdf, found)
        return found


def chain_model(
    urdf: UrdfFile, sensor_links: Sequence[str | None], angular: str | None = None, orbital: str | None = None
) -> ChainModel:
    """The machine of a URDF with these sensor links; None is the default one of `carm_kin.machine.chain.chain_of`.

    ``angular`` and ``orbital`` name the two axes where a chain has both. Raises InputError for unknown names.
    """
    chains = tuple(_chain(urdf, link, angular, orbital) for link in sensor_links)
    names = tuple(dict.fromkeys(name for chain in chains for name in chain.names))
    owner = {name: chain for chain in reversed(chains) for name in chain.names}
    rows = [(owner[name], owner[name].names.index(name)) for name in names]
    machine = Machine(
        T_world_base=np.eye(4)[None],
        placements=np.array([chain.placements[k] for chain, k in rows]),
        axes=np.array([chain.axes[k] for chain, k in rows]),
        prismatic=np.array([chain.types[k] == "prismatic" for chain, k in rows]),
        paths=tuple(np.array([names.index(name) for name in chain.names]) for chain in chains),
        T_last_sensor=np.array([chain.T_last_sensor for chain in chains]),
        offsets=np.zeros(len(names)),
        gains=np.zeros(len(names)),
    )
    return ChainModel(urdf, chains, names, machine)


def _chain(urdf: UrdfFile, link: str | None, angular: str | None, orbital: str | None) -> Chain:
    """With the named axes where the link's path has both, else with its own."""
    if link is None:
        return chain_of(urdf, None, angular, orbital)
    on_path = {joint.name for joint in urdf.joints_to(link)}
    named = {angular, orbital} - {None} <= on_path
    return chain_of(urdf, link, angular, orbital) if named else chain_of(urdf, link)


def _zero_motions(machine: Machine) -> Array:
    """(J, 4, 4) M_j at the joints' zero offsets."""
    along = machine.axes * machine.offsets[:, None]
    turns = transform(exp_so3(np.where(machine.prismatic[:, None], 0.0, along)), np.zeros(3))
    turns[:, :3, 3] = np.where(machine.prismatic[:, None], along, 0.0)
    return turns
