"""Workers of a Dask cluster that is already running."""

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from time import monotonic
from typing import Any

from carm_kin.batches.pool import WorkersLostError
from carm_kin.errors import InputError, MissingDependencyError

CONNECT_S = 10
"""How long the scheduler may take to answer."""
PATIENCE_S = 60.0
"""How long a cluster may be without a worker."""


class ClientExecutor(Executor):
    """A Dask client as an executor. Its own, `Client.get_executor`, fails where a worker dies after its job ended."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Submit a call, which is done again where its value is lost before it arrives here."""
        remote = self._client.submit(fn, *args, pure=False, **kwargs)
        value = self._client.gather(remote, asynchronous=True)
        return asyncio.run_coroutine_threadsafe(value, self._client.loop.asyncio_loop)


class ClusterWorkers:
    """The workers of the scheduler at ``address``, such as ``tcp://10.0.0.1:8786``; dead ones are the cluster's care.

    Raises MissingDependencyError without the package `distributed`.
    """

    window = 1_000_000
    """Dask itself holds back what its workers cannot do yet."""

    def __init__(self, address: str, patience_s: float = PATIENCE_S) -> None:
        self.address, self.patience_s = address, patience_s
        self.lost: tuple[type[BaseException], ...] = (_distributed().KilledWorker,)
        self._client: Any = None
        self._last_seen = monotonic()

    @contextmanager
    def executor(self, window: int) -> Iterator[Executor]:
        """The cluster as an executor. Raises InputError where no scheduler answers."""
        try:
            client = _distributed().Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler answers at {self.address}: {error}") from None
        with client:
            self._client, self._last_seen = client, monotonic()
            yield ClientExecutor(client)

    def check(self) -> None:
        """Raise WorkersLostError where there has been no worker, or no scheduler, for the time of patience."""
        with suppress(OSError):
            if self._client.status == "running" and self._client.nthreads():
                self._last_seen = monotonic()
        if monotonic() - self._last_seen > self.patience_s:
            raise WorkersLostError(f"the cluster at {self.address} has had no worker for {self.patience_s:.0f} s")


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        words = "a cluster needs the package 'distributed': pip install 'carm-kin[cluster]'"
        raise MissingDependencyError(words) from None
    return distributed
