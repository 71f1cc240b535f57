"""What imports what, what prints and what exits, read from the source without running it."""

import ast
import sys
from pathlib import Path

import pytest

from helpers.places import ROOT

SOLVERS = sorted((ROOT / "solvers").rglob("*.py"))
CARM_KIN = sorted((ROOT / "carm_kin").rglob("*.py"))
STANDARD = set(sys.stdlib_module_names)
MOST_LINES = 400


def every(files: list[Path]):
    return pytest.mark.parametrize("path", files, ids=[str(path.relative_to(ROOT)) for path in files])


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


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


def test_there_is_something_to_look_at():
    assert len(SOLVERS) > 10
    assert len(CARM_KIN) > 10
    assert any("numpy" in imports(path) for path in SOLVERS)
    assert any(name == "np.eye" for path in SOLVERS for name, _ in calls(path))


@every(SOLVERS)
def test_solvers_import_only_mathematics(path):
    roots = {name.split(".")[0] for name in imports(path)}
    assert roots - STANDARD <= {"numpy", "scipy", "casadi", "solvers"}


@every(CARM_KIN)
def test_only_kinematics_imports_pinocchio(path):
    if path != ROOT / "carm_kin" / "machine" / "kinematics.py":
        assert not {name for name in imports(path) if name.split(".")[0] in ("pinocchio", "pin")}


def test_kinematics_does_import_pinocchio():
    assert "pinocchio" in imports(ROOT / "carm_kin" / "machine" / "kinematics.py")


@every(CARM_KIN)
def test_the_package_imports_neither_scripts_nor_tests_nor_benchmarks(path):
    assert not {name.split(".")[0] for name in imports(path)} & {"scripts", "tests", "benchmarks"}


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
