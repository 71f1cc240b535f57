"""Every solver refuses what it cannot determine, with the right code and without a number."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from helpers.simulated import Motion, machine, problem, sweeps_deg
from solvers import kinematic
from solvers.problem import Problem
from solvers.verdict.assess import Limits, assess

SIGMA = 5e-4, 1e-3
TURN = np.arange(0, 360, 6)
BOTH = sweeps_deg((0, 40, 80), TURN, (0, 60), TURN)
ARCS = sweeps_deg((-45, -15, 15, 45, 80), np.arange(-40, 111), (-40, 20, 80), np.arange(-45, 91))
ANY_MOTION = ("closed_form", "direct", "kinematic")
NUMBERS = ("offset_sensor_pivot_m", "major_radius_m", "minor_radius_m", "axis_non_orthogonality_rad")


def recorded(given: Problem) -> Recording:
    """With the sweeps and labels of the problem."""
    return Recording(
        given.p_world_sensor,
        given.R_world_sensor,
        sweep=given.held.max(axis=1).astype(str),
        moving=np.where(given.held[:, 0] >= 0, "orbital", "angular"),
        joints={"angular": given.label[:, 0], "orbital": given.label[:, 1]},
    )


def moved(motion: Motion) -> Recording:
    return recorded(problem(machine(3), motion, *SIGMA, seed=2))


def parallel(motion: Motion = BOTH) -> Recording:
    """Both joints turn about parallel axes."""
    given, angles, rng = problem(machine(3), motion), motion.angles, np.random.default_rng(0)
    both = Rotation.from_rotvec(angles.sum(axis=1)[:, None] * [0, 0, 1])
    p = Rotation.from_rotvec(angles[:, :1] * [0, 0, 1]).apply([0.3, 0, 0]) + both.apply([0.1, 0.6, 0.2])
    R = both * Rotation.random(random_state=1) * Rotation.from_rotvec(SIGMA[1] * rng.normal(size=p.shape))
    return recorded(
        replace(given, p_world_sensor=p + SIGMA[0] * rng.normal(size=p.shape), R_world_sensor=R.as_matrix())
    )


def garbage() -> Recording:
    given, rng = problem(machine(3), BOTH), np.random.default_rng(0)
    R = Rotation.random(len(given), random_state=3).as_matrix()
    return recorded(replace(given, p_world_sensor=rng.uniform(-1, 1, (len(given), 3)), R_world_sensor=R))


def short() -> Recording:
    """Arcs of 3 degrees under a noise of 3 mm and 0.3 degrees."""
    arc = np.linspace(-1.5, 1.5, 40)
    return recorded(problem(machine(3), sweeps_deg((-1, 0, 1), arc, (-1, 0, 1), arc), 3e-3, 5e-3, seed=2))


def bare(recording: Recording) -> Recording:
    return Recording(recording.p_world_sensor, recording.R_world_sensor)


ONE_JOINT = {
    "orbital only": (lambda: moved(sweeps_deg((0,), TURN, (), TURN)), {"one_axis_only"}),
    "angular only": (lambda: moved(sweeps_deg((), TURN, (0,), TURN)), {"one_axis_only"}),
    "static": (lambda: moved(sweeps_deg((0,), np.zeros(60), (), TURN)), {"one_axis_only"}),
    "too few": (lambda: moved(sweeps_deg((0,), (0, 30), (0,), (0, 30, 50))), {"too_few_poses"}),
}
BOTH_JOINTS = {
    "parallel": (parallel, {"one_axis_only"}),
    "parallel, arcs": (lambda: parallel(ARCS), {"one_axis_only"}),
    "garbage": (garbage, {"misfit", "too_many_outliers"}),
    "short arcs": (short, {"one_axis_only", "unobservable", "too_uncertain"}),
}


def refused(recording: Recording, solver: str) -> str:
    """The code of the refusal, which comes with words and no number."""
    result = carm_kin.calibrate(recording, solver)
    assert result.status == "refused"
    assert result.refusal is not None
    assert len(result.refusal.message) > 20
    assert all(getattr(result, name) is None for name in NUMBERS)
    assert result.placements == ()
    assert result.covariance is None
    return result.refusal.code


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize("solver", ANY_MOTION)
@pytest.mark.parametrize("kind", [*ONE_JOINT, *BOTH_JOINTS])
def test_refusals(kind, solver, labels):
    make, codes = {**ONE_JOINT, **BOTH_JOINTS}[kind]
    recording = make() if labels else bare(make())
    assert refused(recording, solver) in codes


@pytest.mark.parametrize("kind", BOTH_JOINTS)
def test_refusals_of_the_decomposition(kind):
    make, codes = BOTH_JOINTS[kind]
    assert refused(make(), "decomposed") in codes | ({"misfit"} if kind == "short arcs" else set())


@pytest.mark.parametrize("kind", ["orbital only", "angular only", "static"])
def test_the_decomposition_says_which_sweeps_it_needs(kind):
    with pytest.raises(InputError, match="an angular and an orbital sweep"):
        carm_kin.calibrate(ONE_JOINT[kind][0](), "decomposed")


@pytest.mark.parametrize(
    "kind, code",
    [
        ("orbital only", "unobservable"),
        ("angular only", "unobservable"),
        ("static", "misfit"),  # without orientations a span of 2 mm looks like a wrong unit
        ("too few", "too_few_poses"),
        ("parallel", "unobservable"),
        ("garbage", "misfit"),
        ("short arcs", "unobservable"),
    ],
)
def test_refusals_of_positions_alone(kind, code):
    recording = {**ONE_JOINT, **BOTH_JOINTS}[kind][0]()
    assert refused(replace(recording, R_world_sensor=None), "surface") == code


@pytest.mark.parametrize("seed", range(4))
def test_arcs_too_short_for_the_noise_are_not_taken_for_an_ambiguity(seed):
    arc = np.linspace(-3, 3, 8)
    recording = recorded(problem(machine(3), sweeps_deg((-3, 0, 3), arc, (0,), arc), 3e-3, 5e-3, seed=seed))
    assert refused(recording, "kinematic") == "too_uncertain"


@pytest.mark.parametrize("factor, words", [(1e-3, "metres read as millimetres"), (1e3, "millimetres read as metres")])
def test_a_wrong_unit_is_named_by_its_direction(factor, words):
    recording = recorded(problem(machine(3), BOTH, *SIGMA))
    result = carm_kin.calibrate(replace(recording, p_world_sensor=factor * recording.p_world_sensor))
    assert result.refusal is not None
    assert result.refusal.code == "misfit"
    assert words in result.refusal.message


def test_a_length_that_no_c_arm_has_is_a_misfit():
    arc = np.linspace(-3, 3, 40)
    given = problem(machine(3), sweeps_deg((-3, 0, 3), arc, (-3, 0, 3), arc), 1e-6, 1e-5)
    huge = replace(given, p_world_sensor=1e3 * given.p_world_sensor)
    assert np.ptp(huge.p_world_sensor, axis=0).max() < 100
    verdict = assess(huge, kinematic.solve(huge))
    assert verdict.refusal is not None
    assert verdict.refusal.code == "misfit"
    assert "millimetres" in verdict.refusal.message
    assert assess(given, kinematic.solve(given)).refusal is None


def test_when_every_pose_is_rejected_there_are_too_few():
    given = problem(machine(3), BOTH, *SIGMA)
    estimate = replace(kinematic.solve(given), used=np.zeros(len(given), dtype=bool))
    verdict = assess(given, estimate)
    assert verdict.refusal is not None
    assert verdict.refusal.code == "too_few_poses"


def test_too_many_rejected_poses_are_refused_and_some_are_told():
    given = problem(machine(3), BOTH, *SIGMA)
    rng = np.random.default_rng(1)
    for share, code, note in ((0.8, "too_many_outliers", "many_rejected"), (0.3, None, "many_rejected")):
        used = rng.random(len(given)) >= share
        estimate = kinematic.solve(given.select(used))
        angles = np.zeros((len(given), 2))
        angles[used] = estimate.angles
        verdict = assess(given, replace(estimate, used=used, angles=angles))
        assert (verdict.refusal.code if verdict.refusal else None) == code
        assert [n.code for n in verdict.notes] == [note]


def test_the_limits_are_those_given():
    given = problem(machine(3), BOTH, *SIGMA)
    estimate = kinematic.solve(given)
    assert assess(given, estimate).refusal is None
    for limits, code in (
        (Limits(max_sigma_t_m=1e-4), "misfit"),
        (Limits(max_offset_sigma_m=1e-6), "too_uncertain"),
        (Limits(min_poses=1000), "too_few_poses"),
    ):
        refusal = assess(given, estimate, limits).refusal
        assert refusal is not None
        assert refusal.code == code


def test_a_single_sweep_has_one_axis_even_where_no_pose_was_used():
    """The solver may reject every pose of a circle; there are enough of them all the same."""
    given = problem(machine(1), sweeps_deg((-90,), range(0, 360, 4), (), ()), 3e-4, 1e-3)
    estimate = replace(kinematic.solve(given), used=np.zeros(len(given), dtype=bool))
    assert assess(given, estimate).refusal.code == "one_axis_only"
