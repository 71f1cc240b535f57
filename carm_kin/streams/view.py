"""What a capture shows: a panel that is drawn anew on a terminal, plain lines elsewhere."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from rich.console import Console, Group
from rich.live import Live as Screen
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from carm_kin.streams.capture import Scene
from carm_kin.streams.estimate import Current
from carm_kin.streams.live import Live, Snapshot
from solvers.se3 import Array

LINE_S = 5.0
"""Time between two plain lines."""
DRAW_S = 0.25
"""Time between two drawings of the panel."""


@dataclass(frozen=True)
class Title:
    """What stays the same during a capture."""

    server: str
    tool: str
    reference: str | None
    path: str
    goal_m: float | None


@contextmanager
def view(title: Title, live: Live, console: Console) -> Iterator[Callable[[Scene], None]]:
    """A function that shows a scene as often as is useful."""
    if not console.is_terminal:
        yield Lines(title, live, console)
        return
    with Screen(console=console, auto_refresh=False, transient=True) as screen:
        yield Drawing(title, screen)


class Lines:
    """One line every few seconds, and one for every event."""

    def __init__(self, title: Title, live: Live, console: Console) -> None:
        self._title = title
        self._live = live
        self._console = console
        self._due = time.monotonic() + LINE_S
        self._alarmed = False

    def __call__(self, scene: Scene) -> None:
        """Print what is due."""
        while self._live.fresh_events:
            self._print(scene.live, self._live.fresh_events.popleft())
        if scene.live.stalled != self._alarmed:
            self._alarmed = scene.live.stalled
            self._print(scene.live, _alarm(self._title, scene) or "poses arrive again")
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + LINE_S
            parts = [_rate(scene.live), _losses(scene), _marks(scene.live), _calibration(scene.current, self._title)]
            here = _here(scene.live, scene.current)
            self._print(scene.live, "; ".join([*parts, *([f"here {here}"] if here else [])]))

    def _print(self, live: Snapshot, what: str) -> None:
        self._console.print(f"{_clock(live.seconds)} {what}", soft_wrap=True)


class Drawing:
    """A panel in place; the terminal's bell rings when the capture stalls."""

    def __init__(self, title: Title, screen: Screen) -> None:
        self._title = title
        self._screen = screen
        self._due = 0.0
        self._prompt = ""
        self._alarmed = False

    def __call__(self, scene: Scene) -> None:
        """Draw it, if it is time or a key changed something."""
        if scene.live.stalled and not self._alarmed:
            self._screen.console.bell()
        self._alarmed = scene.live.stalled
        now = time.monotonic()
        if now >= self._due or scene.prompt != self._prompt:
            self._due, self._prompt = now + DRAW_S, scene.prompt
            self._screen.update(panel(self._title, scene), refresh=True)


def panel(title: Title, scene: Scene) -> Panel:
    """The whole view."""
    live, now = scene.live, scene.current
    rows = Table.grid(padding=(0, 2))
    rows.add_row("tool", Text(_tool(title, scene)))
    rows.add_row("rate", Text(_rate(live)))
    rows.add_row("losses", Text(_losses(scene)))
    rows.add_row("marks", Text(_marks(live)))
    rows.add_row("swept", Text(_swept(live, now)))
    rows.add_row("offset", Text(_calibration(now, title)))
    if here := _here(live, now):
        rows.add_row("here", Text(here))
    alarm = _alarm(title, scene)
    events = [Text(event, style="yellow") for event in live.events]
    parts = [rows, *([Text(alarm, style="bold white on red")] if alarm else []), *events, Text(scene.prompt, "dim")]
    head = f"{title.server} to {title.path}   {_clock(live.seconds)}"
    return Panel(Group(*parts), title=Text(head), title_align="left", border_style="red" if alarm else "green")


def _tool(title: Title, scene: Scene) -> str:
    within = f" in '{title.reference}'" if title.reference else ""
    seen = "" if scene.live.poses else _others(scene.live)
    return f"'{title.tool}'{within}, {'connected' if scene.connected else 'NOT CONNECTED'}{seen}"


def _others(live: Snapshot) -> str:
    return f"; the server sends {', '.join(live.tools)}" if live.tools else "; the server has sent no pose yet"


def _rate(live: Snapshot) -> str:
    return f"{live.poses} poses, {live.rate_hz:.1f} Hz, visible {live.visible:.0%}"


def _losses(scene: Scene) -> str:
    live = scene.live
    parts = [f"{live.missing} not sent"] if live.missing else []
    parts += [f"{count} {fault}" for fault, count in live.faults.items()]
    parts += [f"{count} {reason}" for reason, count in scene.lost.items()]
    parts += [f"{live.repeated} repeated"] if live.repeated else []
    return ", ".join(parts) or "none lost"


def _marks(live: Snapshot) -> str:
    marks = live.marks
    moving = f"{marks.moving} moves" if marks.moving else "moving joint not said"
    label = "" if marks.held_deg is None else f", {marks.held} at {marks.held_deg:g} deg"
    sweep = f"sweep {marks.sweep}: {moving}{label}, {live.sweep_poses} poses" if marks.within else "between sweeps"
    return f"{sweep}, placement {marks.placement}"


def _swept(live: Snapshot, now: Current | None) -> str:
    if now is None or now.swept_rad is None:
        return f"the tool has turned by {np.degrees(live.turned_rad):.0f} deg"
    marks = live.marks
    return ", ".join(
        f"{joint} {np.degrees(last - first):.0f} deg ({np.degrees(first):.0f} to {np.degrees(last):.0f})"
        for joint, (first, last) in zip((marks.angular, marks.orbital), now.swept_rad, strict=True)
    )


def _calibration(now: Current | None, title: Title) -> str:
    if now is None:
        return "no calibration yet"
    if now.offset_m is None or now.sigma_m is None or now.worst_sigma_m is None:
        return f"no calibration yet: {now.refusal}"
    numbers = _with_sigma(now.offset_m, now.sigma_m)
    goal = f" (goal {title.goal_m * 1e3:g})" if title.goal_m is not None else ""
    return f"{numbers} mm; sigma at most {now.worst_sigma_m * 1e3:.3f} mm{goal}"


def _here(live: Snapshot, now: Current | None) -> str:
    """The offset at the last pose of a C that bends; "" where that says nothing more."""
    if now is None or now.centre is None or now.centre.bent is None or live.last is None or now.offset_m is None:
        return ""
    if now.centre.placement != str(live.marks.placement):
        return ""
    found, bent = now.centre.locate(live.last), now.centre.bent
    angles = found.nearest.alpha_rad, found.nearest.beta_rad
    at = ", ".join(f"{np.degrees(angle[0]):.0f}" for angle in angles)
    beyond = "; EXTRAPOLATED beyond the poses so far" if found.extrapolated[0] else ""
    return f"{_with_sigma(now.offset_m + bent.shift_m(*angles)[0], bent.sigma_m(*angles)[0])} mm at {at} deg{beyond}"


def _with_sigma(value_m: Array, sigma_m: Array) -> str:
    return ", ".join(f"{t * 1e3:.2f} ± {s * 1e3:.2f}" for t, s in zip(value_m, sigma_m, strict=True))


def _alarm(title: Title, scene: Scene) -> str:
    if not scene.live.stalled:
        return ""
    why = "not connected" if not scene.connected else "connected"
    return f"STALLED: no pose of '{title.tool}' for {scene.live.since_pose_s:.0f} s ({why}){_others(scene.live)}"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60:02d}:{int(seconds) % 60:02d}"
