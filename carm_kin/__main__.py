"""``python -m carm_kin``."""

from carm_kin.cli import main

main()
