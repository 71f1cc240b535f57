"""The command `carm-kin`: one file a command, and what all of them share.

Nothing else in the package prints, reads the keyboard or exits."""

import os

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    # before NumPy is imported: on busy cores the threads of small matrices wait for one another, 40 s instead of 1.4
    os.environ.setdefault(_threads, "1")
