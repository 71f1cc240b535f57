"""Bags that rosbags writes: trees of frames composed and interpolated, topics of poses, broken bags."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from carm_kin.errors import InputError, MissingDependencyError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import formats, read_recording
from carm_kin.recording.formats._tf import GAP_S

rosbags = pytest.importorskip("rosbags", reason="the extra 'ros' is not installed; pip install 'carm-kin[ros]'")

from rosbags import rosbag1, rosbag2  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

KINDS = {"ros1": ".bag", "mcap": "", "mcap zstd": "", "sqlite3": ""}
STORE = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORE[1].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
N = 20
TIME = 10 + 0.05 * np.arange(N)
MOUNT = Rotation.from_euler("XYZ", [0.3, -0.2, 0.1]), np.array([0.1, 0.2, 0.3])


def cart(time) -> tuple[Rotation, np.ndarray]:
    """A body that turns and travels evenly about z: what lies between two of its poses is known exactly."""
    return Rotation.from_euler("z", 0.4 * np.asarray(time)[:, None]), np.outer(time, [0, 0, 0.2])


def marker(time) -> tuple[Rotation, np.ndarray]:
    angle = np.asarray(time) - 10
    p = np.column_stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), 1 + 0.1 * angle])
    return Rotation.from_euler("ZYX", np.column_stack([angle, 0.2 * angle, 0.1 + 0 * angle])), p


def message(store, kind, parent, child, time, R: Rotation, p):
    """A TransformStamped or a PoseStamped."""
    types = store.types
    names = {"Time": "builtin_interfaces/msg/Time", "Header": "std_msgs/msg/Header"}
    time = round(time * 1e9)
    stamp = types[names["Time"]](sec=time // 10**9, nanosec=time % 10**9)
    more = {"seq": 0} if store is STORE[1] else {}
    header = types[names["Header"]](stamp=stamp, frame_id=parent, **more)
    x, y, z, w = R.as_quat()
    q = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    if kind == "pose":
        point = types["geometry_msgs/msg/Point"](*p)
        pose = types["geometry_msgs/msg/Pose"](position=point, orientation=q)
        return types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose)
    transform = types["geometry_msgs/msg/Transform"](translation=types["geometry_msgs/msg/Vector3"](*p), rotation=q)
    return types["geometry_msgs/msg/TransformStamped"](header=header, child_frame_id=child, transform=transform)


def bag(folder: Path, kind: str, frames=(), poses=()) -> Path:
    """A bag of ``frames``, (parent, child, times, motion, static), and of ``poses``, (topic, parent, times, motion)."""
    version = 1 if kind == "ros1" else 2
    store, path = STORE[version], folder / f"rec{KINDS[kind]}"
    if version == 1:
        writer, serialize = rosbag1.Writer(path), store.serialize_ros1
    else:
        plugin = rosbag2.StoragePlugin.SQLITE3 if kind == "sqlite3" else rosbag2.StoragePlugin.MCAP
        writer, serialize = rosbag2.Writer(path, version=9, storage_plugin=plugin), store.serialize_cdr
        if kind == "mcap zstd":
            writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    rows, topics = [], {}
    for parent, child, times, motion, static in frames:
        for t, R, p in zip(times, *motion, strict=True):
            one = message(store, "transform", parent, child, t, R, p)
            rows.append((t, "/tf_static" if static else "/tf", store.types["tf2_msgs/msg/TFMessage"]([one])))
    for topic, parent, times, motion in poses:
        rows += [
            (t, topic, message(store, "pose", parent, "", t, R, p)) for t, R, p in zip(times, *motion, strict=True)
        ]
    with writer:
        for time, topic, content in sorted(rows, key=lambda row: row[0]):
            type_ = content.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, type_, typestore=store)
            writer.write(topics[topic], round(time * 1e9), serialize(content, type_))
    return path


def tree(times_of_cart) -> list:
    """tracker -> cart -> (fixed) plate, and tracker -> marker -> (fixed) sensor."""
    fixed = [MOUNT[0]], [MOUNT[1]]
    return [
        ("tracker", "cart", times_of_cart, cart(times_of_cart), False),
        ("cart", "plate", [9.0], fixed, True),
        ("tracker", "marker", TIME, marker(TIME), False),
        ("marker", "sensor", [9.0], fixed, True),
    ]


def composed(recording, tool, reference) -> bool:
    """Whether the poses are ``inv(T_tracker_reference) T_tracker_tool`` as SciPy composes them."""
    (Ra, pa), (Rb, pb) = tool, reference
    off = ((Rb.inv() * Ra).inv() * Rotation.from_matrix(recording.R_world_sensor)).magnitude()
    return np.allclose(recording.p_world_sensor, Rb.inv().apply(pa - pb), rtol=0, atol=1e-7) and off.max() < 1e-7


def mounted(body):
    R, p = body
    return R * MOUNT[0], p + R.apply(MOUNT[1])


@pytest.mark.parametrize("kind", KINDS)
def test_the_tree_is_composed(kind, tmp_path):
    path = bag(tmp_path, kind, tree(TIME))
    recording = read_recording(path, declared=Declarations(tool="sensor", reference="plate"))
    assert composed(recording, mounted(marker(TIME)), mounted(cart(TIME)))
    assert np.allclose(recording.time_s, TIME, rtol=0, atol=1e-6)
    alone = read_recording(path, declared=Declarations(tool="sensor"))
    assert composed(alone, mounted(marker(TIME)), (Rotation.identity(), np.zeros(3)))
    assert alone.intakes[0].reference == "tracker"


def test_the_reference_is_interpolated_between_its_times(tmp_path):
    path = bag(tmp_path, "mcap", tree(np.arange(9.9, 11.1, 0.073)))
    recording = read_recording(path, declared=Declarations(tool="sensor", reference="plate"))
    assert composed(recording, mounted(marker(TIME)), mounted(cart(TIME)))


def test_where_the_reference_was_not_seen_the_frame_is_dropped(tmp_path):
    times = np.concatenate([np.arange(10.0, 10.2, 0.05), np.arange(10.2 + GAP_S + 0.03, 10.85, 0.05)])
    path = bag(tmp_path, "mcap", tree(times))
    recording = read_recording(path, declared=Declarations(tool="sensor", reference="plate"))
    known = (times[3] + 1e-6 > TIME) | ((times[4] - 1e-6 < TIME) & (times[-1] + 1e-6 > TIME))
    assert recording.pose_number.tolist() == np.flatnonzero(known).tolist()
    assert recording.intakes[0].in_words() == f"{np.count_nonzero(~known)} gap in time"


def test_a_quaternion_that_is_none_and_a_stamp_that_comes_twice_are_counted(tmp_path):
    R, p = marker(TIME)
    bad = list(R)
    bad[5] = type("Wrong", (), {"as_quat": lambda self: np.array([1.0, 0, 0, 0.2])})()
    again = np.concatenate([TIME, TIME[7:8]])
    frames = [("tracker", "marker", again, ([*bad, R[7]], [*p, p[7]]), False)]
    recording = read_recording(bag(tmp_path, "mcap", frames))
    assert recording.intakes[0].frames == N + 1
    assert recording.intakes[0].in_words() == "1 identical to the frame before, 1 without numbers"


@pytest.mark.parametrize("kind", KINDS)
def test_a_topic_of_poses_is_a_tool(kind, tmp_path):
    path = bag(tmp_path, kind, poses=[("/head", "world", TIME, marker(TIME))])
    recording = read_recording(path)
    assert composed(recording, marker(TIME), (Rotation.identity(), np.zeros(3)))
    assert (recording.intakes[0].tool, recording.intakes[0].reference) == ("/head", "world")


@pytest.mark.parametrize(
    "declared, words",
    [
        ({}, "--tool which frame or topic is the sensor: cart, marker"),
        ({"tool": "nobody"}, "no tool 'nobody'; the file has plate, sensor, cart, marker"),
        ({"tool": "sensor", "reference": "map"}, "--reference: no tool 'map'"),
        ({"tool": "sensor", "reference": "marker"}, "'sensor' does not move against 'marker'"),
    ],
)
def test_what_is_missing_is_named(declared, words, tmp_path):
    path = bag(tmp_path, "ros1", tree(TIME))
    with pytest.raises(InputError, match=words):
        read_recording(path, declared=Declarations(**declared))


def test_frames_in_a_loop_or_with_two_parents_are_refused(tmp_path):
    motion = marker(TIME)
    for name, frames, words in (
        ("loop", [("a", "b", TIME, motion, False), ("b", "a", TIME, motion, False)], "loop"),
        ("two", [("a", "b", TIME, motion, False), ("c", "b", TIME, motion, False)], "several parents: a, c"),
        ("apart", [("a", "b", TIME, motion, False), ("c", "d", TIME, motion, False)], "no chain of frames joins"),
    ):
        (tmp_path / name).mkdir()
        path = bag(tmp_path / name, "ros1", frames)
        with pytest.raises(InputError, match=words):
            read_recording(path, declared=Declarations(tool="b", reference="d" if name == "apart" else None))


@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_bag_is_one_line(kind, tmp_path):
    path = bag(tmp_path, kind, tree(TIME))
    file = path if path.is_file() else max(path.iterdir(), key=lambda f: (f.suffix != ".yaml", f.name))
    whole, rng = file.read_bytes(), np.random.default_rng(0)
    contents = [whole[:end] for end in range(0, len(whole), max(1, len(whole) // 25))]
    for _ in range(25):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] = rng.integers(256)
        contents.append(bytes(damaged))
    for content in contents:
        file.write_bytes(content)
        found = outcome(path)
        assert "\n" not in found if isinstance(found, str) else found <= N


def outcome(path) -> int | str:
    """The number of frames, or the message of the error."""
    try:
        return read_recording(path, "ros", Declarations(tool="sensor")).intakes[0].frames
    except InputError as error:
        return str(error)


def test_a_bag_without_poses_is_refused(tmp_path):
    with rosbag1.Writer(tmp_path / "empty.bag"):
        pass
    with pytest.raises(InputError, match="holds no tf"):
        read_recording(tmp_path / "empty.bag")


def test_without_rosbags_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    (tmp_path / "rec.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(MissingDependencyError, match=r"pip install 'carm-kin\[ros\]'"):
        read_recording(tmp_path / "rec.bag")
    assert "ros" in formats()
