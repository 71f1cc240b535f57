"""carm-kin: radiation-free calibration of C-arms and the sensors attached to them.

recording = carm_kin.read_recording("rec.csv")
result = carm_kin.calibrate(recording)
result.offset_sensor_pivot_m, result.sigma.offset_sensor_pivot_m

Everything here is listed in `_HOME`, and imported when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from carm_kin.version import __version__ as __version__

if TYPE_CHECKING:
    from carm_kin.calibrated.check import check as check
    from carm_kin.calibrated.rotation_centre import RotationCentre as RotationCentre
    from carm_kin.calibrated.virtual_centre import virtual_centre as virtual_centre
    from carm_kin.calibrated.xray import Detector as Detector
    from carm_kin.calibrated.xray import Xray as Xray
    from carm_kin.calibration.calibrate import calibrate as calibrate
    from carm_kin.calibration.cross_validate import cross_validate as cross_validate
    from carm_kin.errors import CarmKinError as CarmKinError
    from carm_kin.errors import InputError as InputError
    from carm_kin.errors import MissingDependencyError as MissingDependencyError
    from carm_kin.recording.declarations import Declarations as Declarations
    from carm_kin.recording.formats import read_recording as read_recording
    from carm_kin.recording.formats import write_recording as write_recording
    from carm_kin.recording.recording import Recording as Recording
    from carm_kin.results.result import CalibrationResult as CalibrationResult
    from carm_kin.simulation.simulate import simulate as simulate

_HOME = {
    "CalibrationResult": "carm_kin.results.result",
    "CarmKinError": "carm_kin.errors",
    "Declarations": "carm_kin.recording.declarations",
    "Detector": "carm_kin.calibrated.xray",
    "InputError": "carm_kin.errors",
    "MissingDependencyError": "carm_kin.errors",
    "Recording": "carm_kin.recording.recording",
    "RotationCentre": "carm_kin.calibrated.rotation_centre",
    "Xray": "carm_kin.calibrated.xray",
    "calibrate": "carm_kin.calibration.calibrate",
    "check": "carm_kin.calibrated.check",
    "cross_validate": "carm_kin.calibration.cross_validate",
    "read_recording": "carm_kin.recording.formats",
    "simulate": "carm_kin.simulation.simulate",
    "virtual_centre": "carm_kin.calibrated.virtual_centre",
    "write_recording": "carm_kin.recording.formats",
}
"""Name -> the module in which it lives."""

__all__ = [*_HOME]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
