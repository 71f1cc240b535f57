"""The calibrated URDF: the user's file but for the numbers that changed, and it gives the estimate's poses."""

import re
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
from carm_kin.calibration.chain.calibrated_urdf import calibrated_urdf
from carm_kin.errors import InputError
from carm_kin.machine.urdf import parse_urdf, read_urdf, write_urdf
from helpers.chained import (
    ARM_AXES,
    ARM_JOINTS,
    C_ARM,
    C_JOINTS,
    arm,
    arm_recording,
    c_arm_recording,
    kinematics,
    parsed,
    perturbed,
    poses_of,
    random_values,
    recorded,
    stand,
)

ODD = """<?xml version='1.0' encoding="utf-8"?>
<!-- a comment with <origin xyz="1 2 3"/> in it -->
<robot  name = "odd"   xmlns:drake="http://drake.mit.edu">
\t<link name='base'><unknown attribute="1 &lt; 2"/></link>
\t<joint type="prismatic" name="lift" ><parent link="base"/><child link="column"/>
\t\t<limit upper="0.4" lower="0" velocity="1" effort="1"/><axis xyz="0 0 1"/></joint>
\t<link name="column"/>
  <joint name="angular" type="revolute">
    <!-- before --><origin
        rpy = "0 0   0.0"   drake:note='keep me' xyz='0.4 0 0.1'
    /><!-- after -->
    <parent link="column"/><child link="swivel"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/><dynamics damping="0.5"/>
  </joint>
  <link name="swivel"/>
  <joint name="orbital" type="revolute"><origin xyz="0.8 0.02 0.1"></origin>
    <parent link="swivel"/><child link="c"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
    <calibration rising="0.0"/></joint>
  <link name="c"/>
  <joint name="finger" type="revolute"><parent link="c"/><child link="tip"/><origin xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="orbital" multiplier="-1"/></joint>
  <link name="tip"/>
  <joint name="bracket" type="fixed"><parent link="c"/><child link="plate"/>
    <origin xyz="0.1 0 0.3" rpy="0 0.2 0"/></joint>
  <link name="plate"/>
  <joint name="sensor_mount" type="fixed"><parent link="plate"/><child link="sensor"/><origin xyz="0 -0.1 0.3"/></joint>
  <link name="sensor"/>
  <transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="orbital"/></transmission>
  <gazebo reference="c"><material>Gazebo/Grey</material></gazebo>
</robot>
<!-- the end -->
"""
ORIGIN = re.compile(r"<origin[^>]*>")


def of_odd(seed: int = 0, sensor: str = "sensor", joints: Sequence[str] | None = None):
    """The calibration of the odd file from exact poses of a machine whose ``joints`` stand elsewhere, that machine's
    text, and its base."""
    q = random_values(["angular", "orbital"], 60, seed) | {"lift": np.linspace(0, 0.3, 60)}
    truth, base = perturbed(ODD, 3e-3, 8e-3, seed, joints), stand(seed)
    recording = recorded(base @ kinematics(truth, sensor, q), joints=q, prismatic=frozenset({"lift"}))
    free = FreeJoints(("all",) if joints is None else tuple(joint for joint in joints if "mount" not in joint))
    known = {"sigma_reading_rad": 0.0, "sigma_reading_m": 0.0, "sensor_link": sensor}
    return calibrate_chain(recording, parsed(ODD), free=free, **known), truth, base


def outside_origins(text: str) -> list[str]:
    """What stands between the origin tags that are no part of a comment."""
    return ORIGIN.split(re.sub(r"<!--.*?-->", lambda m: m[0].replace("origin", "ORIGIN"), text, flags=re.DOTALL))


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
def test_every_byte_outside_of_changed_origins_stays(newline, bom):
    result, truth, base = of_odd(1, joints=["angular", "orbital", "sensor_mount"])
    assert {origin.joint for origin in result.chain.origins} == {"angular", "orbital", "sensor_mount"}
    data = bom + ODD.replace("\n", newline).encode()
    after = calibrated_urdf(parse_urdf(data, parsed(ODD).path), result.chain).data.decode()
    assert outside_origins(after) == outside_origins(data.decode())
    before, tags = ORIGIN.findall(data.decode()), ORIGIN.findall(after)
    assert [a == b for a, b in zip(before, tags, strict=True)] == [True, False, False, True, True, False]
    (swivel,) = [tag for tag in tags if "drake:note" in tag]
    assert re.sub("'[^']*'|\"[^\"]*\"", "", swivel).split() == ["<origin", "rpy", "=", "drake:note=", "xyz=", "/>"]
    q = random_values(["angular", "orbital"], 30, 9) | {"lift": np.linspace(0, 0.4, 30)}
    poses = result.chain.bases[0].T_world_base @ kinematics(after.lstrip("\ufeff"), "sensor", q)
    np.testing.assert_allclose(poses, base @ kinematics(truth, "sensor", q), atol=1e-9)


def test_a_joint_without_an_origin_gets_one():
    text = C_ARM.replace('<origin xyz="0.4 0 0.1"/>', "")
    assert text != C_ARM
    q = random_values(["angular", "orbital"], 60, 2) | {"lift": np.linspace(0, 0.3, 60)}
    truth, base = perturbed(text, 3e-3, 8e-3, 2, ["angular"]), stand(2)
    recording = recorded(base @ kinematics(truth, "sensor", q), joints=q, prismatic=frozenset({"lift"}))
    exact = {"sigma_reading_rad": 0.0, "sigma_reading_m": 0.0}
    result = calibrate_chain(recording, parsed(text), free=FreeJoints(("angular",)), **exact)
    assert result.refusal is None
    after = calibrated_urdf(parsed(text), result.chain).data.decode()
    assert len(ORIGIN.findall(after)) == len(ORIGIN.findall(text)) + 1
    assert ORIGIN.search(after.split('name="angular"')[1].split("</joint>")[0])
    assert outside_origins(after.replace(ORIGIN.findall(after)[1], "")) == outside_origins(text)


def test_origins_that_did_not_change_stay_as_they_are():
    """Only the mount is unknown: one tag is edited, and in it only its numbers."""
    recording = c_arm_recording(2, C_JOINTS)[2]
    result = calibrate_chain(recording, parsed(C_ARM), free=FreeJoints(("orbital",)))
    before, after = (
        ORIGIN.findall(text) for text in (C_ARM, calibrated_urdf(parsed(C_ARM), result.chain).data.decode())
    )
    changed = [a != b for a, b in zip(before, after, strict=True)]
    assert changed == [False, False, True, True]


def test_the_poses_of_the_file_are_those_of_the_estimate():
    """To 1e-9 m: with exact readings the residuals of the result are those of the file."""
    recording = arm_recording(3)[2]
    result = calibrate_chain(recording, parsed(arm()), sigma_reading_rad=0.0, **ARM_AXES)
    text = calibrated_urdf(parsed(arm()), result.chain).data.decode()
    poses = result.chain.bases[0].T_world_base @ kinematics(text, "tool", recording.joints)
    off = np.linalg.inv(poses) @ poses_of(recording)
    rms = np.sqrt((off[:, :3, 3] ** 2).sum(axis=1).mean())
    assert rms == pytest.approx(result.chain.calibrated.translation_rms_m, abs=1e-9)


def test_zeros_are_in_the_file():
    """A zero of 0.03 rad alone is free: the file's poses at the readings are the recorded ones."""
    q, base = random_values(ARM_JOINTS, 60, 4), stand(4)
    T = base @ kinematics(arm(), "tool", q)
    read = q | {"j4": q["j4"] - 0.03}
    free = FreeJoints(placements=("none",), zeros=("j4",))
    result = calibrate_chain(recorded(T, joints=read), parsed(arm()), free=free, sigma_reading_rad=0.0, **ARM_AXES)
    text = calibrated_urdf(parsed(arm()), result.chain).data.decode()
    assert {origin.joint for origin in result.chain.origins} == {"j4", "tool_mount"}
    poses = result.chain.bases[0].T_world_base @ kinematics(text, "tool", read)
    np.testing.assert_allclose(poses, T, atol=1e-9)


@given(st.integers(0, 500))
@settings(max_examples=5)
def test_read_again_gives_the_estimates_poses(seed):
    result, truth, base = of_odd(seed)
    text = calibrated_urdf(parsed(ODD), result.chain).data.decode()
    q = random_values(["angular", "orbital"], 20, seed) | {"lift": np.linspace(0, 0.4, 20)}
    poses = result.chain.bases[0].T_world_base @ kinematics(text, "sensor", q)
    np.testing.assert_allclose(poses, base @ kinematics(truth, "sensor", q), atol=1e-9)


def test_a_sensor_on_a_moving_link_gets_a_link_of_its_own():
    """Nothing but lines at the end is added, and no origin on the way is misused for the mount."""
    result, truth, base = of_odd(5, sensor="c")
    (sensor,) = result.chain.sensors
    found = calibrated_urdf(parsed(ODD), result.chain)
    text = found.data.decode()
    assert 'name="c_sensor"' in text  # the file has a link named sensor
    assert text.endswith("</robot>\n<!-- the end -->\n")
    assert found.links == (*parsed(ODD).links, "c_sensor")
    q = random_values(["angular", "orbital"], 20, 5) | {"lift": np.linspace(0, 0.4, 20)}
    poses = result.chain.bases[0].T_world_base @ kinematics(text, "c_sensor", q)
    np.testing.assert_allclose(poses, base @ kinematics(truth, "c", q), atol=1e-9)
    assert sensor.link == "c"


def test_a_sensor_that_stands_on_another_sensors_link():
    """Moving the first mount moves the second sensor with it; its own origin makes up for that."""
    text = C_ARM.replace(
        "</robot>",
        '  <joint name="second_mount" type="fixed"><parent link="sensor"/><child link="second"/>'
        '<origin xyz="0 0.1 0" rpy="0.5 0 0"/></joint>\n  <link name="second"/>\n</robot>',
    )
    truth, base = perturbed(text, 3e-3, 8e-3, 6), stand(6)
    q = random_values(["angular", "orbital"], 60, 6)
    named = np.array(["second", "sensor"] * 30)
    first, second = (base @ kinematics(truth, link, q) for link in ("sensor", "second"))
    T = np.where((named == "sensor")[:, None, None], first, second)
    result = calibrate_chain(recorded(T, joints=q, metadata={"sensor": named}), parsed(text), sigma_reading_rad=0.0)
    after = calibrated_urdf(parsed(text), result.chain).data.decode()
    for link, poses in (("sensor", first), ("second", second)):
        found = result.chain.bases[0].T_world_base @ kinematics(after, link, q)
        np.testing.assert_allclose(found, poses, atol=1e-9)


def test_another_file_is_refused():
    result = calibrate_chain(c_arm_recording(2, C_JOINTS)[2], parsed(C_ARM))
    with pytest.raises(InputError, match="has no link 'sensor'"):
        calibrated_urdf(parsed(arm()), result.chain)


def test_written_and_read_again(tmp_path):
    result = calibrate_chain(c_arm_recording(2, C_JOINTS)[2], parsed(C_ARM))
    found = calibrated_urdf(parsed(C_ARM), result.chain)
    write_urdf(found, tmp_path / "out.urdf")
    again = read_urdf(tmp_path / "out.urdf")
    assert again.data == found.data
    assert calibrated_urdf(again, result.chain).data == found.data
