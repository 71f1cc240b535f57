"""Progress of long work: a bar with rate and time left on a terminal, a line for each step elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

Step = Callable[[str, bool], None]
"""Called with a line about what is done, and whether it is worth reading beside a bar."""


class _Rate(ProgressColumn):
    """Steps a second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s")


@contextmanager
def progress(console: Console, what: str, done: int, total: int) -> Iterator[Step]:
    """Show how far the work is, ``done`` of ``total`` steps being done before it begins."""
    if not console.is_terminal:
        yield _plain(console, done, total)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(what, completed=done, total=total)

        def step(line: str, notable: bool) -> None:
            if notable:
                console.print(line, soft_wrap=True)
            bar.advance(task)

        yield step


def _plain(console: Console, done: int, total: int) -> Step:
    def step(line: str, notable: bool) -> None:
        nonlocal done
        done += 1
        console.print(f"{done}/{total} {line}", soft_wrap=True)

    return step
