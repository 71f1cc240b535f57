"""What the tools make is what the project holds."""

import re
import runpy

from helpers.places import ROOT

TOOLS = ROOT / "tools"


def test_the_readme_has_every_tool():
    named = re.findall(r"`python tools/(\w+\.py) ", (TOOLS / "README.md").read_text("utf-8"))
    assert sorted(named) == sorted(path.name for path in TOOLS.glob("*.py"))
    assert len(named) >= 3


def test_the_drawing_of_the_conventions_is_that_of_the_torus(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["draw_conventions.py", str(tmp_path / "conventions.svg")])
    runpy.run_path(str(TOOLS / "draw_conventions.py"), run_name="__main__")
    assert (tmp_path / "conventions.svg").read_bytes() == (ROOT / "docs" / "conventions.svg").read_bytes()
