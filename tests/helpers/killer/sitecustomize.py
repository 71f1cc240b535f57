"""A worker that opens a file of this name dies at once, as one that runs out of memory does. Python imports this by
itself where the folder stands in PYTHONPATH."""

import os
import signal
import sys

KILLS = "kills.csv"


def _die(event: str, arguments: tuple) -> None:
    if event == "open" and str(arguments[0]).endswith(KILLS) and _in_worker():
        os.kill(os.getpid(), signal.SIGKILL)


def _in_worker() -> bool:
    module = sys.modules.get("multiprocessing.process")
    return module is not None and module.parent_process() is not None


sys.addaudithook(_die)
