"""Compare the direct and the decomposed solver on the same poses: offsets, held-out errors, time.

    python scripts/compare_solvers.py [RECORDING]

Without a recording, that of the bundled C-arm 'mobile_skewed' is simulated, and the truth is known.
"""

import argparse
import sys

import numpy as np

import carm_kin
from carm_kin.study.compare import compare

SOLVERS = ("direct", "decomposed")


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the direct and the decomposed solver.")
    parser.add_argument("recording", nargs="?", help="with labelled sweeps; left out, one is simulated")
    path = parser.parse_args().recording

    if path:
        recording, truth = carm_kin.read_recording(path), None
    else:
        noise = {"sigma_t_m": 0.3e-3, "sigma_r_rad": np.radians(0.1)}
        recording, truth = carm_kin.simulate("mobile_skewed", **noise, seed=7)
        recording = recording.select(slice(None, None, 4))  # enough to show it, and quick

    comparison = compare(recording, SOLVERS, truth=truth, folds=5)
    for run in comparison.runs:
        if run.result is None:  # refused, or the recording lacks what this solver needs
            print(f"{run.solver:<11} {run.reason}")
            continue
        offset = " ".join(f"{value * 1e3:9.3f}" for value in run.result.offset_sensor_pivot_m)
        print(f"{run.solver:<11} offset {offset} mm, {run.time_s * 1e3:.0f} ms")
        if run.held_out:
            print(f"{'':<11} held-out poses off by {run.held_out.translation_rms_m * 1e3:.3f} mm rms")
    for difference in comparison.differences:
        if difference.quantity == "offset":
            pair = f"{difference.first} and {difference.second}"
            print(f"offsets of {pair} differ by {difference.difference_m * 1e3:.3f} mm")


if __name__ == "__main__":
    try:
        main()
    except carm_kin.CarmKinError as error:
        sys.exit(f"error: {error}")
