"""Files as trackers write them, made by hand from poses of a closed form, and how many frames a cut one still holds."""

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from carm_kin.recording.declarations import Declarations
from carm_kin.recording.recording import Recording
from carm_kin.testing import format as contract
from carm_kin.testing.format import written

__all__ = [
    "FREE",
    "MAKERS",
    "MATRIX",
    "MM",
    "ROTATION",
    "TIME",
    "WXYZ",
    "XYZW",
    "N",
    "P",
    "Sample",
    "assert_poses",
    "written",
]

FREE = Declarations()
N = 30
ANGLE = np.linspace(0.1, 1.5, N)
P = np.column_stack([0.6 * np.cos(ANGLE), 0.6 * np.sin(ANGLE), 1.5 + 0.1 * ANGLE])
"""(N, 3), m."""
ROTATION = Rotation.from_euler("ZYX", np.column_stack([ANGLE, 0.3 * np.sin(3 * ANGLE), 0.5 - 0.2 * ANGLE]))
TIME = 100 + 0.02 * np.arange(N)
MM = P * 1e3
XYZW = ROTATION.as_quat()
WXYZ = np.roll(XYZW, 1, axis=1)
MATRIX = np.tile(np.eye(4), (N, 1, 1))
MATRIX[:, :3, :3], MATRIX[:, :3, 3] = ROTATION.as_matrix(), P


@dataclass(frozen=True)
class Sample(contract.Sample):
    """A sound file of one format with the N poses."""

    p_world_sensor: np.ndarray = field(default_factory=lambda: P)
    R_world_sensor: np.ndarray = field(default_factory=ROTATION.as_matrix)
    time_s: np.ndarray | None = field(default_factory=lambda: TIME)
    header: int | None = 0
    delimiter: str = ","
    """Between cells; "" where the file is no table."""
    fixed: bool = False
    """The columns have no names and cannot be exchanged."""


def table(header: str, rows: np.ndarray, delimiter: str = ",", before: str = "") -> bytes:
    """Header lines, and a line a row."""
    lines = [before + delimiter.join(f"{x:.9f}" for x in row) for row in rows]
    return "\n".join([*([header] if header else []), *lines, ""]).encode()


def native() -> Sample:
    rows = np.column_stack([MM, WXYZ, TIME])
    return Sample("csv", "rec.csv", table("x_mm,y_mm,z_mm,qw,qx,qy,qz,time_s", rows), header=1)


def plus() -> Sample:
    lines = ["ObjectType = Image", "NDims = 3", f"DimSize = 0 0 {N}", "Kinds = domain domain list"]
    T = MATRIX.copy()
    T[:, :3, 3] *= 1e3
    for i, (matrix, time) in enumerate(zip(T, TIME, strict=True)):
        key = f"Seq_Frame{i:04d}_"
        lines.append(f"{key}MarkerToTrackerTransform = " + " ".join(f"{x:.9f}" for x in matrix.ravel()))
        lines += [f"{key}MarkerToTrackerTransformStatus = OK ", f"{key}Timestamp = {time}"]
    return Sample("plus", "rec.igs.mha", "\n".join([*lines, "ElementDataFile = LOCAL", ""]).encode(), header=None)


def nrrd() -> Sample:
    text = plus().content.decode().split("\n")[4:-2]
    head = ["NRRD0005", "type: unsigned char", "dimension: 3", f"sizes: 1 1 {N}", "kinds: domain domain list"]
    body = [line.replace(" = ", ":=", 1) for line in text]
    content = "\n".join([*head, *body, "", ""]).encode() + bytes(N)
    return Sample("plus", "rec.igs.nrrd", content, header=None)


def ndi() -> Sample:
    rows = np.column_stack([WXYZ, MM, np.full(N, 0.2)])
    lines = [f"1,2,{500 + i},1,OK," + ",".join(f"{x:.9f}" for x in row) for i, row in enumerate(rows)]
    header = "Tools,Port 2: Marker  s/n:1A2B,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    return Sample("ndi", "ndi.csv", "\n".join([header, *lines, ""]).encode(), header=1, time_s=None)


def ndi_euler() -> Sample:
    rows = np.column_stack([ROTATION.as_euler("ZYX", degrees=True), MM, np.full(N, 0.2)])
    lines = [
        f"1,Port 2: Marker,{500 + i},1,OK," + ",".join(f"{x:.9f}" for x in row) + ",4" for i, row in enumerate(rows)
    ]
    header = "Tools,Port 2: Marker,Frame,Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers"
    return Sample("ndi", "ndi_euler.csv", "\n".join([header, *lines, ""]).encode(), header=1, time_s=None)


def ndi_capi() -> Sample:
    lines = []
    for i, row in enumerate(np.column_stack([WXYZ, MM, np.full(N, 0.2)])):
        numbers = ",".join(f"{x:.9f}" for x in row)
        lines.append(f"1,Marker s/n:1A2B,{500 + i},Port:2,0,OK,{numbers},1,OK,1.0,2.0,3.0")
    header = "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers"
    header += ",Marker0.Status,Tx,Ty,Tz"
    return Sample("ndi", "ndi_capi.csv", "\n".join([header, *lines, ""]).encode(), header=1, time_s=None, fixed=True)


def motive() -> Sample:
    header = [
        f"Format Version,1.23,Take Name,Test,Total Exported Frames,{N}"
        ",Rotation Type,Quaternion,Length Units,Millimeters",
        "",
        ",," + ",".join(["Rigid Body"] * 7 + ["Marker"] * 3),
        ",," + ",".join(["C-arm"] * 7 + ["C-arm:Marker1"] * 3),
        ",," + ",".join(["4A"] * 7 + ["5B"] * 3),
        ",," + ",".join(["Rotation"] * 4 + ["Position"] * 6),
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z",
    ]
    rows = np.column_stack([np.arange(N), TIME, XYZW, MM, MM + 5])
    return Sample("motive", "take.csv", table("\n".join(header), rows), header=7)


def tum() -> Sample:
    rows = np.column_stack([TIME, P, XYZW])
    return Sample("tum", "traj.txt", table("# time x y z qx qy qz qw", rows, " "), header=1, delimiter=" ", fixed=True)


def custom() -> Sample:
    rows = np.column_stack([TIME, MM, WXYZ])
    content = table("my log\ntime_s,Xa,Ya,Za,qoa,qxa,qya,qza", rows)
    return Sample("table", "log.csv", content, declared=Declarations(unit="mm"), header=2)


def hololens_json() -> Sample:
    """The frames of a left-handed world: z is negated, and with it the sense of the angles about x and y."""
    p = P * [1, 1, -1]
    y, x, z = ROTATION.as_euler("YXZ", degrees=True).T
    poses = [
        {"time_s": t, "Tx": a, "Ty": b, "Tz": c, "Rx": -rx, "Ry": -ry, "Rz": rz}
        for t, (a, b, c), rx, ry, rz in zip(TIME, p.tolist(), x, y, z, strict=True)
    ]
    content = "\n".join(map(json.dumps, poses)) + "\n"
    declared = Declarations(left_handed=True)
    return Sample("hololens", "head.json", content.encode(), declared=declared, header=0, delimiter="")


def hololens_lines() -> Sample:
    rows = [f"{int(t * 1e7)}," + ",".join(f"{x:.9f}" for x in T.ravel()) for t, T in zip(TIME, MATRIX, strict=True)]
    return Sample("hololens", "rig2world.txt", "\n".join([*rows, ""]).encode(), header=0, fixed=True)


def tfm() -> Sample:
    """Poses of the child in RAS; the file maps LPS points of the parent to the child, about a centre."""
    flip, center = np.diag([-1.0, -1.0, 1.0, 1.0]), np.array([10.0, -20.0, 30.0])
    lines = ["#Insight Transform File V1.0"]
    for i in range(N):
        T = MATRIX[i].copy()
        T[:3, 3] *= 1e3
        M = flip @ np.linalg.inv(T) @ flip
        t = M[:3, 3] - center + M[:3, :3] @ center
        lines += [f"# Transform {i}", "Transform: AffineTransform_double_3_3"]
        lines.append("Parameters: " + " ".join(f"{x:.12f}" for x in [*M[:3, :3].ravel(), *t]))
        lines.append("FixedParameters: 10 -20 30")
    return Sample("tfm", "poses.tfm", "\n".join([*lines, ""]).encode(), header=None, time_s=None, delimiter="")


def npz() -> Sample:
    file = io.BytesIO()
    np.savez(file, T_tracker_marker_m=MATRIX, time_s=TIME)
    return Sample("npz", "rec.npz", file.getvalue(), header=None, delimiter="")


def mat() -> Sample:
    file = io.BytesIO()
    savemat(file, {"p_mm": MM, "quat_xyzw": XYZW, "time_s": TIME})
    return Sample("mat", "rec.mat", file.getvalue(), header=None, delimiter="")


MAKERS: dict[str, Callable[[], Sample]] = {
    make.__name__: make
    for make in (
        *(native, plus, nrrd, ndi, ndi_euler, ndi_capi, motive, tum, custom),
        *(hololens_json, hololens_lines, tfm, npz, mat),
    )
}


def assert_poses(recording: Recording, frames=slice(None)) -> None:
    """The poses are those of the frames, to 1e-6 m and 1e-6 rad."""
    contract.assert_poses(recording, Sample("", "", b""), frames)
