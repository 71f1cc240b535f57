"""Calibrate the chain of a URDF, and write the URDF with the numbers that changed.

    python scripts/calibrated_urdf.py [RECORDING URDF] [--out FOLDER]

Without a recording, the bundled 'mobile_skewed' is the machine as built and 'mobile_nonisocentric' its drawing.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import carm_kin


def main() -> None:
    parser = argparse.ArgumentParser(description="Calibrate the chain of a URDF.")
    parser.add_argument("recording", nargs="?", help="left out, one is simulated")
    parser.add_argument("urdf", nargs="?", default="mobile_nonisocentric", help="a file or the name of a bundled one")
    parser.add_argument("--out", type=Path, default=Path("example"), help="folder for what is written")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    if arguments.recording:
        recording = carm_kin.read_recording(arguments.recording)
    else:
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7)

    result = carm_kin.calibrate_chain(recording, arguments.urdf)
    if result.refusal:
        print(result)
        sys.exit(3)
    assert result.chain is not None
    carm_kin.export(result, "urdf", arguments.out / "calibrated.urdf", urdf=arguments.urdf)

    for name, error in (("drawing", result.chain.nominal), ("calibrated", result.chain.calibrated)):
        rms_deg = np.degrees(error.rotation_rms_rad)
        print(f"residuals, {name:<10} {error.translation_rms_m * 1e3:7.3f} mm {rms_deg:6.3f} deg rms")
    for joint in result.chain.joints:
        for axis, value, s in zip("xyz", joint.shift_m, joint.shift_sigma_m, strict=True):
            if axis in joint.estimated:
                print(f"{joint.joint} moved along {axis}: {value * 1e3:8.3f} ± {s * 1e3:.3f} mm")
    for words in result.chain.not_identifiable:
        print(f"not told: {words}")
    print(f"written: {arguments.out / 'calibrated.urdf'}")


if __name__ == "__main__":
    try:
        main()
    except (carm_kin.CarmKinError, OSError) as error:
        sys.exit(f"error: {error}")
