"""What a process loads: the help, the import and a plain calibration leave alone what they do not need."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import carm_kin
from helpers.places import ROOT, pythonpath

HEAVY = {"casadi", "jinja2", "lxml", "matplotlib", "pandas", "pinocchio", "plotly", "scipy", "yourdfpy"}
LOADED = "import atexit, json, sys; atexit.register(lambda: print('\\n' + json.dumps(sorted(sys.modules))))\n"
COMMAND = "sys.argv[0] = 'carm-kin'\nfrom carm_kin.cli.main import main\nmain()\n"


def loaded(code: str, *arguments: object) -> set[str]:
    """The modules that another Python has loaded when it ends."""
    ended = subprocess.run(
        [sys.executable, "-c", LOADED + code, *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": pythonpath()},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return set(json.loads(ended.stdout.splitlines()[-1]))


def packages(modules: set[str]) -> set[str]:
    return {module.split(".")[0] for module in modules}


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("startup") / "rec.csv"
    simulated, _ = carm_kin.simulate("mobile_nonisocentric", "clinical", sigma_t_m=2.5e-4, sigma_r_rad=1.7e-3, seed=0)
    carm_kin.write_recording(simulated, path)
    return path


def test_the_help_loads_no_mathematics_and_no_solver():
    found = loaded(COMMAND, "--help")
    assert "carm_kin.cli.calibrate" in found
    assert packages(found) & (HEAVY | {"numpy", "solvers"}) == set()


def test_the_help_of_a_command_loads_no_solver():
    """It lists the loci and solvers by their names."""
    found = loaded(COMMAND, "calibrate", "--help")
    assert packages(found) & HEAVY == set()
    assert not {"solvers.kinematic", "solvers.direct", "solvers.loci.circle"} & found


def test_the_import_loads_numpy_at_most():
    found = loaded("import carm_kin\n")
    assert "carm_kin" in found
    assert packages(found) & (HEAVY | {"typer", "rich", "pydantic"}) == set()


def test_every_public_name_is_there_after_the_import():
    found = loaded("import carm_kin\nassert all(hasattr(carm_kin, name) for name in carm_kin.__all__)\n")
    assert "carm_kin.calibration.calibrate" in found


def test_a_plain_calibration_loads_nothing_heavy(recording, tmp_path):
    result = tmp_path / "result.json"
    found = loaded(COMMAND, "calibrate", recording, "--json", result)
    assert json.loads(result.read_text(encoding="utf-8"))["status"] == "ok"
    assert "solvers.kinematic" in found
    assert packages(found) & HEAVY == set()
    assert {name for name in found if name.startswith(("carm_kin.report", "carm_kin.study", "solvers.chain"))} == set()


@pytest.mark.parametrize("solver, needed", [("direct", "casadi"), ("closed_form", None)])
def test_what_a_solver_needs_is_loaded_with_it(recording, solver, needed):
    found = packages(loaded(COMMAND, "calibrate", recording, "--solver", solver))
    assert found & HEAVY == ({needed} if needed else set())
