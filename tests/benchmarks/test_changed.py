"""The benchmarks' own simulator against another one, and that every row can be made."""

import numpy as np
import pytest

from benchmarks import mutations, realism, told
from benchmarks.changes import MUTATIONS, Scene
from benchmarks.hand_moved import Machine, Motion
from carm_kin.testing import truth

SCENE = realism.simulated(realism.Effect("white", label_deg=0.0), np.random.default_rng(0))


def test_the_poses_are_those_of_another_closed_form():
    rng = np.random.default_rng(1)
    here, motion = Machine.random(rng), Motion.random(rng)
    T_world_torus, T_carm_sensor = np.eye(4), np.eye(4)
    T_world_torus[:3, :3], T_world_torus[:3, 3] = here.R_tracker_torus, here.center
    T_carm_sensor[:3, :3], T_carm_sensor[:3, 3] = here.R_carm_sensor, here.sensor
    there = truth.Machine(T_world_torus[None], here.radius, here.epsilon, np.linalg.inv(T_carm_sensor))
    np.testing.assert_allclose(here.offset, there.offset, atol=1e-12)
    for mine, other in zip(here.poses(motion.angles), there.poses(motion.angles), strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-9)


@pytest.mark.parametrize("mutation", MUTATIONS, ids=[mutation.name for mutation in MUTATIONS])
def test_every_change_gives_a_recording(mutation):
    machine, take = SCENE
    scene = Scene(machine, take.select(slice(None, None, 8)), mutations.RATE / 2)
    changed = mutation.change(scene, np.random.default_rng(0))
    changed = changed[0] if isinstance(changed, tuple) else changed
    assert len(changed.recording()) == len(changed)


def test_a_row_of_either_table():
    outcome = mutations.run(("unchanged", 0))
    assert outcome.accepted
    assert not outcome.wrong
    assert len(mutations.row_of(MUTATIONS[0], [outcome])) == len(mutations.HEADER)
    outcome = realism.run(("white", 0))
    assert len(realism.row_of("white", [outcome])) == len(realism.HEADER)
    assert len(told.row_of("told", [told.run((told.KINDS[1].name, 0))])) == len(told.HEADER)


def test_a_label_that_was_not_used_is_no_move_of_the_base():
    outcome = mutations.run(("a label 5 deg off", 2))
    assert outcome.status == "ok"
    assert "wrong_label" in outcome.codes
