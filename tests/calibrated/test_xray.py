"""The projection matrix against a pinhole made by hand from Pinocchio's frames: a ray, a plane and a pixel grid."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import carm_kin
from carm_kin.calibrated.xray import Detector, Xray
from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import bundled_urdfs, read_urdf
from carm_kin.results.result import CalibrationResult
from helpers.simulated import frame

DETECTOR = Detector(pixel_m=0.3e-3, columns=1024, rows=768)

MOBILE = ("mobile_isocentric", "mobile_nonisocentric", "mobile_skewed")
BUNDLED = [name for name in bundled_urdfs() if {"source", "detector", "sensor"} <= {*read_urdf(name).links}]

TILTED = """<robot name="tilted">
  <link name="floor"/> <link name="cart"/> <link name="swivel"/> <link name="c_arm"/> <link name="rail"/>
  <link name="source"/> <link name="detector"/> <link name="lateral_source"/> <link name="lateral_detector"/>
  <link name="sensor"/> <link name="collimator"/> <link name="table"/>
  <joint name="lift" type="prismatic"><parent link="floor"/><child link="cart"/><origin xyz="0.2 0 0.8"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.4"/></joint>
  <joint name="angular" type="revolute"><parent link="cart"/><child link="swivel"/><origin xyz="0.5 0 0" rpy="0 0.1 0"/>
    <axis xyz="1 0 0"/><limit lower="-2" upper="2"/></joint>
  <joint name="orbital" type="revolute"><parent link="swivel"/><child link="c_arm"/>
    <origin xyz="0.8 0.05 {offset}" rpy="0.02 0 0.01"/><axis xyz="0 1 0"/><limit lower="-1" upper="2"/></joint>
  <joint name="rail" type="fixed"><parent link="c_arm"/><child link="rail"/>
    <origin xyz="0.01 0.02 0.03" rpy="0.3 0 0"/></joint>
  <joint name="source" type="fixed"><parent link="rail"/><child link="source"/><origin xyz="0 0.02 -0.5"/></joint>
  <joint name="detector" type="fixed"><parent link="c_arm"/><child link="detector"/>
    <origin xyz="0.02 -0.03 0.6" rpy="3.1 0.05 0.4"/></joint>
  <joint name="lateral_source" type="fixed"><parent link="c_arm"/><child link="lateral_source"/>
    <origin xyz="0 -0.7 0.1"/></joint>
  <joint name="lateral_detector" type="fixed"><parent link="c_arm"/><child link="lateral_detector"/>
    <origin xyz="0 0.4 0.1" rpy="-1.5707963 0 0"/></joint>
  <joint name="sensor" type="fixed"><parent link="rail"/><child link="sensor"/>
    <origin xyz="0.1 0.1 0.7" rpy="1 2 3"/></joint>
  <joint name="shutter" type="prismatic"><parent link="source"/><child link="collimator"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.1"/></joint>
  <joint name="table" type="fixed"><parent link="floor"/><child link="table"/></joint>
</robot>
"""


def tilted(folder: Path, offset: float = 0.1) -> str:
    """A machine whose detector is tilted and looks away from the source, with a second plane."""
    path = folder / "tilted.urdf"
    path.write_text(TILTED.format(offset=offset))
    return str(path)


@pytest.fixture(scope="module")
def machines(tmp_path_factory) -> dict[str, str]:
    return {name: name for name in BUNDLED} | {"tilted": tilted(tmp_path_factory.mktemp("urdf"))}


def by_hand(T_source: np.ndarray, T_detector: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) and depths (N,) of points X (N, 3): the ray from the focal spot meets the plane."""
    s, o = T_source[:3, 3], T_detector[:3, 3]
    x, y, z = T_detector[:3, :3].T
    ray = X - s
    hit = s + ray * ((o - s) @ z / (ray @ z))[:, None]
    middle = np.array([(DETECTOR.columns - 1) / 2, (DETECTOR.rows - 1) / 2])
    pixels = middle + np.stack([(hit - o) @ x, (hit - o) @ y], axis=1) / DETECTOR.pixel_m
    return pixels, ray @ z * np.sign((o - s) @ z)


def projected(P: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image = np.concatenate([X, np.ones((len(X), 1))], axis=1) @ P.T
    return image[:, :2] / image[:, 2:], image[:, 2]


def frames(urdf: str, links: tuple[str, ...], q: np.ndarray) -> list[np.ndarray]:
    """T_base_link (4, 4) of each link by Pinocchio, q of the sensor's chain."""
    file = read_urdf(urdf)
    return [Model(file, chain_of(file, link)).forward_kinematics(q)[0] for link in links]


def posed(urdf: str, seed: int) -> np.ndarray:
    chain = chain_of(read_urdf(urdf))
    low, high = np.maximum(chain.lower, -3), np.minimum(chain.upper, 3)
    return np.random.default_rng(seed).uniform(low, high)[None]


def points(T_source: np.ndarray, T_detector: np.ndarray, seed: int) -> np.ndarray:
    """Between the source and the detector, m."""
    rng = np.random.default_rng(seed)
    middle = T_source[:3, 3] + (T_detector[:3, 3] - T_source[:3, 3]) * rng.uniform(0.3, 0.95, (20, 1))
    return middle + rng.uniform(-0.05, 0.05, (20, 3))


@pytest.mark.parametrize("machine", [*BUNDLED, "tilted"])
@pytest.mark.parametrize("seed", range(3))
def test_a_pinhole_by_hand(machines, machine, seed):
    """In the base, in the world and in the frame of a sensor that is mounted elsewhere than in the drawing."""
    urdf, mount = machines[machine], frame(np.random.default_rng(seed), 0.2)
    _, truth = carm_kin.simulate(urdf, "minimal", T_sensor_mount=mount)
    T_sensor, T_source, T_detector = frames(urdf, ("sensor", "source", "detector"), posed(urdf, seed))
    T_world_base = frame(np.random.default_rng([seed, 1]), 2.0)
    T_world_sensor = T_world_base @ T_sensor @ mount
    X = points(T_source, T_detector, seed)
    pixels, depth = by_hand(T_source, T_detector, X)
    xray = Xray.of_urdf(urdf, DETECTOR)
    X_world = X @ T_world_base[:3, :3].T + T_world_base[:3, 3]
    X_sensor = (X_world - T_world_sensor[:3, 3]) @ T_world_sensor[:3, :3]
    for P, where in (
        (xray.P_image_world(truth, T_world_sensor[None])[0], X_world),
        (xray.P_image_sensor(truth), X_sensor),
    ):
        found, found_depth = projected(P, where)
        np.testing.assert_allclose(found, pixels, atol=1e-7)
        np.testing.assert_allclose(found_depth, depth, atol=1e-12)
        assert (depth > 0).all()


def test_the_second_plane(machines):
    urdf = machines["tilted"]
    T_sensor, T_source, T_detector = frames(urdf, ("sensor", "lateral_source", "lateral_detector"), posed(urdf, 1))
    xray = Xray.of_urdf(urdf, DETECTOR, source_link="lateral_source", detector_link="lateral_detector")
    _, truth = carm_kin.simulate(urdf, "minimal")
    X = points(T_source, T_detector, 1)
    found, _ = projected(xray.P_image_world(truth, T_sensor)[0], X)
    np.testing.assert_allclose(found, by_hand(T_source, T_detector, X)[0], atol=1e-7)


def test_numbers_by_hand():
    """1020 mm from the source to the detector, whose middle the beam meets; a point halfway is seen twice as large."""
    xray = Xray.of_urdf("mobile_nonisocentric", DETECTOR)
    assert xray.focal_length_m == pytest.approx(1.02)
    np.testing.assert_allclose(xray.K, [[3400, 0, 511.5], [0, 3400, 383.5], [0, 0, 1]], atol=1e-9)
    source = xray.T_carm_source[:3, 3]
    halfway = source + xray.T_carm_detector[:3, :3] @ [0.003, -0.006, 0.51]
    pixel, depth = projected(xray.P_image_carm, halfway[None])
    np.testing.assert_allclose(pixel, [[511.5 + 20, 383.5 - 40]], atol=1e-9)
    assert depth == pytest.approx(0.51)
    np.testing.assert_allclose(xray.P_image_carm @ np.append(source, 1), 0, atol=1e-9)
    in_mm = xray.P_image_carm @ np.diag([1e-3, 1e-3, 1e-3, 1])
    np.testing.assert_allclose(projected(in_mm, 1e3 * halfway[None])[0], pixel, atol=1e-9)


def test_the_corner_pixels():
    """A detector of 2 x 2 pixels: their middles lie half a pixel off the middle of the face."""
    eye, face = np.eye(4), np.eye(4)
    face[2, 3] = 1.0
    xray = Xray(Detector(0.1, 2, 2), eye, face, 0.1)
    pixel, _ = projected(xray.P_image_carm, np.array([[-0.05, -0.05, 1.0], [0.05, -0.05, 1.0]]))
    np.testing.assert_allclose(pixel, [[0, 0], [1, 0]], atol=1e-12)


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_nothing_depends_on_the_sensor_or_the_world(seed):
    """A calibrated sensor in another mount, seen from another world: the same image of the same things."""
    rng = np.random.default_rng(seed)
    mount, M, T, X = (frame(rng, 0.5) for _ in range(4))
    xray = Xray.of_urdf("mobile_skewed", DETECTOR)
    _, truth = carm_kin.simulate("mobile_skewed", "minimal")
    moved = replace(truth, T_sensor_carm=np.linalg.inv(mount) @ truth.T_sensor_carm)
    P = xray.P_image_world(truth, T)
    np.testing.assert_allclose(xray.P_image_world(moved, M @ T @ mount) @ M, P, atol=1e-9 * np.abs(P).max())
    assert xray.P_image_world(truth, np.stack([T, X])).shape == (2, 3, 4)


@pytest.mark.parametrize("machine", [*MOBILE, "tilted"])
def test_a_calibration_with_labels_gives_the_projection_of_the_urdf(machines, machine):
    """From poses without noise, through the default solver."""
    recording, truth = carm_kin.simulate(machines[machine], "clinical")
    result, xray = carm_kin.calibrate(recording), Xray.of_urdf(machines[machine], DETECTOR)
    expected = xray.P_image_sensor(truth)
    np.testing.assert_allclose(xray.P_image_sensor(result), expected, atol=1e-6 * np.abs(expected).max())


def unlabelled(urdf: str, joint: str) -> CalibrationResult:
    recording, _ = carm_kin.simulate(urdf, "minimal")
    joints = {name: values for name, values in recording.joints.items() if name != joint}
    return carm_kin.calibrate(replace(recording, joints=joints))


def three_zeros(urdf: str) -> CalibrationResult:
    """Calibrated with the orbital angle known in three angular sweeps, the angular one nowhere."""
    recording, _ = carm_kin.simulate(urdf, "clinical")
    return carm_kin.calibrate(replace(recording, joints={"orbital": recording.joints["orbital"]}))


def test_what_no_label_tells_is_refused(tmp_path):
    xray = Xray.of_urdf("mobile_nonisocentric", DETECTOR)
    with pytest.raises(InputError, match=r"where the orbital joint stands at zero: .*q_orbital_deg"):
        xray.P_image_sensor(unlabelled("mobile_nonisocentric", "orbital"))
    P = xray.P_image_sensor(carm_kin.simulate("mobile_nonisocentric", "minimal")[1])
    np.testing.assert_allclose(xray.P_image_sensor(three_zeros("mobile_nonisocentric")), P, atol=1e-3)
    with pytest.raises(InputError, match=r"by half a turn.*q_angular_deg"):
        Xray.of_urdf("mobile_isocentric", DETECTOR).P_image_sensor(three_zeros("mobile_isocentric"))
    low = tilted(tmp_path, offset=-0.1)
    with pytest.raises(InputError, match=r"by half a turn.*q_angular_deg"):
        Xray.of_urdf(low, DETECTOR).P_image_sensor(three_zeros(low))
    with pytest.raises(InputError, match="no complete chain"):
        xray.P_image_sensor(carm_kin.calibrate(carm_kin.simulate("mobile_skewed", "minimal")[0], "surface"))


def test_links_that_cannot_be_used(machines):
    for links, words in (
        ({"source_link": "collimator"}, "the joint 'shutter' moves between the links 'sensor' and 'collimator'"),
        ({"detector_link": "table"}, "the joint 'angular' moves between the links 'sensor' and 'table'"),
        ({"source_link": "tube"}, "no link is named 'tube'; valid: floor"),
        ({"source_link": "detector"}, "lies in the plane of the detector"),
    ):
        with pytest.raises(InputError, match=words):
            Xray.of_urdf(machines["tilted"], DETECTOR, **links)


@pytest.mark.parametrize(
    "size, words",
    [
        ((0.0, 10, 10), "pixel_m must be"),
        ((np.nan, 10, 10), "pixel_m must be"),
        ((1e-4, 0, 10), "columns must be a whole number above 0"),
        ((1e-4, 10, 2.5), "rows must be a whole number above 0"),
        ((1e-4, 10, True), "rows must be"),
    ],
)
def test_detectors_that_are_none(size, words):
    with pytest.raises(InputError, match=words):
        Detector(*size)


def test_poses_are_checked():
    _, truth = carm_kin.simulate("mobile_skewed", "minimal")
    with pytest.raises(InputError, match="not a rotation"):
        Xray.of_urdf("mobile_skewed", DETECTOR).P_image_world(truth, np.diag([1, 2, 1, 1]))
