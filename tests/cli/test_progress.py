"""Progress: a bar on a terminal, plain lines elsewhere."""

import io

from rich.console import Console

from carm_kin.cli.progress import progress


def shown(terminal: bool) -> str:
    text = io.StringIO()
    console = Console(file=text, force_terminal=terminal, width=80, color_system=None)
    with progress(console, "calibrating", 2, 5) as step:
        step("a: ok", False)
        step("b: refused", True)
        step("c: ok", False)
    return text.getvalue()


def test_elsewhere_every_step_is_a_line():
    assert shown(terminal=False) == "3/5 a: ok\n4/5 b: refused\n5/5 c: ok\n"


def test_on_a_terminal_there_is_a_bar_with_count_rate_and_time_left():
    text = shown(terminal=True)
    assert "calibrating" in text
    assert "5/5" in text
    assert "/s" in text
    assert "0:00:00" in text
    assert "b: refused" in text
    assert "a: ok" not in text
