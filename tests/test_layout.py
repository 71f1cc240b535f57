"""The plan of the house: what imports what, what prints and what exits, read from the source without running it."""

import ast
import os
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from helpers.places import ROOT, pythonpath

SOLVERS = sorted((ROOT / "solvers").rglob("*.py"))
CARM_KIN = sorted((ROOT / "carm_kin").rglob("*.py"))
STANDARD = set(sys.stdlib_module_names)
FACADE = ROOT / "carm_kin" / "__init__.py"
MOST_LINES = 400

GROUND = tuple(f"carm_kin.{name}" for name in ("canvas", "errors", "files", "steps", "typed", "version"))
"""Root files of carm_kin that are one room, the lowest, in `PLAN`; every other root file is a room of its own."""
PLAN = {
    "carm_kin.__main__": "cli",
    "cli": "carm_kin batches calibrated calibration exports ground machine recording report results simulation streams "
    "quality study solvers solvers.effects solvers.loci solvers.se3",
    "carm_kin": "batches calibrated calibration exports ground machine quality recording report results simulation "
    "study",
    "testing": "calibration exports ground recording results solvers solvers.direct solvers.estimate solvers.loci "
    "solvers.problem solvers.se3 solvers.torus",
    "study": "batches calibration ground recording report results simulation "
    "solvers solvers.estimate solvers.likelihood solvers.nearest solvers.problem solvers.se3 solvers.torus",
    "quality": "ground report results solvers.estimate solvers.se3",
    "batches": "calibration ground machine recording results",
    "streams": "calibrated calibration ground recording results solvers.se3",
    "report": "calibrated calibration ground recording results "
    "solvers.kinematic solvers.likelihood solvers.problem solvers.se3 solvers.torus",
    "exports": "calibration ground machine results solvers.plugins solvers.se3",
    "calibrated": "calibration ground machine recording results solvers.estimate solvers.kinematic solvers.likelihood "
    "solvers.nearest solvers.problem solvers.se3 solvers.still_point solvers.torus solvers.verdict",
    "calibration": "ground machine recording results solvers solvers.chain solvers.effects solvers.estimate "
    "solvers.kinematic solvers.likelihood solvers.pivot solvers.plugins solvers.problem solvers.se3 solvers.told "
    "solvers.torus solvers.verdict",
    "simulation": "ground machine recording results solvers.estimate solvers.problem solvers.se3 solvers.torus",
    "results": "ground recording solvers.estimate solvers.likelihood solvers.se3 solvers.torus",
    "recording": "ground solvers.estimate solvers.plugins solvers.problem solvers.se3",
    "machine": "ground solvers.se3",
    "ground": "",
    "solvers": "solvers.plugins",
    "solvers.verdict": "solvers.chain solvers.effects solvers.estimate solvers.kinematic solvers.likelihood "
    "solvers.pivot solvers.problem solvers.se3 solvers.start solvers.told solvers.torus",
    "solvers.chain": "solvers.estimate solvers.kinematic solvers.likelihood solvers.problem solvers.se3 solvers.torus",
    "solvers.kinematic": "solvers.estimate solvers.likelihood solvers.problem solvers.se3 solvers.start solvers.torus",
    "solvers.closed_form": "solvers.estimate solvers.problem solvers.start",
    "solvers.direct": "solvers.decomposed solvers.estimate solvers.likelihood solvers.loci solvers.problem solvers.se3 "
    "solvers.start",
    "solvers.decomposed": "solvers.estimate solvers.problem solvers.se3 solvers.start solvers.torus",
    "solvers.surface": "solvers.estimate solvers.likelihood solvers.problem solvers.se3 solvers.torus",
    "solvers.loci": "solvers.estimate solvers.pivot solvers.plugins solvers.problem solvers.se3 solvers.start "
    "solvers.told solvers.torus",
    "solvers.effects": "solvers.chain solvers.estimate solvers.likelihood solvers.problem solvers.se3 solvers.torus",
    "solvers.start": "solvers.problem solvers.se3 solvers.torus",
    "solvers.pivot": "solvers.likelihood solvers.problem solvers.se3",
    "solvers.told": "solvers.problem solvers.se3",
    "solvers.still_point": "solvers.likelihood solvers.problem solvers.se3",
    "solvers.nearest": "solvers.problem solvers.se3 solvers.torus",
    "solvers.likelihood": "solvers.estimate solvers.problem solvers.se3 solvers.torus",
    "solvers.estimate": "solvers.problem solvers.se3 solvers.torus",
    "solvers.torus": "solvers.problem solvers.se3",
    "solvers.problem": "solvers.se3",
    "solvers.plugins": "",
    "solvers.se3": "",
}
"""Which rooms a room imports; every one stands below it. The rooms of carm_kin stand without its name."""


def every(files: list[Path]):
    return pytest.mark.parametrize("path", files, ids=[str(path.relative_to(ROOT)) for path in files])


class Runs(ast.NodeTransformer):
    """A file without what stands there for type checkers alone."""

    def visit_If(self, node: ast.If) -> ast.AST | None:
        self.generic_visit(node)
        return None if name_of(node.test) == "TYPE_CHECKING" else node


def tree(path: Path) -> ast.Module:
    return Runs().visit(ast.parse(path.read_text(encoding="utf-8"), str(path)))


def imports(path: Path) -> set[str]:
    """Full names of all imported modules, wherever in the file, `import_module("...")` included."""
    found = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = ".".join(path.relative_to(ROOT).parts[: -node.level]) if node.level else ""
            found.add(".".join(part for part in (package, node.module) if part))
        elif isinstance(node, ast.Call) and name_of(node.func).split(".")[-1] in ("import_module", "__import__"):
            found |= {arg.value for arg in node.args[:1] if isinstance(arg, ast.Constant)}
    return found


def name_of(node: ast.expr) -> str:
    """The dotted name of a call's function, "" where it has none."""
    if isinstance(node, ast.Attribute):
        return f"{name_of(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def calls(path: Path) -> list[tuple[str, int]]:
    return [(name_of(node.func), node.lineno) for node in ast.walk(tree(path)) if isinstance(node, ast.Call)]


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in (*SOLVERS, *CARM_KIN)}


def room_of(module: str) -> str:
    """The room of a module, as `PLAN` names it."""
    package, *rest = module.split(".")
    if module in GROUND:
        return "ground"
    is_room = bool(rest) and (ROOT / package / rest[0]).is_dir()
    return rest[0] if package == "carm_kin" and is_room else ".".join([package, *rest[:1]])


def imported_modules(path: Path) -> set[str]:
    """Modules of the project that a file imports, wherever in it, the façade by the names in its table; what stands
    there for type checkers alone is no import."""
    found = {name for name in imports(path) if name in MODULES}
    if path == FACADE:
        found |= {node.value for node in ast.walk(tree(path)) if isinstance(node, ast.Constant)} & {*MODULES}
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & {*MODULES}
            names_beside = len(submodules) < len(node.names)
            found = (found if names_beside or not submodules else found - {node.module or ""}) | submodules
    return found - {module_of(path)}


IMPORTED = {module: imported_modules(path) for module, path in MODULES.items()}


def test_there_is_something_to_look_at():
    assert len(SOLVERS) > 10
    assert len(CARM_KIN) > 10
    assert any("numpy" in imports(path) for path in SOLVERS)
    assert any(name == "np.eye" for path in SOLVERS for name, _ in calls(path))


@every(SOLVERS)
def test_solvers_import_only_mathematics(path):
    roots = {name.split(".")[0] for name in imports(path)}
    assert roots - STANDARD <= {"numpy", "scipy", "casadi", "solvers"}


def test_rooms_import_only_what_the_plan_says():
    arrows = [(module, other) for module, others in IMPORTED.items() for other in sorted(others)]
    crossing = [(module, other) for module, other in arrows if room_of(module) != room_of(other)]
    assert len(crossing) > 300
    assert [(m, other) for m, other in crossing if room_of(other) not in PLAN.get(room_of(m), "").split()] == []


def test_the_plan_has_every_room_and_no_arrow_too_many():
    arrows = {(room_of(module), room_of(other)) for module, others in IMPORTED.items() for other in others}
    assert {*PLAN} == {room_of(module) for module in MODULES}
    assert {(room, other) for room, others in PLAN.items() for other in others.split()} <= arrows


def test_the_plan_has_floors():
    """A room stands above all that it imports: no circle of rooms."""
    order = [*TopologicalSorter({room: others.split() for room, others in PLAN.items()}).static_order()]
    assert {*order} == {*PLAN}


def test_no_circle_between_files():
    assert len([*TopologicalSorter(IMPORTED).static_order()]) == len(MODULES)


def test_only_the_command_imports_the_names_for_python():
    assert {room_of(module) for module, others in IMPORTED.items() if "carm_kin" in others} == {"cli"}


FOLDERS = sorted({path.parent for path in (*SOLVERS, *CARM_KIN)})


@every(FOLDERS)
def test_every_room_says_what_lives_there(path):
    assert len(ast.get_docstring(tree(path / "__init__.py")) or "") > 40


def test_the_page_has_every_room():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rooms = {f"{path.relative_to(ROOT)}/" for path in FOLDERS if path.parent in (ROOT / "carm_kin", ROOT / "solvers")}
    assert rooms == {*re.findall(r"^\| `((?:carm_kin|solvers)/\w+/)` \|", page, flags=re.MULTILINE)}


def test_the_page_names_files_that_there_are():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:carm_kin|solvers|docs|tools|tests|urdf|benchmarks)/[\w./]*)`", page)
    assert len(named) > 40
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_drawing_is_that_of_the_imports(tmp_path):
    """Made anew by `python tools/draw_architecture.py docs/architecture.svg`."""
    command = [sys.executable, ROOT / "tools" / "draw_architecture.py", tmp_path / "architecture.svg"]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": pythonpath()}, timeout=60)
    assert (tmp_path / "architecture.svg").read_bytes() == (ROOT / "docs" / "architecture.svg").read_bytes()


@every(CARM_KIN)
def test_only_kinematics_imports_pinocchio(path):
    if path != ROOT / "carm_kin" / "machine" / "kinematics.py":
        assert not {name for name in imports(path) if name.split(".")[0] in ("pinocchio", "pin")}


def test_kinematics_does_import_pinocchio():
    assert "pinocchio" in imports(ROOT / "carm_kin" / "machine" / "kinematics.py")


@every(CARM_KIN)
def test_the_package_imports_nothing_of_the_project_beside_it(path):
    assert not {name.split(".")[0] for name in imports(path)} & {"scripts", "tests", "benchmarks", "tools"}


@every([*SOLVERS, *CARM_KIN])
def test_only_the_command_line_prints_and_exits(path):
    if path == ROOT / "carm_kin" / "cli" / "main.py":
        return
    forbidden = {"print", "sys.exit", "exit", "quit", "os._exit"}
    if path != ROOT / "carm_kin" / "cli" / "terminal.py":
        forbidden |= {"sys.stdout.write", "sys.stderr.write"}
    assert [f"{name} in line {line}" for name, line in calls(path) if name in forbidden] == []
    raised = [node.exc for node in ast.walk(tree(path)) if isinstance(node, ast.Raise) and node.exc is not None]
    exits = [e for e in raised if name_of(e.func if isinstance(e, ast.Call) else e) == "SystemExit"]
    if path.name != "__main__.py":
        assert exits == []


@every([*SOLVERS, *CARM_KIN])
def test_no_file_is_long(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


@every([*SOLVERS, *CARM_KIN])
def test_every_file_says_what_it_is(path):
    if path.name != "__main__.py":
        assert ast.get_docstring(tree(path))


def test_every_code_is_documented():
    """What the first argument of a `Note` is, stands in docs/refusals.md."""
    calls = [node for path in [*SOLVERS, *CARM_KIN] for node in ast.walk(tree(path)) if isinstance(node, ast.Call)]
    first = [node.args[0] for node in calls if name_of(node.func) == "Note" and node.args]
    codes = {argument.value for argument in first if isinstance(argument, ast.Constant)}
    text = (ROOT / "docs" / "refusals.md").read_text(encoding="utf-8")
    assert len(codes) > 30
    assert {code for code in codes if f"`{code}`" not in text} == set()
