"""Every kind of broken file ends the command with one clear line and exit status 2."""

import os
import re

import pytest

from carm_kin.machine.urdf import bundled_urdfs
from helpers.command import fails, run

HEADER = "x_mm,y_mm,z_mm,qw,qx,qy,qz,sweep,moving,placement,q_angular_deg,q_orbital_deg,time_s"
ROWS = [f"{i},{i * i},900,1,0,0,0,s,orbital,,10,,{i}" for i in range(8)]
ROW = "x_mm,y_mm,z_mm,qw,qx,qy,qz\n"


def csv(*rows: str, header: str = HEADER) -> bytes:
    return "\n".join([header, *rows, ""]).encode()


def with_row(row: str) -> bytes:
    """A sound recording with this one as its third pose, in line 4."""
    return csv(*ROWS[:2], row, *ROWS[3:])


def with_cells(**cells: str) -> bytes:
    values = dict(zip(HEADER.split(","), ROWS[2].split(","), strict=True)) | cells
    return with_row(",".join(values.values()))


BROKEN_CSV = {
    "empty": (b"", "empty"),
    "comments only": (b"# nothing\n\n", "empty"),
    "header only": (csv(), "line 1.*no poses"),
    "no header": (csv(*ROWS, header=ROWS[0]), "line 1.*header"),
    "column missing": (csv(header=HEADER.replace("z_mm,", "")), "line 1, column z_mm: missing z_mm"),
    "quaternion incomplete": (csv(header=HEADER.replace("qz,", "")), "line 1, column qz: missing qz"),
    "column misspelt": (csv(header=HEADER.replace("z_mm", "Z_mm")), "is it 'Z_mm'"),
    "column twice": (csv(*ROWS, header=HEADER.replace("time_s", "x_mm")), "unique|twice"),
    "mixed units": (csv(*ROWS, header=HEADER.replace("z_mm", "z_m")), "column z_m.*mixed|mixed"),
    "both units": (csv(*ROWS, header=HEADER.replace("time_s", "x_m")), "x_mm and x_m are both"),
    "joint without unit": (csv(*ROWS, header=HEADER.replace("q_orbital_deg", "q_orbital")), "line 1, column q_orbital"),
    "semicolons": (csv(*ROWS).replace(b",", b";"), "';' between its cells"),
    "tabs": (csv(*ROWS).replace(b",", b"\t"), "tab between its cells"),
    "decimal commas": (csv("1,5,2,900,1,0,0,0", header=ROW.strip()), "line 2.*decimal mark|line 2.*8 cells"),
    "short row": (with_row("1,2,3"), "line 4.*3 cells"),
    "long row": (with_row(ROWS[2] + ",7"), "line 4.*14 cells"),
    "text for a number": (with_cells(y_mm="abc"), "line 4, column y_mm: 'abc' is not a number"),
    "nan": (with_cells(x_mm="nan"), "line 4, column x_mm: .*(finite|not a number)"),
    "infinite": (with_cells(z_mm="1e999"), "line 4, column z_mm: .*finite"),
    "half a position": (with_cells(x_mm=""), "line 4, column x_mm: .*empty"),
    "half a quaternion": (with_cells(qy=""), "line 4, column qy: .*empty"),
    "zero quaternion": (with_cells(qw="0"), "line 4, column qw: .*zero"),
    "long quaternion": (with_cells(qw="1.1"), "line 4, column qw: .*norm 1.1"),
    "all frames missing": (csv(*[",,,,,,,,,,,,"] * 3), "missing"),
    "label changes": (with_cells(q_angular_deg="20"), "line 4, column q_angular_deg: .*'20' here and '10' before"),
    "two joints move": (with_cells(moving="angular"), "line 4, column moving: "),
    "placement changes": (with_cells(placement="B"), "line 4, column placement: "),
    "unclosed quote": (with_cells(sweep='"s'), "line 4: .*quoted"),
    "not UTF-8": (with_cells(sweep="?").replace(b"?", b"\xff"), "line 4, column 8: .*UTF-8"),
    "UTF-16": (csv(*ROWS).decode().encode("utf-16"), "line 1.*UTF-8"),
    "NUL": (with_cells(x_mm="\0"), "line 4"),
    "a third joint": (csv(*ROWS).replace(b"orbital,,", b"lift,,"), "column moving: .*'lift'"),
    "binary": (bytes(range(256)) * 10, "line"),
}


@pytest.mark.parametrize("kind", BROKEN_CSV)
def test_broken_csv_ends_on_one_clear_line(kind, tmp_path, capsys):
    content, expected = BROKEN_CSV[kind]
    file = tmp_path / "rec.csv"
    file.write_bytes(content)
    message = fails(capsys, "calibrate", file)
    assert message.startswith(str(file))
    assert re.search(expected, message), message


def test_the_recording_that_is_broken_here_is_sound_by_itself(tmp_path, capsys):
    file = tmp_path / "rec.csv"
    file.write_bytes(csv(*ROWS))
    assert run(capsys, "calibrate", file).status == 3


def _with(old: str, new: str) -> bytes:
    text = bundled_urdfs()["mobile_nonisocentric"].read_text()
    assert old in text
    return text.replace(old, new, 1).encode()


def _joint(body: str, name: str = "extra", kind: str = 'type="fixed"') -> bytes:
    return _with("</robot>", f'<link name="more"/>\n<joint name="{name}" {kind}>\n{body}\n</joint>\n</robot>')


ENDS = '<parent link="sensor"/><child link="more"/>'
HINGE = 'type="revolute"'
LIMIT = '<limit lower="0" upper="1" effort="0" velocity="0"/>'
LOOP = """<link name="a"/><link name="b"/>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>
<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>"""

EXTERNAL = '<!DOCTYPE a [<!ENTITY a SYSTEM "file:///etc/hostname">]>'


def _chain(joints: int, kind: str, limit: str = "") -> bytes:
    links = "".join(f'<link name="l{i}"/>' for i in range(joints + 1))
    body = "".join(
        f'<joint name="j{i}" {kind}><parent link="l{i}"/><child link="l{i + 1}"/>{limit}</joint>' for i in range(joints)
    )
    return f"<robot>{links}{body}</robot>".encode()


BROKEN_URDF = {
    "empty": (b"", "line 1: .*empty"),
    "no XML": (b"hello", "line 1: .*XML"),
    "truncated": (bundled_urdfs()["mobile_nonisocentric"].read_bytes()[:-200], "line .*XML"),
    "binary": (bytes(range(256)), "line 1: .*(binary|XML)"),
    "two roots": (_with("</robot>", "</robot><robot/>"), "line .*XML"),
    "entity bomb": (b'<!DOCTYPE a [<!ENTITY b "bb">]><robot name="&b;"/>', "line 1: .*DOCTYPE"),
    "another format": (b"<sdf><model/></sdf>", "line 1: .*<sdf>, not <robot>"),
    "no link": (b'<robot name="a"/>', "line 1: has no <link>"),
    "xacro": (b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="a"/></robot>', "line .*xacro"),
    "link without name": (_with("</robot>", "<link/></robot>"), "line .*<link> has no name"),
    "link twice": (_with("</robot>", '<link name="sensor"/></robot>'), "line .*'sensor' is there twice"),
    "joint twice": (_joint(ENDS, name="orbital"), "line .*'orbital' is there twice"),
    "unknown joint type": (_joint(ENDS, kind='type="hinge"'), "line .*type 'hinge'; valid: revolute"),
    "no parent": (_joint('<child link="more"/>'), "line .*no parent"),
    "no child": (_joint('<parent link="sensor"/>'), "line .*no child"),
    "unknown parent": (_joint(ENDS.replace("sensor", "nothing")), "line .*'nothing' is no link"),
    "two parents": (_joint('<parent link="more"/><child link="sensor"/>'), "line .*'sensor' has two parents"),
    "loop": (_with("</robot>", LOOP + "</robot>"), "line .*loop"),
    "two trees": (_with("</robot>", '<link name="alone"/></robot>'), "line .*2 links without a parent"),
    "zero axis": (_joint(f'{ENDS}<axis xyz="0 0 0"/>{LIMIT}', kind=HINGE), "line .*axis is zero"),
    "long axis": (_joint(f'{ENDS}<axis xyz="0 0 2"/>{LIMIT}', kind=HINGE), "line .*length 2"),
    "axis of two": (_joint(f'{ENDS}<axis xyz="0 1"/>{LIMIT}', kind=HINGE), "line .*2 numbers, not 3"),
    "nan origin": (_joint(f'{ENDS}<origin xyz="0 nan 0"/>'), "line .*'nan'"),
    "infinite origin": (_joint(f'{ENDS}<origin xyz="0 1e999 0"/>'), "line .*'1e999'"),
    "text origin": (_joint(f'{ENDS}<origin rpy="0 a 0"/>'), "line .*'a'"),
    "two origins": (_joint(f"{ENDS}<origin/><origin/>"), "line .*2 <origin>"),
    "no limit": (_joint(ENDS, kind=HINGE), "line .*no limit"),
    "limits reversed": (_joint(ENDS + LIMIT.replace('lower="0"', 'lower="2"'), kind=HINGE), "line .*above the upper"),
    "mimics nothing": (_joint(f'{ENDS}<mimic joint="nobody"/>'), "line .*'nobody'"),
    "thousands of links": (_chain(4000, 'type="fixed"'), "4001 links"),
    "thousand joints": (_chain(1000, HINGE, LIMIT), "1001 links"),
    "hundreds of joints": (_chain(499, HINGE, LIMIT), "499 moving joints .*at most 100"),
    "name with a space": (_with('name="orbital"', 'name=" orbital"'), "line .*joint ' orbital': a name has"),
    "blank name": (_with('name="orbital"', 'name=" "'), "line .*joint ' ': a name has"),
    "name of two lines": (_with('name="orbital"', 'name="orbi&#10;tal"'), r"line .*joint 'orbi\\ntal': a name has"),
    "name with an escape": (_with('name="orbital"', 'name="orbi&#x9b;31mtal"'), r"line .*\\x9b31mtal': a name has"),
    "long name": (_with('name="orbital"', f'name="{"x" * 201}"'), "line .*joint 'x{30}': a name has at most 200"),
    "name of a link": (_with("</robot>", '<link name="a "/></robot>'), "line .*link 'a ': a name has"),
    "external entity": (EXTERNAL.encode() + b'<robot name="&a;"/>', "line 1: .*DOCTYPE"),
    "parameter entity": (EXTERNAL.replace("a SYS", "% a SYS").encode() + b"<robot/>", "line 1: .*DOCTYPE"),
    "undefined entity": (_with('name="orbital"', 'name="&orbital;"'), "line .*XML: Entity 'orbital' not defined"),
    "UTF-16": (bundled_urdfs()["mobile_skewed"].read_text().encode("utf-16"), "line 1: .*UTF-8"),
    "declared UTF-16": (_with('version="1.0"', 'version="1.0" encoding="utf-16"'), "line 1: .*XML"),
    "unknown encoding": (_with('version="1.0"', 'version="1.0" encoding="klingon"'), "line 1: .*XML: Unsupported enc"),
    "undeclared Latin-1": (_with('"orbital"', '"örbital"').decode().encode("latin-1"), "line .*XML"),
    "nested deeply": (b"<robot>" + b"<a>" * 100_000, "line 1: .*XML: Excessive depth"),
    "huge attribute": (b'<robot name="' + b"a" * 15_000_000 + b'"/>', "line 1: .*XML"),
    "too large": (b"<robot>" + b" " * 20_000_000 + b"</robot>", "larger than 20 MB"),
    "huge origin": (_with('xyz="0.85 0 0.1"', 'xyz="1e300 0 0"'), "line .*'1e300', which is no finite number"),
    "subnormal axis": (_with('xyz="0 1 0"', 'xyz="1e-320 0 0"'), "line .*axis is zero"),
    "mimics itself": (_joint(f'{ENDS}<mimic joint="extra"/>'), "line .*'extra', which is no other joint"),
    "too many links": (b"<robot>" + b"".join(b'<link name="l%d"/>' % i for i in range(501)) + b"</robot>", "501 links"),
    "one axis": (_with('name="angular" type="revolute"', 'name="angular" type="fixed"')
                 .replace(b'name="wig_wag" type="revolute"', b'name="wig_wag" type="fixed"')
                 .replace(b'name="cart_yaw" type="revolute"', b'name="cart_yaw" type="fixed"'), "two revolute joints"),
    "floating": (_with('name="cart_x" type="prismatic"', 'name="cart_x" type="floating"'), "line .*floating"),
}  # fmt: skip


@pytest.mark.parametrize("command", ["inspect", "simulate"])
@pytest.mark.parametrize("kind", BROKEN_URDF)
def test_broken_urdf_ends_on_one_clear_line(kind, command, tmp_path, capsys):
    content, expected = BROKEN_URDF[kind]
    file = tmp_path / "machine.urdf"
    file.write_bytes(content)
    out = tmp_path / "rec.csv"
    message = fails(capsys, command, file, *(["-o", out] if command == "simulate" else []))
    assert message.startswith(str(file))
    assert re.search(expected, message), message
    assert not out.exists()


def test_a_frame_that_is_not_there_is_named(tmp_path, capsys):
    for command in (("inspect",), ("simulate", "-o", tmp_path / "rec.csv")):
        message = fails(capsys, *command, "mobile_skewed", "--sensor-link", "sensr")
        assert re.search(r"mobile_skewed.urdf: no link is named 'sensr'; valid: floor, cart_along", message)
    message = fails(capsys, "inspect", "biplane")
    assert message.endswith("which link carries the sensor? Name it (sensor_link): sensor_frontal, sensor_lateral")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe")
def test_no_path_in_a_urdf_is_followed(tmp_path, capsys):
    """The paths lead to a pipe without a writer: whoever opened it would wait for ever."""
    pipe, file = tmp_path / "pipe", tmp_path / "machine.urdf"
    os.mkfifo(pipe)
    texture = f'<material><texture filename="{pipe}"/></material>'
    mesh = f'<visual><geometry><mesh filename="{pipe}"/></geometry>{texture}</visual>'
    include = f'<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="{pipe}" parse="text"/>'
    style = f'<?xml-stylesheet href="file://{pipe}"?>'
    text = _with('<link name="floor"/>', f'<link name="floor">{mesh}</link>{include}').decode()
    file.write_text(text.replace("<robot", f"{style}\n<robot"))
    rec = tmp_path / "rec.csv"
    for command in (("inspect", file), ("simulate", file, "-o", rec), ("calibrate", rec, "--urdf", file)):
        assert run(capsys, *command).status == 0


def test_a_mimic_is_said_not_to_be_applied(tmp_path, capsys):
    file = tmp_path / "machine.urdf"
    file.write_bytes(_with('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="angular"/>'))
    for command in (("inspect", file), ("simulate", file, "-o", tmp_path / "rec.csv")):
        ended = run(capsys, *command)
        assert (ended.status, ended.err.count("mimic of 'angular' is not applied")) == (0, 1)


def test_parallel_axes_are_no_c_arm(tmp_path, capsys):
    file = tmp_path / "machine.urdf"
    file.write_bytes(
        _with('<axis xyz="0 1 0"/>\n    <limit lower="-0.698', '<axis xyz="1 0 0"/>\n    <limit lower="-0.698')
    )
    for command in (("inspect", file), ("simulate", file, "-o", tmp_path / "rec.csv")):
        assert "the axes of the joints 'angular' and 'orbital' are parallel" in fails(capsys, *command)


@pytest.mark.parametrize("name", ["no-such-machine", "/", "/dev/null", "a\nb\x1b[31m.urdf"])
def test_what_is_no_urdf_file_ends_on_one_line(name, capsys):
    assert "\x1b" not in fails(capsys, "inspect", name)


@pytest.mark.parametrize("name", ["none.csv", "/", "", "a\nb.csv", "none.xyz", "x" * 5000 + ".csv"])
def test_what_is_no_recording_ends_on_one_line(name, capsys):
    fails(capsys, "calibrate", name)
