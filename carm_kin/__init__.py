"""carm-kin: radiation-free calibration of C-arms and the sensors attached to them.

    result = carm_kin.calibrate("rec.csv")
    print(result)
    result.offset_sensor_pivot_m, result.sigma.offset_sensor_pivot_m

Everything here is listed in `_HOME`, and imported when it is first used. docs/python.md has an example of each.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from carm_kin.version import __version__ as __version__

if TYPE_CHECKING:
    from carm_kin.batches.batch import batch as batch
    from carm_kin.calibrated.check import check as check
    from carm_kin.calibrated.isocentre import isocentre as isocentre
    from carm_kin.calibrated.rotation_centre import RotationCentre as RotationCentre
    from carm_kin.calibrated.virtual_centre import virtual_centre as virtual_centre
    from carm_kin.calibrated.xray import Detector as Detector
    from carm_kin.calibrated.xray import Xray as Xray
    from carm_kin.calibration.calibrate import calibrate as calibrate
    from carm_kin.calibration.chain.calibrate import FreeJoints as FreeJoints
    from carm_kin.calibration.chain.calibrate import calibrate_chain as calibrate_chain
    from carm_kin.calibration.cross_validate import cross_validate as cross_validate
    from carm_kin.calibration.settings import Settings as Settings
    from carm_kin.errors import CarmKinError as CarmKinError
    from carm_kin.errors import InputError as InputError
    from carm_kin.errors import MissingDependencyError as MissingDependencyError
    from carm_kin.errors import RefusedError as RefusedError
    from carm_kin.exports import export as export
    from carm_kin.machine.machine import Machine as Machine
    from carm_kin.machine.urdf import UrdfFile as UrdfFile
    from carm_kin.machine.urdf import read_urdf as read_urdf
    from carm_kin.quality.trend import Trend as Trend
    from carm_kin.quality.trend import trend as trend
    from carm_kin.recording.declarations import Declarations as Declarations
    from carm_kin.recording.formats import read_recording as read_recording
    from carm_kin.recording.formats import write_recording as write_recording
    from carm_kin.recording.recording import Recording as Recording
    from carm_kin.report import Joints as Joints
    from carm_kin.report import write_figures as write_figures
    from carm_kin.report import write_report as write_report
    from carm_kin.report import write_summary as write_summary
    from carm_kin.results.check_result import Check as Check
    from carm_kin.results.isocentre_result import Isocentre as Isocentre
    from carm_kin.results.result import CalibrationResult as CalibrationResult
    from carm_kin.results.result import read_result as read_result
    from carm_kin.results.virtual_centre_result import VirtualCentre as VirtualCentre
    from carm_kin.simulation.simulate import simulate as simulate
    from carm_kin.study.compare import Comparison as Comparison
    from carm_kin.study.compare import compare as compare

_HOME = {
    "CalibrationResult": "carm_kin.results.result",
    "CarmKinError": "carm_kin.errors",
    "Check": "carm_kin.results.check_result",
    "Comparison": "carm_kin.study.compare",
    "Declarations": "carm_kin.recording.declarations",
    "Detector": "carm_kin.calibrated.xray",
    "FreeJoints": "carm_kin.calibration.chain.calibrate",
    "InputError": "carm_kin.errors",
    "Isocentre": "carm_kin.results.isocentre_result",
    "Joints": "carm_kin.report",
    "Machine": "carm_kin.machine.machine",
    "MissingDependencyError": "carm_kin.errors",
    "Recording": "carm_kin.recording.recording",
    "RefusedError": "carm_kin.errors",
    "RotationCentre": "carm_kin.calibrated.rotation_centre",
    "Settings": "carm_kin.calibration.settings",
    "Trend": "carm_kin.quality.trend",
    "UrdfFile": "carm_kin.machine.urdf",
    "VirtualCentre": "carm_kin.results.virtual_centre_result",
    "Xray": "carm_kin.calibrated.xray",
    "batch": "carm_kin.batches.batch",
    "calibrate": "carm_kin.calibration.calibrate",
    "calibrate_chain": "carm_kin.calibration.chain.calibrate",
    "check": "carm_kin.calibrated.check",
    "compare": "carm_kin.study.compare",
    "cross_validate": "carm_kin.calibration.cross_validate",
    "export": "carm_kin.exports",
    "isocentre": "carm_kin.calibrated.isocentre",
    "read_recording": "carm_kin.recording.formats",
    "read_result": "carm_kin.results.result",
    "read_urdf": "carm_kin.machine.urdf",
    "simulate": "carm_kin.simulation.simulate",
    "trend": "carm_kin.quality.trend",
    "virtual_centre": "carm_kin.calibrated.virtual_centre",
    "write_figures": "carm_kin.report",
    "write_recording": "carm_kin.recording.formats",
    "write_report": "carm_kin.report",
    "write_summary": "carm_kin.report",
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
