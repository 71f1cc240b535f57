"""Every bundled machine calibrated from a perturbed URDF, by how well it predicts held-out poses.

python -m benchmarks.variants [--seeds 3]
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np

import carm_kin
from benchmarks import scenes
from carm_kin.calibration.chain.calibrate import FreeJoints, fit, free_of, nominal_fit
from carm_kin.calibration.chain.model import ChainModel, chain_model
from carm_kin.calibration.chain.problem import gather
from carm_kin.machine.urdf import UrdfFile, bundled_urdfs, patch_origins, read_urdf
from solvers.chain.chain import Options, residuals
from solvers.estimate import Note
from solvers.se3 import exp_se3

SIGMA_T, SIGMA_R = 0.25e-3, float(np.radians(0.1))
MOVED_M, MOVED_RAD = 3e-3, float(np.radians(0.5))
"""Every origin of the chain is moved by so much, in a random direction."""
HELD_OUT = 0.25
"""Share of the poses that are predicted, in one stretch."""


@dataclass(frozen=True)
class Row:
    """One machine, one sensor, one seed."""

    machine: str
    joints: int
    estimated: int
    nominal_mm: float
    """RMS position error of the held-out poses by the perturbed URDF, base and mount fitted."""
    nominal_deg: float
    ratio_t: float
    """RMS position error an axis of the calibrated chain over the noise."""
    ratio_r: float
    seconds: float


def perturbed(file: UrdfFile, model: ChainModel, rng: np.random.Generator) -> UrdfFile:
    """The file with every origin on the chains moved and turned."""
    names = {j.name for chain in model.chains for j in file.joints_to(chain.sensor_link)}
    origins = {}
    for joint in file.joints:
        if joint.name in names:
            v, w = rng.normal(size=(2, 3))
            change = np.concatenate([MOVED_M * v / np.linalg.norm(v), MOVED_RAD * w / np.linalg.norm(w)])
            origins[joint.name] = joint.origin @ exp_se3(change)
    return patch_origins(file, origins)


def measured(job: tuple[str, str, int]) -> Row:
    """Simulate, perturb, calibrate, predict."""
    machine, link, seed = job
    file = read_urdf(machine)
    recording, _ = carm_kin.simulate(
        machine, "joints", sigma_t_m=SIGMA_T, sigma_r_rad=SIGMA_R, sensor_link=link, seed=seed
    )
    rng = np.random.default_rng([seed, 0x7A2])
    model = chain_model(perturbed(file, chain_model(file, [link]), rng), [link])
    problem = gather([recording], model, (None, None, 0.0, 0.0)).problem
    held = np.arange(len(problem)) >= (1 - HELD_OUT) * len(problem)
    start = time.perf_counter()
    rest = problem.select(np.flatnonzero(~held))
    estimate = fit(rest, model, free_of(model, FreeJoints()), Options())
    seconds = time.perf_counter() - start
    if isinstance(estimate, Note):
        raise RuntimeError(f"{machine}: {estimate.message}")
    nominal = nominal_fit(rest, model, estimate)
    part = problem.select(np.flatnonzero(held))
    before, after = (residuals(one.machine, part.label, part) for one in (nominal, estimate))
    return Row(
        machine if link == "sensor" else f"{machine}, {link}",
        len(model.names),
        int(estimate.active.sum()),
        _rms(before[:, :3]) * 1e3,
        float(np.degrees(_rms(before[:, 3:]))),
        _rms(after[:, :3]) / np.sqrt(3) / SIGMA_T,
        _rms(after[:, 3:]) / np.sqrt(3) / SIGMA_R,
        seconds,
    )


def _rms(vectors: np.ndarray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


NOTES = """Noise 0.25 mm and 0.1 deg an axis; the protocol `joints` (all joints move within their ranges and are read
exactly); every origin on the chain moved by 3 mm and 0.5 deg; all of them free, base and mount unknown. Held
out is the last quarter of the poses. `nominal` is the error of the perturbed URDF with base and mount fitted;
the ratios are those of the calibrated chain's error an axis to the noise, 1 at best and 1.2 aimed at; the
worst of the seeds."""


def table(rows: list[Row], command: str, seconds: float) -> str:
    """One line a machine."""
    lines = []
    for name in dict.fromkeys(row.machine for row in rows):
        own = [row for row in rows if row.machine == name]
        worst = [max(getattr(row, key) for row in own) for key in ("nominal_mm", "nominal_deg", "ratio_t", "ratio_r")]
        numbers = [f"{worst[0]:.2f}", f"{worst[1]:.2f}", f"{worst[2]:.3f}", f"{worst[3]:.3f}"]
        time_s = np.median([row.seconds for row in own])
        lines.append([name, str(own[0].joints), str(own[0].estimated), *numbers, f"{time_s:.1f}"])
    header = ["machine", "joints", "estimated", "nominal mm", "nominal deg", "position", "orientation", "time s"]
    text = scenes.show("Held-out poses of calibrated chains", header, lines)
    return f"## Kinematic variants\n\n{scenes.provenance(command, seconds)}\n\n{NOTES}\n\n{text}"


def main() -> None:
    """Run all machines and write the section of RESULTS.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    sensors = [(name, link) for name in bundled_urdfs() for link in read_urdf(name).links if link.startswith("sensor")]
    work = [(name, link, seed) for name, link in sensors for seed in range(given.seeds)]
    rows = scenes.run_all(measured, work, given.jobs)
    command = f"python -m benchmarks.variants --seeds {given.seeds}"
    scenes.write_section("variants", table(rows, command, time.perf_counter() - begin))


if __name__ == "__main__":
    main()
