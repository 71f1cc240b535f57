"""Calibrate every recording in a folder: a result for each, a summary, the reasons where there is none.

    python scripts/batch_folder.py [FOLDER] [--out FOLDER]

Without a folder, three recordings of the bundled 'mobile_skewed' are simulated, one of them with one sweep only.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

import carm_kin


def main() -> None:
    parser = argparse.ArgumentParser(description="Calibrate every recording in a folder.")
    parser.add_argument("folder", nargs="?", type=Path, help="left out, recordings are simulated")
    parser.add_argument("--out", type=Path, default=Path("example"), help="folder for what is written")
    arguments = parser.parse_args()

    folder = arguments.folder or simulated(arguments.out / "recordings")
    calibrated = arguments.out / "calibrated"
    carm_kin.batch(folder, calibrated, jobs=2, resume=True)  # what is done and unchanged is not done again

    with (calibrated / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if row["status"] != "ok":
            print(f"{row['label']:<12} {row['status']} ({row['code']}): {row['reason']}")
            continue
        offset = " ".join(f"{float(row[f'offset_{axis}_mm']):9.3f}" for axis in "xyz")
        print(f"{row['label']:<12} offset {offset} mm, major radius {float(row['major_radius_mm']):8.3f} mm")
    print(f"written: {calibrated / 'results'}, {calibrated / 'summary.csv'}")


def simulated(folder: Path) -> Path:
    """The folder with three recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(("monday", "tuesday", "wednesday")):
        recording, _ = carm_kin.simulate("mobile_skewed", sigma_t_m=0.3e-3, sigma_r_rad=np.radians(0.1), seed=seed)
        if name == "tuesday":  # its operator stopped after the first sweep
            recording = recording.select(recording.sweeps[0].poses)
        carm_kin.write_recording(recording, folder / f"{name}.csv")
    return folder


if __name__ == "__main__":  # the worker processes import this file, too
    try:
        main()
    except (carm_kin.CarmKinError, OSError) as error:
        sys.exit(f"error: {error}")
