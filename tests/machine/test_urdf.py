"""The strict pass: what is accepted, what is refused and how, and that a patch changes one origin only."""

import os
import sys

import numpy as np
import pytest

from carm_kin.errors import InputError
from carm_kin.machine.chain import chain_of
from carm_kin.machine.urdf import bundled_urdfs, find_urdf, kinematic_text, patch_origins, read_urdf, write_urdf
from solvers.se3 import exp_so3, transform

GOOD = """<?xml version="1.0"?>
<robot name="small">
  <link name="base"/>
  <link name="arm"/>
  <link name="sensor"/>
  <joint name="angular" type="revolute">
    <parent link="base"/>
    <child link="arm"/>
    <origin xyz="0 0 1" rpy="0 0 0"/>
    <axis xyz="1 0 0"/>
    <limit lower="-1" upper="2"/>
  </joint>
  <joint name="orbital" type="continuous">
    <parent link="arm"/>
    <child link="sensor"/>
    <axis xyz="0 1 0"/>
  </joint>
</robot>
"""

ANOTHER = '<joint name="extra" type="fixed"><parent link="{}"/><child link="{}"/></joint>\n</robot>'
LAUGHS = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>\n<robot name="&b;">'
EXTERNAL = '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]>\n<robot name="&a;">'

BROKEN = {
    # what: (text to replace, replacement, line that the message names, words that it contains)
    "nan_origin": ('xyz="0 0 1"', 'xyz="0 nan 1"', 9, "'angular': xyz holds 'nan'"),
    "infinite_origin": ('xyz="0 0 1"', 'xyz="0 1e999 1"', 9, "no finite number"),
    "huge_origin": ('xyz="0 0 1"', 'xyz="0 1e200 1"', 9, "no finite number"),
    "words_as_numbers": ('rpy="0 0 0"', 'rpy="0 half 0"', 9, "rpy holds 'half'"),
    "python_number": ('xyz="0 0 1"', 'xyz="0 1_0 1"', 9, "'1_0'"),
    "two_numbers": ('xyz="0 0 1"', 'xyz="0 0"', 9, "xyz holds 2 numbers, not 3"),
    "four_numbers": ('xyz="0 1 0"', 'xyz="0 1 0 0"', 16, "xyz holds 4 numbers, not 3"),
    "no_numbers": ('xyz="0 0 1"', 'xyz=""', 9, "xyz holds 0 numbers"),
    "two_origins": ('<axis xyz="1', '<origin/><axis xyz="1', 10, "'angular' has 2 <origin> elements"),
    "zero_axis": ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>', 10, "'angular': the axis is zero"),
    "long_axis": ('<axis xyz="1 0 0"/>', '<axis xyz="1 0.1 0"/>', 10, "length 1.00499"),
    "nan_axis": ('<axis xyz="1 0 0"/>', '<axis xyz="1 0 NaN"/>', 10, "'NaN'"),
    "unknown_type": ('type="continuous"', 'type="screw"', 13, "'orbital' has the type 'screw'; valid: revolute, cont"),
    "no_type": (' type="continuous"', "", 13, "type None"),
    "no_limit": ('    <limit lower="-1" upper="2"/>\n', "", 6, "'angular' has no limit"),
    "crossed_limits": ('upper="2"', 'upper="-2"', 11, "lower limit -1 is above the upper limit -2"),
    "infinite_limit": ('upper="2"', 'upper="inf"', 11, "upper holds 'inf'"),
    "no_parent": ('    <parent link="arm"/>\n', "", 13, "'orbital' names no parent"),
    "no_child": ('<child link="sensor"/>', "<child/>", 13, "'orbital' names no child"),
    "unknown_parent": (
        '<parent link="base"/>',
        '<parent link="bse"/>',
        6,
        "'bse' is no link of this file; valid: base, arm",
    ),
    "unknown_child": ('<child link="sensor"/>', '<child link="sns"/>', 13, "child 'sns' is no link"),
    "two_roots": ('<link name="sensor"/>', '<link name="sensor"/><link name="lone"/>', 5, "2 links without a parent"),
    "two_parents": ("</robot>", ANOTHER.format("base", "sensor"), 18, "'sensor' has two parents, by joint 'extra'"),
    "loop_with_base": ("</robot>", ANOTHER.format("sensor", "base"), 6, "a loop of the links arm, sensor, base, arm"),
    "loop_of_one": ('<parent link="arm"/>', '<parent link="sensor"/>', 13, "a loop of the links sensor, sensor"),
    "duplicate_link": ('<link name="sensor"/>', '<link name="sensor"/>\n<link name="arm"/>', 6, "first in line 4"),
    "duplicate_joint": ('name="orbital"', 'name="angular"', 13, "joint 'angular' is there twice, first in line 6"),
    "nameless_link": ('<link name="sensor"/>', "<link/>", 5, "a <link> has no name"),
    "nameless_joint": ('<joint name="orbital"', '<joint name=""', 13, "a <joint> has no name"),
    "unknown_mimic": ('<axis xyz="0 1 0"/>', '<mimic joint="anglar"/>', 16, "mimics 'anglar', which is no other joint"),
    "mimic_of_itself": ('<axis xyz="0 1 0"/>', '<mimic joint="orbital"/>', 16, "valid: angular"),
    "truncated": ("</robot>", "", 19, "Premature end of data in tag robot"),
    "doctype": ("<robot name", "<!DOCTYPE robot>\n<robot name", 2, "DOCTYPE"),
    "entity_expansion": ('<robot name="small">', LAUGHS, 2, "DOCTYPE"),
    "external_entity": ('<robot name="small">', EXTERNAL, 2, "DOCTYPE"),
    "unknown_entity": ('name="small"', 'name="&small;"', 2, "Entity 'small' not defined"),
    "two_root_elements": ("</robot>\n", "</robot>\n<robot/>", 19, "Extra content"),
    "unclosed_element": ("</joint>\n</robot>", "</robot>", 17, "not well-formed XML"),
    "xacro": (
        '<link name="arm"/>',
        '<x:macro xmlns:x="http://ros.org/wiki/xacro"/>',
        4,
        "is a xacro file; expand it first",
    ),
    "xacro_expression": ('xyz="0 0 1"', 'xyz="0 0 ${height}"', 9, "is a xacro file; expand it first"),
    "not_robot": ("robot", "sdf", 2, "the root element is <sdf>, not <robot>"),
    "default_html": (GOOD, "<html>\n<p>404</p></html>", 1, "the root element is <html>"),
    "empty": (GOOD, "", 1, "the file is empty"),
    "blank": (GOOD, " \n\n", 1, "the file is empty"),
    "text": (GOOD, "a C-arm", 1, "not well-formed XML"),
    "no_link": (GOOD, '<robot name="none"/>', 1, "has no <link>"),
    "deep": (GOOD, "<robot>" + "<a>" * 1000 + "</a>" * 1000 + "</robot>", 1, "Excessive depth"),
}


def written(tmp_path, text):
    path = tmp_path / "machine.urdf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path):
    """The message of the one-line refusal of a file."""
    with pytest.raises(InputError) as caught:
        read_urdf(path)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400 + len(str(path))
    assert message.startswith(str(path))
    return message.removeprefix(str(path))


def test_a_good_file_is_read(tmp_path):
    urdf = read_urdf(written(tmp_path, GOOD))
    assert (urdf.name, urdf.base, urdf.links, urdf.leaves) == ("small", "base", ("base", "arm", "sensor"), ("sensor",))
    angular, orbital = urdf.joints
    assert (angular.type, angular.line, angular.lower, angular.upper) == ("revolute", 6, -1, 2)
    assert (orbital.type, orbital.parent, orbital.child, orbital.upper) == ("continuous", "arm", "sensor", np.inf)
    assert angular.origin[:3, 3].tolist() == [0, 0, 1]
    assert orbital.axis.tolist() == [0, 1, 0]
    assert urdf.notes == ()


@pytest.mark.parametrize("name", bundled_urdfs())
def test_bundled_machines_pass_without_a_remark(name):
    assert read_urdf(name).notes == ()


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_in_one_line(case, tmp_path):
    old, new, line, words = BROKEN[case]
    assert old in GOOD
    message = refusal(written(tmp_path, GOOD.replace(old, new)))
    assert message.startswith(f", line {line}: ")
    assert words in message


@pytest.mark.parametrize("links", [501, 4000])
def test_too_many_links(links, tmp_path):
    body = "".join(f'<link name="l{i}"/>\n' for i in range(links))
    assert f"line 502: has {links} links; at most 500" in refusal(written(tmp_path, f"<robot>\n{body}</robot>"))


def test_binary_and_other_encodings(tmp_path):
    assert "line 1: holds NUL bytes" in refusal(written(tmp_path, b"\x7fELF\0\1\2"))
    assert "line 1: holds NUL bytes" in refusal(written(tmp_path, GOOD.encode("utf-16")))
    assert "line 2: is not well-formed XML" in refusal(written(tmp_path, GOOD.encode().replace(b"small", b"\xff\xfe")))
    hidden = GOOD.replace('"1.0"?>', '"1.0" encoding="utf-7"?>').replace(
        "<robot n", "+ADwAIQ-DOCTYPE a [+AF0APg-<robot n"
    )
    assert "line 1: " in refusal(written(tmp_path, hidden))
    latin = GOOD.replace('"1.0"?>', '"1.0" encoding="ISO-8859-1"?><!-- Höhe -->').encode("latin-1")
    assert read_urdf(written(tmp_path, latin)).base == "base"


def test_a_doctype_in_a_comment_is_no_doctype(tmp_path):
    text = GOOD.replace("<robot", "<!-- <!DOCTYPE robot> --> <?pi <!DOCTYPE ?>\n<robot")
    assert read_urdf(written(tmp_path, text)).name == "small"


def test_missing_file_folder_and_size(tmp_path, monkeypatch):
    assert refusal(tmp_path / "none.urdf").startswith(": no such file; bundled machines: biplane, ceiling_angio, ")
    assert refusal(tmp_path) == ": is a folder; give a URDF file"
    path = written(tmp_path, GOOD)
    monkeypatch.setattr("carm_kin.machine.urdf.MAX_BYTES", 100)
    assert "is larger than" in refusal(path)


def test_names_stand_for_bundled_machines(tmp_path, monkeypatch):
    assert find_urdf("mobile_skewed") == bundled_urdfs()["mobile_skewed"]
    assert read_urdf("mobile_skewed").name == "mobile_skewed"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mobile_skewed").mkdir()
    assert find_urdf("mobile_skewed").is_file()
    with pytest.raises(InputError, match="mobile_nonisocentric, mobile_residual, mobile_skewed"):
        find_urdf("mobile_skwed")


def test_nearly_unit_axes_are_normalised_and_noted(tmp_path):
    urdf = read_urdf(written(tmp_path, GOOD.replace('<axis xyz="1 0 0"', '<axis xyz="0.8 0.6003 0"')))
    assert np.linalg.norm(urdf.joints[0].axis) == pytest.approx(1, abs=1e-15)
    assert urdf.notes == ("joint 'angular', line 10: axis of length 1.00018 normalised",)


def test_mimic_is_kept_and_noted(tmp_path):
    urdf = read_urdf(written(tmp_path, GOOD.replace('<axis xyz="0 1 0"/>', '<mimic joint="angular"/>')))
    assert urdf.notes == ("joint 'orbital', line 16: mimic of 'angular' is not applied",)


def test_a_zero_axis_of_a_fixed_joint_is_harmless(tmp_path):
    text = GOOD.replace("</robot>", ANOTHER.format("sensor", "tip").replace("</joint>", '<axis xyz="0 0 0"/></joint>'))
    assert read_urdf(written(tmp_path, text.replace('<link name="arm"/>', '<link name="arm"/><link name="tip"/>')))


OPENED: list[str] = []


def test_meshes_are_never_opened(tmp_path):
    mesh = tmp_path / "secret.stl"
    mesh.write_text("solid")
    visual = f'<link name="arm"><visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>'
    include = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{mesh}"/>'
    path = written(tmp_path, GOOD.replace('<link name="arm"/>', visual + include))
    if not OPENED:
        sys.addaudithook(lambda event, arguments: OPENED.append(str(arguments[0])) if event == "open" else None)
    OPENED.clear()
    os.utime(mesh, (0, 0))
    urdf = read_urdf(path)
    assert "secret" not in kinematic_text(urdf, "sensor")
    assert str(path) in OPENED
    assert str(mesh) not in OPENED
    assert mesh.stat().st_atime == 0


MESSY = """<?xml version='1.0' encoding="utf-8"?>\r
<robot  name = 'messy' xmlns:g="http://gazebosim.org" >\r
 <!-- an <origin xyz="9 9 9"/> in a comment -->\r
 <transmission name="t"><joint name="orbital"><origin xyz="8 8 8"/></joint></transmission>\r
\t<link name="base" /><link name='arm'></link><link name="sensor"><visual><origin xyz="7 7 7"/></visual></link>\r
 <joint type='revolute' name="angular"><origin\r
     rpy = '0 0 0'   note="a > b, xyz='1 1 1'"/><parent link="base"/>\r
   <child link="arm"/><limit upper="1" lower="-1"/></joint>\r
 <joint name="orbital" type="continuous">\r
     <parent link="arm"/><child link="sensor"/><axis xyz="0 1 0"/></joint>\r
 <transmission name="u"><joint name="orbital"><origin xyz="6 6 6"/></joint></transmission>\r
 <g:joint name="x"/> <gazebo reference="arm"><kp>1e5</kp></gazebo>\r
</robot>\r
<!-- end: äöü -->"""


def placement(seed):
    rng = np.random.default_rng(seed)
    return transform(exp_so3(rng.normal(size=3)), rng.normal(size=3))


def test_a_patch_changes_one_origin_and_no_other_byte(tmp_path):
    urdf = read_urdf(written(tmp_path, MESSY))
    T = placement(1)
    patched = patch_origins(urdf, {"angular": T})
    np.testing.assert_allclose(patched.joints[0].origin, T, rtol=0, atol=1e-15)
    start, end = MESSY.encode().index(b"<origin\r"), MESSY.encode().index(b'/><parent link="base"/>')
    tail = len(MESSY.encode()) - end
    assert patched.data[:start] == urdf.data[:start]
    assert patched.data[-tail:] == urdf.data[-tail:]
    middle = patched.data[start:-tail]
    assert middle.startswith(b'<origin xyz="')
    assert b"""   note="a > b, xyz='1 1 1'\"""" in middle
    assert patch_origins(patched, {"angular": T}).data == patched.data


def test_a_patch_adds_an_origin_where_there_is_none(tmp_path):
    urdf = read_urdf(written(tmp_path, MESSY))
    T = placement(2)
    patched = patch_origins(urdf, {"orbital": T})
    np.testing.assert_allclose(patched.joints[1].origin, T, rtol=0, atol=1e-15)
    at = MESSY.encode().index(b'     <parent link="arm"/>')
    added = len(patched.data) - len(urdf.data)
    assert patched.data[:at] + patched.data[at + added :] == urdf.data
    assert patched.data[at : at + added].startswith(b"     <origin xyz=")


def test_several_patches_and_the_kinematics_they_give(tmp_path):
    urdf = read_urdf("mobile_skewed")
    origins = {joint.name: placement(i) for i, joint in enumerate(urdf.joints)}
    write_urdf(patch_origins(urdf, origins), tmp_path / "patched.urdf")
    patched = read_urdf(tmp_path / "patched.urdf")
    chain = chain_of(patched)
    expected = np.eye(4)
    for name in (*chain.names, "sensor_mount"):
        expected = expected @ origins[name]
    np.testing.assert_allclose(chain.forward_kinematics(np.zeros(8)), expected, rtol=0, atol=1e-13)
    assert patch_origins(patched, {j.name: j.origin for j in urdf.joints}).joints[7].xyz.tolist() == [0.85, 0.004, 0.06]


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1e-9 - np.pi / 2])
def test_a_patch_keeps_its_precision_at_a_pitch_of_90_degrees(pitch, tmp_path):
    urdf = read_urdf(written(tmp_path, MESSY))
    Q = exp_so3([0.4, 0.5, 0.6])
    R = Q.T @ (Q @ exp_so3([0, 0, 0.3]) @ exp_so3([0, pitch, 0]) @ exp_so3([1.1, 0, 0]))
    T = transform(R, [1, 2, 3])
    np.testing.assert_allclose(patch_origins(urdf, {"angular": T}).joints[0].origin, T, rtol=0, atol=1e-15)


def test_a_patch_of_nothing_sensible_is_refused(tmp_path):
    urdf = read_urdf(written(tmp_path, GOOD))
    with pytest.raises(InputError, match="no joint is named 'orbitl'; valid: angular, orbital"):
        patch_origins(urdf, {"orbitl": np.eye(4)})
    for T in (np.eye(3), np.full((4, 4), np.nan), np.diag([1, 1, 2, 1]), np.diag([1, 1, -1, 1]), np.diag([1, 1, 1, 2])):
        with pytest.raises(InputError, match="the origin of joint 'angular'"):
            patch_origins(urdf, {"angular": T})


def test_a_file_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_urdf(read_urdf("mobile_skewed"), tmp_path / "none" / "out.urdf")
