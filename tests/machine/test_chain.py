"""The chain as arrays against an independent library and hand-made geometry, and how its parts are chosen."""

import re
import runpy

import numpy as np
import pytest

from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of, nominal_geometry
from carm_kin.machine.urdf import patch_origins, read_urdf
from helpers.family import BRANCHES, FILES, IDS, link_pose
from helpers.places import ROOT, URDF
from solvers.se3 import exp_so3, inverse, transform

EXPECTED = {
    # machine: R (mm, signed), epsilon (deg), torus centre (mm) as the file's author meant them
    "mobile_isocentric": (0, 0, (1400, 0, 1050)),
    "mobile_nonisocentric": (100, 0, (1400, 0, 950)),
    "mobile_skewed": (60, 0.7, (1400 + 4 * np.tan(np.radians(0.7)), 0, 990)),
    "mobile_residual": (12, 0.2, (1400 - 2 * np.tan(np.radians(0.2)), 0, 1038)),
    "mobile_3d": (0, 0, (1400, 0, 1050)),
    "mobile_beam_offset": (30, 0, (1400, 0, 1020)),
    "mini_boom": (0, 0, (1330, 0, 970)),
    "floor_angio": (0, 0, (1250, 0, 1070)),
    "ceiling_angio": (5, 0, (1180, 0, 1070)),
    "driven_gantry": (-8, 0, (1150, 0, 1070)),
    "ring_gantry": (2, 0, (1170, 0, 1150)),
    "orbital_first": (-20, -0.3, (1250, 700 * np.tan(np.radians(0.3)), 1100)),
}

ODD = """<robot name="odd">
  <link name="base"/> <link name="a"/> <link name="b"/> <link name="c"/> <link name="d"/> <link name="e"/>
  <link name="shelf"/> <link name="tip"/> <link name="side"/>
  <joint name="plinth" type="fixed"><parent link="base"/><child link="a"/>
    <origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/></joint>
  <joint name="shelf" type="fixed"><parent link="a"/><child link="shelf"/><origin xyz="0 0 0.2" rpy="1 0 0"/></joint>
  <joint name="turn" type="continuous"><parent link="shelf"/><child link="b"/><origin rpy="0 0.2 0"/>
    <axis xyz="0 0.6 0.8"/></joint>
  <joint name="bend" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0 0.1 0" rpy="1 1 1"/></joint>
  <joint name="slide" type="prismatic"><parent link="c"/><child link="d"/><origin xyz="0.4 0 0"/>
    <axis xyz="0.6 0 -0.8"/><limit lower="-0.2" upper="0.3"/></joint>
  <joint name="swing" type="revolute"><parent link="d"/><child link="e"/><origin rpy="-1 0 2"/>
    <limit lower="-1" upper="2"/></joint>
  <joint name="mount" type="fixed"><parent link="e"/><child link="tip"/>
    <origin xyz="0 0 0.7" rpy="0.1 0.2 0.3"/></joint>
  <joint name="branch" type="floating"><parent link="a"/><child link="side"/></joint>
</robot>
"""


@pytest.fixture
def odd(tmp_path):
    (tmp_path / "odd.urdf").write_text(ODD)
    return read_urdf(tmp_path / "odd.urdf")


def machine(tmp_path, *joints):
    """A URDF of joints given as (name, type, xyz, rpy, axis), one after the other, the last link the sensor."""
    limit = '<limit lower="-1" upper="1"/>'
    text = '<robot name="m"><link name="l0"/>'
    for i, (name, type_, xyz, rpy, axis) in enumerate(joints):
        text += f'<link name="l{i + 1}"/><joint name="{name}" type="{type_}"><parent link="l{i}"/>'
        text += f'<child link="l{i + 1}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
    path = tmp_path / "m.urdf"
    path.write_text(text + "</robot>")
    return read_urdf(path)


@pytest.mark.parametrize("name, link", [*BRANCHES, ("odd", "tip")], ids=[*IDS, "odd"])
def test_forward_kinematics_equals_yourdfpy(name, link, odd):
    yourdfpy = pytest.importorskip("yourdfpy")
    urdf = odd if name == "odd" else read_urdf(name)
    chain = chain_of(urdf, link)
    if any(joint.type == "planar" for joint in urdf.joints):
        pytest.skip("yourdfpy takes no configuration of a planar joint")
    robot = yourdfpy.URDF.load(str(urdf.path), load_meshes=False, load_collision_meshes=False)
    q = np.random.default_rng(0).uniform(-1, 1, (5, len(chain.names)))
    for row, T in zip(q, chain.forward_kinematics(q), strict=True):
        robot.update_cfg(dict(zip(chain.names, row, strict=True)))
        np.testing.assert_allclose(T, robot.get_transform(chain.sensor_link, chain.base_link), rtol=0, atol=1e-12)


def test_the_chain_of_an_odd_machine(odd):
    chain = chain_of(odd, "tip")
    assert (chain.base_link, chain.sensor_link) == ("base", "tip")
    assert chain.names == ("turn", "slide", "swing")
    assert chain.types == ("continuous", "prismatic", "revolute")
    assert chain.lower.tolist() == [-np.inf, -0.2, -1]
    assert chain.upper.tolist() == [np.inf, 0.3, 2]
    assert (chain.angular, chain.orbital) == (0, 2)
    assert chain.axes[0].tolist() == [0, 0.6, 0.8]
    assert chain.axes[2].tolist() == [1, 0, 0]
    plinth, shelf, turn = (joint.origin for joint in odd.joints[:3])
    np.testing.assert_allclose(chain.placements[0], plinth @ shelf @ turn, atol=1e-15)


def test_configurations_of_any_shape(odd):
    chain = chain_of(odd, "tip")
    q = np.random.default_rng(1).normal(size=(4, 5, 3))
    T = chain.forward_kinematics(q)
    assert T.shape == (4, 5, 4, 4)
    np.testing.assert_array_equal(T[2, 3], chain.forward_kinematics(q[2, 3]))
    frames = chain.joint_frames(q)
    assert frames.shape == (4, 5, 3, 4, 4)
    np.testing.assert_allclose(frames[..., -1, :, :] @ chain.T_last_sensor, T, atol=1e-15)
    for wrong in (0.0, np.zeros(4), np.zeros((3, 2))):
        with pytest.raises(InputError, match="joint values for 3 joints; the order is turn, slide, swing"):
            chain.forward_kinematics(wrong)


def test_a_planar_joint_stands_as_three(tmp_path):
    axis = np.array([0.6, 0, 0.8])
    joints = [
        ("cart", "planar", "1 2 3", "0 0 0.5", "0.6 0 0.8"),
        ("lift", "prismatic", "0 0 0", "0 0 0", "0 0 1"),
        ("angular", "revolute", "0 0 0", "0 0 0", "1 0 0"),
        ("orbital", "revolute", "0 0 0", "0 0 0", "0 1 0"),
    ]
    urdf = machine(tmp_path, *joints)
    chain = chain_of(urdf)
    assert chain.names == ("cart_x", "cart_y", "cart_yaw", "lift", "angular", "orbital")
    T = inverse(urdf.joints[0].origin) @ chain.forward_kinematics([0.3, -0.2, 0.7, 0, 0, 0])
    np.testing.assert_allclose(T[:3, :3], exp_so3(0.7 * axis), atol=1e-15)
    assert T[:3, 3] @ axis == pytest.approx(0, abs=1e-15)
    assert np.linalg.norm(T[:3, 3]) == pytest.approx(np.hypot(0.3, 0.2))
    with pytest.raises(InputError, match="no <origin> carries the placement of 'cart_y'"):
        chain.origins(chain.placements @ np.where(np.arange(6)[:, None, None] == 1, T, np.eye(4)), chain.T_last_sensor)
    flat = machine(tmp_path, ("cart", "planar", "0 0 0", "0 0 0", "0 0 1"), *joints[1:])
    T = chain_of(flat).forward_kinematics([0.3, -0.2, 0.7, 0, 0, 0])
    np.testing.assert_allclose(T, transform(exp_so3([0, 0, 0.7]), [0.3, -0.2, 0]), atol=1e-15)
    clash = machine(tmp_path, joints[0], ("cart_yaw", *joints[1][1:]), *joints[2:])
    with pytest.raises(InputError, match="'cart_yaw' is also the name of a part of a planar joint"):
        chain_of(clash)


@pytest.mark.parametrize("name", EXPECTED)
def test_nominal_geometry_of_the_bundled_machines(name):
    major_radius, epsilon, center = EXPECTED[name]
    geometry = nominal_geometry(chain_of(read_urdf(name)))
    assert geometry.axes == (("orbital", "angular") if name == "orbital_first" else ("angular", "orbital"))
    assert geometry.major_radius * 1e3 == pytest.approx(major_radius, abs=1e-9)
    assert np.degrees(geometry.non_orthogonality) == pytest.approx(epsilon, abs=1e-9)
    assert geometry.isocentric == (major_radius == 0)
    np.testing.assert_allclose(geometry.T_base_torus[:3, 3] * 1e3, center, atol=1e-9)


@pytest.mark.parametrize(
    "name, offset", [("mobile_isocentric", (-50, -120, -680)), ("mobile_nonisocentric", (130, 80, -700))]
)
def test_nominal_offset_of_a_sensor_that_stands_straight(name, offset):
    np.testing.assert_allclose(nominal_geometry(chain_of(read_urdf(name))).offset * 1e3, offset, atol=1e-9)


README = (URDF / "README.md").read_text(encoding="utf-8")


def row(name, link, *cells):
    sensor = "" if link == "sensor" else f", `{link}`"
    return "\n| " + " | ".join([f"`{name}`{sensor}", *cells]) + " |\n"


@pytest.mark.parametrize("name, link", BRANCHES, ids=IDS)
def test_the_readme_has_the_computed_numbers(name, link):
    geometry = nominal_geometry(chain_of(read_urdf(name), link))
    suffix = link.removeprefix("sensor")
    source, detector = (link_pose(FILES[name], part + suffix, {})[:3, 3] for part in ("source", "detector"))
    values = (
        abs(geometry.major_radius) * 1e3,
        np.degrees(geometry.non_orthogonality),
        geometry.minor_radius * 1e3,
        geometry.offset * 1e3,
        geometry.T_base_torus[:3, 3] * 1e3,
    )
    cells = [", ".join(f"{v + 0.0:.3f}" for v in np.round(np.atleast_1d(value), 3)) for value in values]
    assert row(name, link, *cells, f"{np.linalg.norm(detector - source) * 1e3:.0f}") in README


@pytest.mark.parametrize("name, link", BRANCHES, ids=IDS)
def test_the_readme_has_the_joints(name, link):
    chain = chain_of(read_urdf(name), link)
    joints = []
    for joint, kind, limits in zip(chain.names, chain.types, zip(chain.lower, chain.upper, strict=True), strict=True):
        scale, unit = (1e3, "mm") if kind == "prismatic" else (np.degrees(1), "deg")
        ends = " to ".join(f"{limit * scale:.5g}" for limit in limits)
        joints.append(f"`{joint}` {ends} {unit}" if np.isfinite(limits).all() else f"`{joint}` any")
    assert row(name, link, ", ".join(joints)) in README


def test_the_readme_says_what_every_machine_is():
    for name in FILES:
        assert re.search(rf"\n\| `{name}` \| [^|]+ \| [^|]*(typical|published|estimated|KUKA)[^|]* \|\n", README), name


def test_the_drawing_is_that_of_the_urdfs(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["draw_carms.py", str(tmp_path / "carms.svg")])
    runpy.run_path(str(ROOT / "tools" / "draw_carms.py"), run_name="__main__")
    assert (tmp_path / "carms.svg").read_text("utf-8") == (URDF / "carms.svg").read_text("utf-8")


SKEW = [
    ("lift", "prismatic", "0 0 0", "0 0 0", "0 0 1"),
    ("angular", "revolute", "0.1 0.2 0.3", "0.4 -0.5 0.6", "0.6 0 0.8"),
    ("between", "prismatic", "0.3 0 0.1", "0.2 0 0.1", "0 1 0"),
    ("orbital", "continuous", "0.3 0.1 -0.2", "0.1 1 0.1", "0 0.8 -0.6"),
    ("wrist", "revolute", "0.1 0.2 0.5", "1 1 1", "1 0 0"),
]


@pytest.mark.parametrize("order", [("angular", "orbital"), ("orbital", "angular")])
def test_nominal_geometry_reproduces_any_chain(order, tmp_path):
    """The closed form with other joints before, between and after the axes, at a given configuration."""
    chain = chain_of(machine(tmp_path, *SKEW), angular=order[0], orbital=order[1])
    q = np.array([0.1, 0.7, -0.2, 1.3, 0.4])
    geometry = nominal_geometry(chain, q)
    assert geometry.axes == ("angular", "orbital")
    (sa, ca), (sb, cb) = (((np.sin(v)), np.cos(v)) for v in (q[1], q[3]))
    se, ce = np.sin(geometry.non_orthogonality), np.cos(geometry.non_orthogonality)
    Rx = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    Rz = np.array([[ce, -se, 0], [se, ce, 0], [0, 0, 1]])
    Ry = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    T_torus_carm = transform(Rx @ Rz @ Ry, Rx @ [0, 0, geometry.major_radius])
    T = geometry.T_base_torus @ T_torus_carm @ np.linalg.inv(geometry.T_sensor_carm)
    np.testing.assert_allclose(T, chain.forward_kinematics(q), rtol=0, atol=1e-12)
    assert abs(geometry.non_orthogonality) > 0.1


@pytest.mark.parametrize("height", [0.06, -0.06])
def test_the_major_radius_is_signed(height, tmp_path):
    joints = [
        ("angular", "revolute", "0 0 1", "0 0 0", "1 0 0"),
        ("orbital", "revolute", f"0 0 {height}", "0 0 0", "0 1 0"),
    ]
    geometry = nominal_geometry(chain_of(machine(tmp_path, *joints)))
    assert geometry.major_radius == pytest.approx(height, abs=1e-15)
    np.testing.assert_allclose(geometry.T_base_torus, transform(np.eye(3), [0, 0, 1]), atol=1e-15)
    assert not geometry.isocentric


def test_parallel_axes_are_refused(tmp_path):
    joints = [("a", "revolute", "0 0 0", "0 0 0", "1 0 0"), ("b", "revolute", "0 0 1", "0 0 0", "-1 0 0")]
    with pytest.raises(InputError, match="axes of the joints 'a' and 'b' are parallel"):
        nominal_geometry(chain_of(machine(tmp_path, *joints)))


def test_axes_by_name_by_option_and_by_default(odd, tmp_path):
    def axes(urdf, *arguments, **options):
        chain = chain_of(urdf, *arguments, **options)
        return chain.names[chain.angular], chain.names[chain.orbital]

    skew = machine(tmp_path, *SKEW)
    assert axes(skew) == ("angular", "orbital")
    assert axes(skew, orbital="wrist") == ("angular", "wrist")
    assert axes(skew, angular="wrist") == ("orbital", "wrist")
    assert axes(skew, angular="orbital", orbital="angular") == ("angular", "orbital")
    unnamed = machine(tmp_path, *[(f"j{i}", *rest) for i, (_, *rest) in enumerate(SKEW)])
    assert axes(unnamed) == ("j3", "j4")
    assert axes(unnamed, angular="j1", orbital="j3") == ("j1", "j3")
    assert axes(unnamed, angular="j4") == ("j3", "j4")
    assert axes(unnamed, orbital="j3") == ("j3", "j4")
    half = machine(tmp_path, *[(name.replace("orbital", "beta"), *rest) for name, *rest in SKEW])
    assert axes(half) == ("angular", "wrist")
    swapped = machine(tmp_path, ("beta", *SKEW[3][1:]), SKEW[1])
    assert axes(swapped) == ("beta", "angular")
    with pytest.raises(
        InputError, match=r"orbital joint 'lift' is no revolute joint .*; valid: angular, orbital, wrist"
    ):
        chain_of(skew, orbital="lift")
    with pytest.raises(InputError, match="angular joint 'alpha' is no revolute joint"):
        chain_of(skew, angular="alpha")
    with pytest.raises(InputError, match="both 'wrist'"):
        chain_of(skew, angular="wrist", orbital="wrist")


def test_an_orbital_joint_nearer_the_base_is_the_first_axis_and_said_to_be(tmp_path):
    swapped = machine(tmp_path, SKEW[3], SKEW[1])
    (note,) = chain_of(swapped).notes
    assert note.startswith("the orbital joint 'orbital' stands nearer the base than the angular one 'angular'")
    assert note.endswith("--angular orbital --orbital angular")
    assert chain_of(swapped, angular="orbital", orbital="angular").notes == ()
    assert chain_of(machine(tmp_path, *SKEW)).notes == ()


def test_the_sensor_link_is_found_or_asked_for(odd, tmp_path):
    assert chain_of(machine(tmp_path, *SKEW)).sensor_link == "l5"
    assert chain_of(read_urdf("mobile_skewed")).sensor_link == "sensor"
    with pytest.raises(InputError, match=re.escape("Name it (sensor_link): tip, side")):
        chain_of(odd)
    with pytest.raises(InputError, match="no link is named 'tp'; valid: base, a, b"):
        chain_of(odd, "tp")
    with pytest.raises(InputError, match=r"line 16: joint 'branch' on the way to the sensor is floating"):
        chain_of(odd, "side")
    with pytest.raises(InputError, match="needs two revolute joints between base and 'c'; there are: turn"):
        chain_of(odd, "c")
    with pytest.raises(InputError, match="needs two revolute joints between base and 'base'; there are: none"):
        chain_of(odd, "base")


def test_too_many_moving_joints(tmp_path):
    joints = [(f"j{i}", "revolute", "0 0 0", "0 0 0", "1 0 0") for i in range(101)]
    with pytest.raises(InputError, match="101 moving joints lie between base and 'l101'; at most 100"):
        chain_of(machine(tmp_path, *joints))


def test_joint_names_have_indices(odd):
    chain = chain_of(odd, "tip")
    assert chain.index("slide") == 1
    with pytest.raises(InputError, match="no joint of the chain is named 'slid'; valid: turn, slide, swing"):
        chain.index("slid")


def test_new_placements_go_back_into_the_file(odd):
    chain = chain_of(odd, "tip")
    rng = np.random.default_rng(3)
    D = transform(exp_so3(rng.normal(scale=0.01, size=(4, 3))), rng.normal(scale=0.01, size=(4, 3)))
    placements, T_last_sensor = chain.placements @ D[:3], chain.T_last_sensor @ D[3]
    origins = chain.origins(placements, T_last_sensor)
    assert set(origins) == {"turn", "slide", "swing", "mount"}
    patched = chain_of(patch_origins(odd, origins), "tip")
    np.testing.assert_allclose(patched.placements, placements, rtol=0, atol=1e-15)
    np.testing.assert_allclose(patched.T_last_sensor, T_last_sensor, rtol=0, atol=1e-15)
    assert chain.origins(chain.placements, chain.T_last_sensor) == {}
    bare = chain_of(odd, "e")
    with pytest.raises(InputError, match="no <origin> carries the placement of 'e'"):
        bare.origins(bare.placements, T_last_sensor)
