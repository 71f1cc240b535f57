"""Compare the direct and the decomposed solver on the same poses: offsets and residuals.

    python scripts/compare_solvers.py [RECORDING]

Without a recording, that of the bundled C-arm 'mobile_nonisocentric' is simulated, and the truth is known.
Both solvers take the axes to be perpendicular, as those of this machine are.
"""

import argparse
import sys

import numpy as np

import carm_kin

SOLVERS = ("direct", "decomposed")


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the direct and the decomposed solver.")
    parser.add_argument("recording", nargs="?", help="with labelled sweeps; left out, one is simulated")
    path = parser.parse_args().recording

    if path:
        recording, truth = carm_kin.read_recording(path), None
    else:
        recording, truth = carm_kin.simulate(
            "mobile_nonisocentric", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7
        )

    comparison = carm_kin.compare(recording, SOLVERS, truth=truth, folds=None)  # folds=5 adds errors of held-out poses
    for run in comparison.runs:
        if run.reason:  # refused, or the recording lacks what this solver needs
            print(f"{run.solver:<11} none ({run.reason.code}): {run.reason.message}")
            continue
        assert run.result is not None
        assert run.result.offset_sensor_pivot_m is not None
        offset = " ".join(f"{value * 1e3:9.3f}" for value in run.result.offset_sensor_pivot_m)
        rms_m = run.result.residuals.translation_rms_m
        print(f"{run.solver:<11} offset {offset} mm, poses {rms_m * 1e3:.3f} mm rms from the fitted ones")
    for difference in comparison.differences:
        if difference.quantity == "offset" and difference.difference_m is not None:
            pair = f"{difference.first} and {difference.second}"
            print(f"offsets of {pair} differ by {difference.difference_m * 1e3:.3f} mm")


if __name__ == "__main__":
    try:
        main()
    except carm_kin.CarmKinError as error:
        sys.exit(f"error: {error}")
