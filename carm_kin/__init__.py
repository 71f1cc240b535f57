"""carm-kin: radiation-free calibration of C-arms and the sensors attached to them.

recording = carm_kin.read_recording("rec.csv")
result = carm_kin.calibrate(recording)
result.offset_sensor_pivot_m, result.sigma.offset_sensor_pivot_m
"""

from carm_kin.calibrated.check import check
from carm_kin.calibrated.rotation_centre import RotationCentre
from carm_kin.calibrated.virtual_centre import virtual_centre
from carm_kin.calibrated.xray import Detector, Xray
from carm_kin.calibration.calibrate import calibrate
from carm_kin.calibration.cross_validate import cross_validate
from carm_kin.errors import CarmKinError, InputError, MissingDependencyError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import read_recording, write_recording
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from carm_kin.simulation.simulate import simulate

__version__ = "0.1.0"
__all__ = [
    "CalibrationResult",
    "CarmKinError",
    "Declarations",
    "Detector",
    "InputError",
    "MissingDependencyError",
    "Recording",
    "RotationCentre",
    "Xray",
    "calibrate",
    "check",
    "cross_validate",
    "read_recording",
    "simulate",
    "virtual_centre",
    "write_recording",
]
