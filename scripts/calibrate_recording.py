"""Calibrate one recording: the numbers, the result as JSON, the report as one HTML page.

    python scripts/calibrate_recording.py [RECORDING] [--out FOLDER]

Without a recording, that of the bundled C-arm 'mobile_skewed' is simulated.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import carm_kin


def main() -> None:
    parser = argparse.ArgumentParser(description="Calibrate one recording.")
    parser.add_argument("recording", nargs="?", help="a file or folder that carm-kin reads; left out, one is simulated")
    parser.add_argument("--out", type=Path, default=Path("example"), help="folder for what is written")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    if arguments.recording:
        recording = carm_kin.read_recording(arguments.recording)
    else:
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=7)

    result = carm_kin.calibrate(recording)
    result.to_json(arguments.out / "result.json")
    carm_kin.write_report(result, recording, arguments.out / "report.html")
    print(result)
    if result.refusal:  # the data do not support a result: its numbers are None
        sys.exit(3)
    print("the offset in metres:", result.offset_sensor_pivot_m)
    print(f"written: {arguments.out / 'result.json'}, {arguments.out / 'report.html'}")


if __name__ == "__main__":
    try:
        main()
    except (carm_kin.CarmKinError, OSError) as error:
        sys.exit(f"error: {error}")
