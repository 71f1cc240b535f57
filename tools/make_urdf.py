"""Write the C-arm family from its parametric description: python tools/make_urdf.py urdf"""

import sys
from pathlib import Path

from carm_family import MACHINES
from carm_family.parts import urdf_text


def main(folder: Path) -> None:
    for machine in MACHINES:
        (folder / f"{machine.name}.urdf").write_bytes(urdf_text(machine).encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
