"""``python -m carm_kin``."""

from carm_kin.cli.main import main

main()
