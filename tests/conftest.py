"""What all tests share: hypothesis without a clock or a memory, and studies only when asked for."""

import os
import signal

import pytest
from hypothesis import HealthCheck, settings

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # NumPy is imported after this; the matrices of the tests are small

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would pass it on to commands

settings.register_profile(
    "carm-kin", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("carm-kin")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip the slow statistical studies unless ``-m`` names them."""
    if "study" in (config.option.markexpr or ""):
        return
    for item in items:
        if item.get_closest_marker("study"):
            item.add_marker(pytest.mark.skip(reason="a study; run it with `pytest -m study`"))
