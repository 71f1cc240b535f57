"""The report of a calibration: one HTML page that opens without a network, and static figures.

`write_report` tells of one result, `write_summary` of many; `write_figures` writes SVG and PNG for papers.
"""

from carm_kin.report.files import write_figures
from carm_kin.report.poses import Joints, together
from carm_kin.report.single import write_report
from carm_kin.report.summary import write_summary

__all__ = ["Joints", "together", "write_figures", "write_report", "write_summary"]
