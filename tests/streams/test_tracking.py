"""Poses in OpenIGTLink messages, against layouts written by hand and rotations from SciPy."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carm_kin.streams import tracking
from carm_kin.streams.openigtlink import Message
from carm_kin.streams.tracking import observations

TURN = Rotation.from_euler("xyz", [20, -35, 50], degrees=True)
AT_MM = (10.5, -20.25, 300.0)


def matrix_bytes(R: np.ndarray, p_mm=AT_MM) -> bytes:
    """Twelve floats: the columns of the rotation, then the position."""
    return struct.pack(">12f", *R[:, 0], *R[:, 1], *R[:, 2], *p_mm)


def transform(R: np.ndarray, p_mm=AT_MM, **metadata: str) -> Message:
    return Message("TRANSFORM", "Tool", matrix_bytes(R, p_mm), 1.5, 3, metadata)


def assert_is_the_pose(T: np.ndarray | None) -> None:
    assert T is not None
    np.testing.assert_allclose(T[:3, :3], TURN.as_matrix(), atol=2e-7)
    np.testing.assert_allclose(T[:3, 3], np.array(AT_MM) / 1000, atol=1e-8)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)


def test_transform():
    (one,) = observations(transform(TURN.as_matrix()))
    assert (one.tool, one.stamp_s, one.number, one.fault) == ("Tool", 1.5, 3, "")
    assert_is_the_pose(one.T)


def test_tdata_has_many_tools():
    element = struct.pack(">20sBB", b"Marker", 2, 0) + matrix_bytes(TURN.as_matrix())
    other = struct.pack(">20sBB", b"Reference-with-20-by", 1, 9) + matrix_bytes(np.eye(3), (1, 2, 3))
    first, second = observations(Message("TDATA", "Tracker", element + other, 2.0))
    assert (first.tool, second.tool) == ("Marker", "Reference-with-20-by")
    assert_is_the_pose(first.T)
    np.testing.assert_allclose(second.T[:3, 3], [0.001, 0.002, 0.003])
    assert observations(Message("TDATA", "Tracker", b"")) == []


def test_qtdata_has_w_last():
    x, y, z, w = TURN.as_quat()
    element = struct.pack(">20sBB7f", b"Marker", 2, 0, *AT_MM, x, y, z, w)
    (one,) = observations(Message("QTDATA", "Tracker", element))
    assert one.tool == "Marker"
    assert_is_the_pose(one.T)


@pytest.mark.parametrize("kind", ["POSITION", "QTRANS"])
@pytest.mark.parametrize("elements", [3, 4])
def test_position(kind, elements):
    quaternion = TURN.as_quat(canonical=True)[:elements]
    (one,) = observations(Message(kind, "Tool", struct.pack(f">{3 + elements}f", *AT_MM, *quaternion)))
    assert_is_the_pose(one.T)


def test_position_alone_is_no_pose():
    (one,) = observations(Message("POSITION", "Tool", struct.pack(">3f", *AT_MM)))
    assert (one.T, one.fault) == (None, tracking.NO_ORIENTATION)


@pytest.mark.parametrize(
    "message, fault",
    [
        (transform(TURN.as_matrix(), TransformValid="False"), "invalid"),
        (transform(TURN.as_matrix(), TransformValid="false"), "invalid"),
        (transform(TURN.as_matrix(), TransformValid="0"), "invalid"),
        (transform(TURN.as_matrix(), TransformStatus="OUT_OF_VIEW"), "OUT_OF_VIEW"),
        (transform(TURN.as_matrix(), TransformStatus="x" * 5000), "X" * 30),
        (transform(TURN.as_matrix(), (np.nan, 0, 0)), "not finite"),
        (transform(TURN.as_matrix(), (np.inf, 0, 0)), "not finite"),
        (transform(np.full((3, 3), np.nan)), "not finite"),
        (transform(1.01 * TURN.as_matrix()), "not a rotation"),
        (transform(np.full((3, 3), 3e38)), "not a rotation"),
        (transform(np.zeros((3, 3))), "not a rotation"),
        (transform(np.diag([1.0, 1.0, -1.0])), "not a rotation"),
        (transform(TURN.as_matrix(), (1e30, 0, 0)), "out of range"),
        (transform(np.eye(3), (0, 0, 0)), "identity placeholder"),
        (Message("QTDATA", "T", struct.pack(">20sBB7f", b"M", 2, 0, *AT_MM, 0, 0, 0, 0)), "not a rotation"),
        (Message("POSITION", "T", struct.pack(">7f", *AT_MM, np.nan, 0, 0, 1)), "not finite"),
        (Message("POSITION", "T", struct.pack(">6f", *AT_MM, 1, 1, 1)), "not a rotation"),
    ],
)
def test_what_is_no_pose_says_why(message, fault):
    (one,) = observations(message)
    assert (one.T, one.fault) == (None, fault)


@pytest.mark.parametrize("status", [{}, {"TransformStatus": "OK"}, {"TransformValid": "True", "TransformStatus": ""}])
def test_what_is_valid_is_used(status):
    assert_is_the_pose(observations(transform(TURN.as_matrix(), **status))[0].T)


def test_rounded_matrices_become_rotations():
    (one,) = observations(transform(TURN.as_matrix() + 2e-4))
    np.testing.assert_allclose(one.T[:3, :3] @ one.T[:3, :3].T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize("kind", tracking.TYPES)
def test_a_size_that_is_none_of_the_type(kind):
    with pytest.raises(ValueError):
        observations(Message(kind, "Tool", bytes(13)))


def test_written_poses_have_the_layout_of_the_protocol():
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = TURN.as_matrix(), np.array(AT_MM) / 1000
    expected = np.frombuffer(matrix_bytes(TURN.as_matrix()), ">f4")
    np.testing.assert_allclose(np.frombuffer(tracking.transform_message("A", T, 1.0).content, ">f4"), expected, 1e-6)
    tdata = tracking.tdata_message("Tracker", [("A", T), ("B", T)], 1.0).content
    assert (len(tdata), tdata[:22], tdata[70:72]) == (140, b"A".ljust(20, b"\0") + b"\2\0", b"B\0")
    np.testing.assert_allclose(np.frombuffer(tdata[22:70], ">f4"), expected, 1e-6)
    qtdata = tracking.qtdata_message("Tracker", [("A", T)], 1.0).content
    assert (len(qtdata), qtdata[:22]) == (50, tdata[:22])
    numbers = np.frombuffer(qtdata[22:], ">f4")
    np.testing.assert_allclose(numbers, [*AT_MM, *TURN.as_quat(canonical=True)], atol=1e-4)


def test_an_unseen_tool_is_written_as_invalid():
    (one,) = observations(tracking.transform_message("A", None, 1.0))
    assert (one.T, one.fault) == (None, "MISSING")


def test_asking_for_tdata_has_the_layout_of_the_protocol():
    message = tracking.start_tdata(50)
    assert (message.type, message.content) == ("STT_TDATA", struct.pack(">i", 50) + bytes(32))
