"""Single keys from the terminal, where there is one; else none."""

import contextlib
import os
import select
import sys
import time
from collections.abc import Iterator

try:
    import termios
    import tty
except ImportError:  # Windows has no termios; a capture there has no keys
    termios = tty = None


class Keys:
    """Where keys come from."""

    def read(self, timeout_s: float) -> str:
        """The keys that were pressed, as soon as there is one; "" after the timeout."""
        time.sleep(timeout_s)
        return ""


class TerminalKeys(Keys):
    """The terminal's keys, unbuffered."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def read(self, timeout_s: float) -> str:
        ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
        return os.read(self._descriptor, 64).decode("utf-8", "ignore") if ready else ""


@contextlib.contextmanager
def keys() -> Iterator[Keys]:
    """The keys of the terminal at standard input, which is as it was afterwards; or none."""
    if termios is None or tty is None or not sys.stdin.isatty():
        yield Keys()
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield TerminalKeys(descriptor)
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
