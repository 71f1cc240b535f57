"""The user's URDF with the calibrated numbers: only the origins that changed are edited, every other byte stays."""

from carm_kin.errors import InputError
from carm_kin.machine.urdf import UrdfFile, add_fixed_link, patch_origins
from carm_kin.results.chain_result import ChainCalibration


def calibrated_urdf(urdf: UrdfFile, chain: ChainCalibration) -> UrdfFile:
    """The file with the calibration's origins. A sensor that was found on a moving link itself gets a link of its own,
    fixed to it.

    Raises InputError where the file has not the joints and links of the calibration.
    """
    missing = [sensor.link for sensor in chain.sensors if sensor.link not in urdf.links]
    if missing:
        raise InputError(f"has no link {missing[0]!r}: it is not the URDF that was calibrated", file=urdf.path)
    patched = patch_origins(urdf, {origin.joint: origin.T_parent_joint for origin in chain.origins})
    carried = {joint.child for joint in urdf.joints if joint.type == "fixed"}
    for sensor in chain.sensors:
        if sensor.link not in carried:
            patched = add_fixed_link(patched, sensor.link, _free_name(patched, sensor.link), sensor.T_link_sensor)
    return patched


def _free_name(urdf: UrdfFile, link: str) -> str:
    """``sensor`` where no link and joint is named so, else one made of the link's name."""
    taken = {*urdf.links, *(joint.name for joint in urdf.joints)}
    names = ["sensor", f"{link}_sensor", *(f"{link}_sensor_{k}" for k in range(2, len(taken) + 3))]
    return next(name for name in names if not taken & {name, f"{name}_mount"})
