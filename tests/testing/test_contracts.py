"""The importable contracts go red for each promise that is broken."""

from dataclasses import replace

import numpy as np
import pytest

from carm_kin.exports import itk
from carm_kin.recording.formats import tum
from carm_kin.testing import check_export, check_format, check_locus, check_solver
from helpers.trackers import MAKERS
from solvers import closed_form
from solvers.loci import point

SOLVE, READ, BASIS = closed_form.solve, tum.read, point.Locus.basis


def test_what_keeps_its_promises_passes():
    check_solver("closed_form")
    check_locus("point")
    check_format(MAKERS["tum"]())
    check_export("itk")


def writes(problem, options):
    problem.p_world_sensor[0] += 0.0
    return SOLVE(problem, options)


def is_random(problem, options):
    found = SOLVE(problem, options)
    return replace(found, minor_radius=found.minor_radius + np.random.default_rng().normal() * 1e-6)


def trusts_the_world(problem, options):
    found = SOLVE(problem, options)
    return replace(found, center=found.center * (1 + 1e-3))


def has_axes_swapped(problem, options):
    found = SOLVE(problem, options)
    return replace(found, torus=replace(found.torus, T_sensor_carm=found.torus.T_sensor_carm[:, [1, 0, 2, 3]]))


@pytest.mark.parametrize(
    "solve, words",
    [
        (writes, "read-only"),
        (is_random, "minor_radius differs from run to run"),
        (trusts_the_world, "center and torus differ"),
        (has_axes_swapped, "T_sensor_carm"),
        (lambda problem, options: replace(SOLVE(problem, options), solver="x"), "of 'x', not of 'closed_form'"),
        (lambda problem, options: 5, "gives a int, not an Estimate"),
    ],
)
def test_a_solver(solve, words, monkeypatch):
    def documented(problem, options=closed_form.Options()):
        """Solve."""
        return solve(problem, options)

    monkeypatch.setattr(closed_form, "solve", documented)
    with pytest.raises((AssertionError, ValueError), match=words):
        check_solver("closed_form")


def test_a_locus(monkeypatch):
    monkeypatch.setattr(point.Locus, "basis", lambda self, theta: 2 * BASIS(self, theta))
    with pytest.raises(AssertionError, match="the basis is not orthonormal"):
        check_locus("point")


@pytest.mark.parametrize(
    "changed, words",
    [
        (lambda raw: replace(raw, cut_off=0), "frames begin and"),
        (lambda raw: replace(raw, unit="cm"), "positions"),
        (lambda raw: replace(raw, quaternion="wxyz"), "orientations are off"),
        (lambda raw: replace(raw, time_s=2 * raw.time_s), "times"),
    ],
)
def test_a_format(changed, words, monkeypatch):
    monkeypatch.setattr(tum, "read", lambda path, declared: changed(READ(path, declared)))
    with pytest.raises(AssertionError, match=words):
        check_format(MAKERS["tum"]())


@pytest.mark.parametrize("fact", ["sigma", "units", "5c5c", "2031", "convention"])
def test_an_export(fact, monkeypatch):
    facts = itk.facts
    monkeypatch.setattr(itk, "facts", lambda *given: [word for word in facts(*given) if fact not in word])
    with pytest.raises(AssertionError, match="the file"):
        check_export("itk")
