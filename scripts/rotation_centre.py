"""Where is the rotation centre, and how does the C-arm stand, at poses that a tracker sees now?

    python scripts/rotation_centre.py [RESULT RECORDING]

Without a saved result, a recording of the bundled C-arm 'mobile_skewed' is simulated and calibrated.
"""

import argparse
import sys

import numpy as np

import carm_kin


def main() -> None:
    parser = argparse.ArgumentParser(description="The rotation centre in use.")
    parser.add_argument("result", nargs="?", help="a result.json; left out, a recording is simulated and calibrated")
    parser.add_argument("recording", nargs="?", help="the poses to locate the rotation centre at")
    arguments = parser.parse_args()
    if arguments.result and not arguments.recording:
        parser.error("give a recording behind the result")

    if arguments.result:
        recording = carm_kin.read_recording(arguments.recording)
        result = carm_kin.read_result(arguments.result)
    else:
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7)
        result = carm_kin.calibrate(recording)

    centre = carm_kin.RotationCentre(result)  # RotationCentre(result, "placement") where the base has several
    shown = np.linspace(0, len(recording) - 1, 6).astype(int)
    found = centre.locate(recording.T_world_sensor[shown])
    print("   pose  angular  orbital   centre by the measured pose, mm        by the nearest pose of the C-arm, mm")
    for k, pose in enumerate(shown):
        alpha, beta = np.degrees([found.nearest.alpha_rad[k], found.nearest.beta_rad[k]])
        measured = point(found.pivot_world_m[k], found.sigma_pivot_world_m[k])
        nearest = point(found.nearest.pivot_world_m[k], found.sigma_nearest_pivot_world_m[k])
        print(f"{pose:7d} {alpha:8.2f} {beta:8.2f}  {measured}  {nearest}")


def point(p_m: np.ndarray, sigma_m: np.ndarray) -> str:
    """A point (3,) in mm, with its largest standard deviation."""
    return " ".join(f"{value * 1e3:8.2f}" for value in p_m) + f" ± {sigma_m.max() * 1e3:.2f}"


if __name__ == "__main__":
    try:
        main()
    except carm_kin.CarmKinError as error:
        sys.exit(f"error: {error}")
