"""Accuracy, coverage and robustness of the solvers; every study is one command, ``python -m benchmarks.NAME``.

Each command prints its tables and writes its section of RESULTS.md, between its markers.
"""

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before NumPy is imported: one process a core, and matrices are small
