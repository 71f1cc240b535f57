"""A serial arm calibrated by carm-kin, figaroh and robotkinecal from the same poses.

    pip install '.[bench-peers]' && pip install --no-deps robotkinecal
    python -m benchmarks.chain_peers

robotkinecal declares numpy<2 and Pinocchio's wheels need numpy>=2.2, so pip does not install both; it runs on either.
A peer that is not installed is named as such.
"""

import argparse
import importlib.util
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from benchmarks import peers_chain, scenes
from carm_kin.machine.chain import chain_of
from carm_kin.machine.urdf import UrdfFile, parse_urdf, patch_origins
from carm_kin.simulation.noise import Noise, disturbed
from solvers.se3 import Array, exp_se3, log_so3, transform

SHIFT, TURN = 3e-3, float(np.radians(0.5))
"""How far every origin and the base is from the nominal one."""
SIGMA_T, SIGMA_R = 0.25e-3, float(np.radians(0.1))
SIGMA_READING = float(np.radians(0.05))
HELD_OUT = 200
RANGE = 2.5
"""Joint values are uniform within this, rad, either way."""
LINKS_M = (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922)
"""Lengths of a six-joint arm with three parallel axes: d1, a2, a3, d4, d5, d6."""


@dataclass(frozen=True)
class Scene:
    """What is measured."""

    name: str
    poses: int
    outliers: float = 0.0
    sigma_reading: float = 0.0


SCENES = (
    Scene("30 poses", 30),
    Scene("100 poses", 100),
    Scene("100 poses, 10% gross outliers", 100, outliers=0.1),
    Scene("100 poses, readings with 0.05 deg of noise", 100, sigma_reading=SIGMA_READING),
    Scene("1000 poses", 1000),
)


@dataclass(frozen=True)
class Outcome:
    """One peer on one recording; NaN errors where it says itself that it failed."""

    position_m: float
    rotation_rad: float
    time_s: float


def arm_text() -> str:
    """The nominal URDF; all joints turn about z, which robotkinecal asks for."""
    d1, a2, a3, d4, d5, d6 = LINKS_M
    quarter = np.pi / 2
    origins = [
        (0, 0, d1, 0),
        (0, 0, 0, quarter),
        (a2, 0, 0, 0),
        (a3, 0, d4, 0),
        (0, -d5, 0, quarter),
        (0, d6, 0, -quarter),
    ]
    parts = ['<link name="l0"/>']
    for k, (x, y, z, roll) in enumerate(origins, 1):
        parts.append(
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="{x} {y} {z}" rpy="{roll} 0 0"/><axis xyz="0 0 1"/>'
            f'<limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint><link name="l{k}"/>'
        )
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="l6"/><child link="{peers_chain.TOOL}"/>'
        f'<origin xyz="0 0.05 0.1" rpy="0.3 0 0"/></joint><link name="{peers_chain.TOOL}"/>'
    )
    return f'<robot name="arm">{"".join(parts)}</robot>'


def displaced(T: Array, rng: np.random.Generator) -> Array:
    """T (4, 4) shifted and turned in random directions."""
    v, w = rng.normal(size=(2, 3))
    return T @ exp_se3(np.concatenate([v / np.linalg.norm(v) * SHIFT, w / np.linalg.norm(w) * TURN]))


def recorded(scene: Scene, urdf: UrdfFile, seed: int) -> tuple[Array, Array, Array, Array]:
    """Readings (N, 6) and poses (N, 4, 4), then held-out readings and true poses without noise."""
    rng = np.random.default_rng([seed, scene.poses])
    base = displaced(np.eye(4), rng)
    truth = chain_of(patch_origins(urdf, {j.name: displaced(j.origin, rng) for j in urdf.joints}), peers_chain.TOOL)
    q, fresh = (rng.uniform(-RANGE, RANGE, (n, 6)) for n in (scene.poses, HELD_OUT))
    T = base @ truth.forward_kinematics(q)
    p, R, _ = disturbed(T, Noise(SIGMA_T, SIGMA_R, outliers=scene.outliers), rng)
    readings = q + scene.sigma_reading * rng.normal(size=q.shape)
    return readings, transform(R, p), fresh, base @ truth.forward_kinematics(fresh)


def outcome(name: str, scene: Scene, seed: int) -> Outcome:
    """Held-out errors and time of one contender."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(arm_text(), encoding="utf-8")
        q, T, fresh, expected = recorded(scene, parse_urdf(path.read_bytes(), path), seed)
        begin = time.perf_counter()
        try:
            predict = peers_chain.fitted(name, path, q, T, (SIGMA_T, SIGMA_R))
        except peers_chain.Diverged:
            return Outcome(np.nan, np.nan, time.perf_counter() - begin)
        seconds = time.perf_counter() - begin
        found = predict(fresh)
    turn = log_so3(np.swapaxes(found[:, :3, :3], 1, 2) @ expected[:, :3, :3])
    off = found[:, :3, 3] - expected[:, :3, 3]
    position, rotation = (float(np.sqrt((x**2).sum(axis=1).mean())) for x in (off, turn))
    return Outcome(position, rotation, seconds)


def row(scene: Scene, name: str, outcomes: list[Outcome]) -> list[str]:
    """A row of the table: medians, since a fit may go astray."""
    good = [o for o in outcomes if np.isfinite(o.position_m)]
    if not good:
        return [scene.name, name, "-", "-", "-", f"{len(outcomes)} of {len(outcomes)}", "-"]
    mm, deg = (np.array([getattr(o, field) for o in good]) for field in ("position_m", "rotation_rad"))
    seconds = float(np.median([o.time_s for o in outcomes]))
    return [
        scene.name,
        name,
        f"{np.median(mm) * 1e3:.3f}",
        f"{mm.max() * 1e3:.3f}",
        f"{np.degrees(np.median(deg)):.4f}",
        f"{len(outcomes) - len(good)} of {len(outcomes)}",
        "-" if name == "nominal URDF" else f"{seconds * 1e3:.0f}",
    ]


def installed() -> dict[str, str]:
    """The peers with their versions, and why one is missing."""
    found = {}
    for name in ("figaroh", "robotkinecal"):
        there = importlib.util.find_spec(name) is not None
        found[name] = version(name) if there else "is not installed"
    return found


NOTES = f"""A six-joint arm of a UR10's size with three parallel axes. Base and every origin, that of the tool included,
are {SHIFT * 1e3:.0f} mm and {np.degrees(TURN):.1f} deg off the URDF in random directions. The tool's full pose is
measured with {SIGMA_T * 1e3:.2f} mm and {np.degrees(SIGMA_R):.1f} deg of noise an axis; joint values within {RANGE} rad
are read without noise but where stated. Errors are those of {HELD_OUT} poses that were not fitted, without noise: root
mean squares of distance and angle, of these the median over the seeds, and the worst of the distance. Failed: the peer
itself says so. Time: one fit as a user calls it, files read included; the median.

figaroh: `BaseCalibration`, `full_params`, base and tool frame unknown, residuals weighted with the true noise (carm-kin
estimates it). robotkinecal: `SerialRobotKineCal` on the URDF; it has no weights. Both take the readings as exact;
figaroh leaves out poses more than 50 mm off, robotkinecal none. robotkinecal declares numpy<2, which Pinocchio's wheels
exclude; it is installed with `--no-deps` and runs on the numpy named above."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    begin = time.perf_counter()
    versions = installed()
    missing = {name for name, text in versions.items() if text == "is not installed"}
    names = [name for name in peers_chain.PEERS if name not in missing]
    for name in names:
        outcome(name, SCENES[0], 0)  # imports and caches
    rows = [
        row(scene, name, [outcome(name, scene, seed) for seed in range(given.seeds)])
        for scene in SCENES
        for name in names
    ]
    header = ["recording", "", "distance mm", "worst mm", "angle deg", "failed", "time ms"]
    table = scenes.show("Held-out poses of a six-joint arm", header, rows)
    head = scenes.provenance(f"python -m benchmarks.chain_peers --seeds {given.seeds}", time.perf_counter() - begin)
    peers = "Peers: " + ", ".join(f"{name} {text}" for name, text in versions.items()) + "."
    scenes.write_section("chain peers", "\n\n".join(["## Chain calibration beside peers", head, NOTES, peers, table]))


if __name__ == "__main__":
    main()
