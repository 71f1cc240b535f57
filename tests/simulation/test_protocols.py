"""Protocols: how many poses, at which angles, and what a protocol file may say."""

import re

import numpy as np
import pytest

from carm_kin.errors import InputError
from carm_kin.machine.chain import Chain, chain_of
from carm_kin.machine.urdf import bundled_urdfs, parse_urdf, read_urdf
from carm_kin.simulation.protocols import FREE_POSES, MAX_POSES, motions


@pytest.fixture(scope="module")
def chain() -> Chain:
    return chain_of(read_urdf("mobile_nonisocentric"))


def degrees(chain: Chain, protocol, seed: int = 0):
    """(alpha, beta) of every motion, their labels, and the notes."""
    plan, notes = motions(chain, protocol, np.random.default_rng(seed))
    angles = [np.degrees(motion.q[:, [chain.angular, chain.orbital]]) for motion in plan]
    others = np.concatenate([motion.q for motion in plan])
    others[:, [chain.angular, chain.orbital]] = 0
    assert not others.any()
    return angles, [(motion.sweep, motion.moving) for motion in plan], [note.code for note in notes]


def test_paper(chain):
    angles, labels, notes = degrees(chain, "paper")
    assert sum(map(len, angles)) == 10_080
    assert [moving for _, moving in labels] == ["orbital"] * 19 + ["angular"] * 9
    assert len({label for label, _ in labels}) == 28
    for k, part in enumerate(angles[:19]):
        np.testing.assert_allclose(part[:, 0], -90 + 10 * k, atol=1e-12)
        np.testing.assert_allclose(part[:, 1], np.arange(360), atol=1e-12)
    for k, part in enumerate(angles[19:]):
        np.testing.assert_allclose(part[:, 0], np.arange(360), atol=1e-12)
        np.testing.assert_allclose(part[:, 1], 20 * k, atol=1e-12)
    assert notes == ["joint_limits_ignored"]


def test_minimal(chain):
    angles, labels, notes = degrees(chain, "minimal")
    assert [len(part) for part in angles] == [360] * 4
    assert [moving for _, moving in labels] == ["orbital"] * 3 + ["angular"]
    assert [part[0, 0] for part in angles[:3]] == pytest.approx([-90, 0, 90])
    assert angles[3][0, 1] == 0
    assert notes == ["joint_limits_ignored"]


def test_clinical_stays_within_the_limits(chain):
    angles, labels, notes = degrees(chain, "clinical")
    assert [moving for _, moving in labels] == ["orbital"] * 5 + ["angular"] * 3
    assert [len(part) for part in angles] == [151] * 5 + [181] * 3
    assert [part[0, 0] for part in angles[:5]] == pytest.approx([-90, -45, 0, 45, 90])
    assert [part[0, 1] for part in angles[5:]] == pytest.approx([-2.5, 35, 72.5])
    assert (angles[0][0, 1], angles[0][-1, 1]) == pytest.approx((-40, 110))
    assert notes == []


def test_free_is_smooth_random_and_within_the_limits(chain):
    (path,), labels, notes = degrees(chain, "free")
    (other,), _, _ = degrees(chain, "free", seed=1)
    assert labels == [("", "")]
    assert notes == []
    assert len(path) == FREE_POSES
    assert path.min(axis=0) == pytest.approx([-180, -40])
    assert path.max(axis=0) == pytest.approx([180, 110])
    assert np.abs(np.diff(path, axis=0)).max() < 10
    assert np.abs(path - other).max() > 10


def test_joints_moves_every_joint_through_its_range_and_tells_all(chain):
    (motion,), notes = motions(chain, "joints", np.random.default_rng(0))
    assert notes == ()
    assert (motion.sweep, motion.moving, motion.q.shape) == ("", "", (FREE_POSES, len(chain.names)))
    low, high = motion.q.min(axis=0), motion.q.max(axis=0)
    turns = [chain.index(name) for name in ("cart_yaw", "wig_wag", "angular", "orbital")]
    slides = [chain.index(name) for name in ("cart_x", "cart_y", "lift", "horizontal")]
    assert np.degrees(low[turns]) == pytest.approx([-180, -12, -180, -40])
    assert np.degrees(high[turns]) == pytest.approx([180, 12, 180, 110])
    assert low[slides] == pytest.approx([-0.25, -0.25, 0, -0.1])
    assert high[slides] == pytest.approx([0.25, 0.25, 0.45, 0.1])
    assert np.abs(np.diff(motion.q, axis=0) / np.ptp(motion.q, axis=0)).max() < 0.03
    assert np.abs(np.corrcoef(motion.q.T) - np.eye(8)).max() < 0.9
    assert list(motion.told) == list(chain.names)
    np.testing.assert_array_equal(np.stack(list(motion.told.values()), axis=1), motion.q)


def test_joints_stays_within_limits_far_from_zero():
    text = read_urdf("mobile_nonisocentric").data.replace(b'lower="0" upper="0.45"', b'lower="0.7" upper="1.9"')
    chain = chain_of(parse_urdf(text, bundled_urdfs()["mobile_nonisocentric"]))
    (motion,), _ = motions(chain, "joints", np.random.default_rng(0))
    lift = motion.q[:, chain.index("lift")]
    assert (lift.min(), lift.max()) == pytest.approx((0.7, 1.2))


@pytest.mark.parametrize("limits", [(0.2, 0.5), (0.0, 0.0), (100.0, 200.0), (-3.0, -2.9)])
@pytest.mark.parametrize("protocol", ["paper", "minimal", "clinical", "free", "joints"])
def test_odd_limits_give_poses_all_the_same(limits, protocol):
    text = read_urdf("mobile_nonisocentric").data.decode()
    low, high = np.radians(limits)
    for old in (r'lower="-3\.9[^"]*" upper="3\.9[^"]*"', r'lower="-0\.698[^"]*" upper="1\.919[^"]*"'):
        text, count = re.subn(old, f'lower="{low}" upper="{high}"', text)
        assert count == 1
    chain = chain_of(parse_urdf(text.encode(), bundled_urdfs()["mobile_nonisocentric"]))
    plan, _ = motions(chain, protocol, np.random.default_rng(0))
    assert all(len(motion.q) and np.isfinite(motion.q).all() for motion in plan)


def written(tmp_path, text: str):
    file = tmp_path / "protocol.toml"
    file.write_text(text)
    return file


SWEEP = '[[sweep]]\nmoving = "orbital"\nfrom_deg = 30\nto_deg = -40.5\n'


def test_a_file(chain, tmp_path):
    second = '[[sweep]]\nmoving = "angular"\nfrom_deg = -10\nto_deg = 10\nstep_deg = 5\n'
    second += "held_deg = {orbital = 20, wig_wag = -3}\nheld_mm = {lift = 120.5}\n"
    plan, notes = motions(chain, written(tmp_path, SWEEP + second), np.random.default_rng(0))
    q = [np.degrees(motion.q) for motion in plan]
    np.testing.assert_allclose(q[0][:, chain.orbital], np.arange(30, -41, -1), atol=1e-12)
    np.testing.assert_allclose(q[1][:, chain.angular], [-10, -5, 0, 5, 10], atol=1e-12)
    np.testing.assert_allclose(q[1][:, chain.orbital], 20)
    np.testing.assert_allclose(q[1][:, chain.index("wig_wag")], -3)
    np.testing.assert_allclose(plan[1].q[:, chain.index("lift")], 0.1205)
    assert [(motion.sweep, motion.moving) for motion in plan] == [("1", "orbital"), ("2", "angular")]
    told = [{name: set(values) for name, values in motion.told.items()} for motion in plan]
    assert told[0] == {"lift": {0}, "wig_wag": {0}, "angular": {0}}
    assert told[1] == {"lift": {0.1205}, "wig_wag": {np.radians(-3)}, "orbital": {np.radians(20)}}
    assert notes == (), notes


def test_a_file_beyond_the_limits_says_which_joints(chain, tmp_path):
    _, notes = motions(chain, written(tmp_path, SWEEP + "held_mm = {lift = 451}\n"), np.random.default_rng(0))
    assert [note.code for note in notes] == ["joint_limits_ignored"]
    assert "moves lift beyond" in notes[0].message


@pytest.mark.parametrize("step, last", [(7.0, 30 - 70), (70.5, -40.5), (100, 30.0)])
def test_steps_that_do_not_divide_the_arc(chain, tmp_path, step, last):
    (motion,), _ = motions(chain, written(tmp_path, SWEEP + f"step_deg = {step}\n"), np.random.default_rng(0))
    assert np.degrees(motion.q[-1, chain.orbital]) == pytest.approx(last)


BROKEN = {
    "empty": ("", r"no \[\[sweep\]\] table; each needs moving, from_deg"),
    "misspelt table": (SWEEP.replace("sweep", "sweeps"), r"no \[\[sweep\]\] table"),
    "a table, no list": (SWEEP.replace("[[sweep]]", "[sweep]"), r"no \[\[sweep\]\] table"),
    "a list of numbers": ("sweep = [1, 2]", r"\[\[sweep\]\] number 1 must be a table, not 1"),
    "no TOML": ("[[sweep", "no valid TOML"),
    "nested deeply": ("a = " + "[" * 100_000, "no valid TOML"),
    "key missing": (SWEEP.replace("to_deg = -40.5", ""), "number 1: 'to_deg' is missing; needed are moving, from_deg"),
    "unknown key": (SWEEP + "speed = 3\n", "number 1: 'speed' is unknown; it may have moving, from_deg"),
    "text": (SWEEP.replace("30", '"30"'), "number 1: from_deg must be a finite number, not '30'"),
    "true": (SWEEP.replace("30", "true"), "from_deg must be a finite number, not true"),
    "nan": (SWEEP.replace("30", "nan"), "from_deg must be a finite number, not nan"),
    "infinite": (SWEEP.replace("30", "inf"), "from_deg must be a finite number, not inf"),
    "list": (SWEEP.replace("30", "[30]"), "from_deg must be a finite number"),
    "number as joint": (SWEEP.replace('"orbital"', "3"), "moving must be a text, not 3"),
    "unknown joint": (SWEEP.replace("orbital", "arbital"), "moving must be one of angular, orbital, not 'arbital'"),
    "lift moves": (SWEEP.replace("orbital", "lift"), "moving must be one of angular, orbital, not 'lift'"),
    "zero step": (SWEEP + "step_deg = 0\n", "step_deg must be above 0, not 0"),
    "negative step": (SWEEP + "step_deg = -1\n", "step_deg must be above 0, not -1"),
    "tiny step": (SWEEP + "step_deg = 1e-300\n", f"at most {MAX_POSES} are made"),
    "huge arc": (SWEEP.replace("30", "1e300"), "must lie within 3600 degrees"),
    "many poses": ((SWEEP + "step_deg = 1e-4\n") * 2, f"2 poses; at most {MAX_POSES} are made"),
    "held number": (SWEEP + "held_deg = 3\n", "held_deg must be a table, not 3"),
    "held text": (SWEEP + 'held_deg = {angular = "a"}\n', "held_deg.angular must be a finite number, not 'a'"),
    "held nan": (SWEEP + "held_mm = {lift = nan}\n", "held_mm.lift must be a finite number, not nan"),
    "held unknown": (SWEEP + "held_deg = {bogus = 1}\n", "held_deg cannot hold 'bogus'; it may have cart_yaw, wig_wag"),
    "lift in degrees": (SWEEP + "held_deg = {lift = 1}\n", "held_deg cannot hold 'lift'"),
    "angle in mm": (SWEEP + "held_mm = {angular = 1}\n", "held_mm cannot hold 'angular'; it may have cart_x"),
    "held and moving": (SWEEP + "held_deg = {orbital = 1}\n", "'orbital' moves and cannot stand in held_deg"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_file_says_what_would_be_right(kind, chain, tmp_path):
    text, expected = BROKEN[kind]
    file = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        motions(chain, file, np.random.default_rng(0))
    assert str(error.value).startswith(f"{file}: ")
    assert re.search(expected, str(error.value)), error.value
    assert "\n" not in str(error.value)


def test_the_second_sweep_is_named_as_such(chain, tmp_path):
    with pytest.raises(InputError, match=r"\[\[sweep\]\] number 2"):
        motions(chain, written(tmp_path, SWEEP + SWEEP + "step_deg = 0\n"), np.random.default_rng(0))


def test_a_file_that_is_none(chain, tmp_path):
    folder, binary, huge = tmp_path / "folder.toml", tmp_path / "binary.toml", tmp_path / "huge.toml"
    folder.mkdir()
    binary.write_bytes(b"\xff\xfe")
    with huge.open("wb") as file:
        file.truncate(10_000_001)
    rng = np.random.default_rng(0)
    for path, expected in ((folder, "is not a file"), (binary, "no valid TOML"), (huge, "larger than 10 MB")):
        with pytest.raises(InputError, match=expected):
            motions(chain, path, rng)
    with pytest.raises(InputError, match="'bogus' is unknown; it is one of paper, clinical, minimal, free"):
        motions(chain, "bogus", rng)
