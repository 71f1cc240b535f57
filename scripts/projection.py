"""Project points in the tracker's world into the X-ray image of a calibrated C-arm.

    python scripts/projection.py [RECORDING URDF]

Without a recording, that of the bundled C-arm 'mobile_skewed' is simulated. The URDF has the links 'source' and
'detector'; the recording needs labels of both joints, which tell where these stand at the sensor.
"""

import argparse
import sys

import numpy as np

import carm_kin

DETECTOR = carm_kin.Detector(pixel_m=0.3e-3, columns=1024, rows=1024)


def main() -> None:
    parser = argparse.ArgumentParser(description="Project points into the X-ray image.")
    parser.add_argument("recording", nargs="?", help="with labels of both joints; left out, one is simulated")
    parser.add_argument("urdf", nargs="?", default="mobile_skewed", help="a file or the name of a bundled one")
    arguments = parser.parse_args()

    if arguments.recording:
        recording = carm_kin.read_recording(arguments.recording)
    else:
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7)

    result = carm_kin.calibrate(recording)
    xray = carm_kin.Xray.of_urdf(arguments.urdf, DETECTOR)
    print("from the sensor's frame, m, to pixels, the same at every pose:")
    for row in xray.P_image_sensor(result):
        print(" ".join(f"{value:12.5f}" for value in row))

    shown = np.linspace(0, len(recording) - 1, 6).astype(int)
    T_world_sensor = recording.T_world_sensor[shown]
    P_image_world = xray.P_image_world(result, T_world_sensor)
    pivot_world_m = carm_kin.RotationCentre(result).locate(T_world_sensor).pivot_world_m
    print("   pose  rotation centre now   where it was at the first of these poses")
    for pose, P, now in zip(shown, P_image_world, pivot_world_m, strict=True):
        print(f"{pose:7d} {pixel(P, now)} px  {pixel(P, pivot_world_m[0])} px")


def pixel(P_image_world: np.ndarray, point_world_m: np.ndarray) -> str:
    """Column and row of a point (3,) in the world by a projection (3, 4)."""
    u, v, depth = P_image_world @ [*point_world_m, 1]
    return f"{u / depth:8.2f} {v / depth:8.2f}"


if __name__ == "__main__":
    try:
        main()
    except carm_kin.CarmKinError as error:
        sys.exit(f"error: {error}")
