"""The wheel: what is in it, and that an installed copy finds its files."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import carm_kin
from helpers.places import ROOT


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built by hatchling in this environment: nothing is downloaded."""
    pytest.importorskip("hatchling", reason="hatchling is not installed here; pip install hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    code = f"from hatchling.build import build_wheel; build_wheel({str(folder)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, timeout=60)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The wheel unpacked as pip does it, in a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_the_wheel_has_both_packages_their_types_templates_and_machines(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = [path for package in ("carm_kin", "solvers") for path in (ROOT / package).rglob("*.py")]
    assert {str(path.relative_to(ROOT)) for path in sources} <= names
    assert {"carm_kin/py.typed", "solvers/py.typed"} <= names
    templates = {str(path.relative_to(ROOT)) for path in (ROOT / "carm_kin/report/templates").iterdir()}
    assert len(templates) > 4
    assert templates <= names
    machines = {f"carm_kin/urdf_files/{path.name}" for path in (ROOT / "urdf").glob("*.urdf")}
    assert len(machines) >= 3
    assert machines <= names


def test_the_wheel_has_nothing_else(wheel):
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert top == {"carm_kin", "solvers", f"carm_kin-{carm_kin.__version__}.dist-info"}


def test_the_wheel_names_its_command_and_licence(wheel):
    info = f"carm_kin-{carm_kin.__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        assert "carm-kin = carm_kin.cli.main:main" in archive.read(f"{info}/entry_points.txt").decode()
        metadata = archive.read(f"{info}/METADATA").decode()
        assert f"{info}/licenses/LICENSE" in archive.namelist()
    assert "License-Expression: BSD-3-Clause" in metadata
    assert "Requires-Python: >=3.10" in metadata


def _run(installed: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Python with the installed copy in front, somewhere else than the sources."""
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, cwd=installed, env=environment, capture_output=True, text=True, timeout=60, check=False
    )


def test_an_installed_copy_finds_its_machines(installed):
    code = (
        "import carm_kin.machine.urdf as u; print(u.__file__); print(*map(str, u.bundled_urdfs().values()), sep='\\n')"
    )
    ended = _run(installed, "-c", code)
    module, *machines = ended.stdout.splitlines()
    assert module.startswith(str(installed)), ended.stderr
    assert len(machines) >= 3
    assert all(Path(path).is_file() and path.startswith(str(installed)) for path in machines)


def test_an_installed_copy_runs(installed):
    ended = _run(installed, "-m", "carm_kin", "--version")
    assert (ended.returncode, ended.stdout) == (0, f"carm-kin {carm_kin.__version__}\n"), ended.stderr
    assert _run(installed, "-m", "carm_kin", "inspect", "mobile_isocentric").returncode == 0
