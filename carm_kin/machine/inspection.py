"""What a URDF says of a C-arm: its chain, ranges and nominal two-axis geometry."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from carm_kin.machine.chain import Chain, NominalGeometry, chain_of, nominal_geometry
from carm_kin.machine.urdf import read_urdf


@dataclass(frozen=True, eq=False)
class Inspection:
    """A chain and its nominal geometry."""

    name: str
    chain: Chain
    geometry: NominalGeometry
    notes: tuple[str, ...]
    """What the reader of the URDF accepted, and what the chain chose, with a remark."""

    def to_dict(self) -> dict[str, Any]:
        """The same as JSON values, units in the names."""
        geometry = self.geometry
        return {
            "urdf": self.name,
            "base_link": self.chain.base_link,
            "sensor_link": self.chain.sensor_link,
            "joints": [self._joint(j) for j in range(len(self.chain.names))],
            "angular": self.chain.names[self.chain.angular],
            "orbital": self.chain.names[self.chain.orbital],
            "major_radius_mm": abs(geometry.major_radius) * 1e3,
            "axis_non_orthogonality_deg": float(np.degrees(geometry.non_orthogonality)),
            "minor_radius_mm": geometry.minor_radius * 1e3,
            "isocentric": bool(geometry.isocentric),
            "offset_sensor_pivot_mm": (geometry.offset * 1e3).tolist(),
            "notes": list(self.notes),
        }

    def _joint(self, j: int) -> dict[str, Any]:
        prismatic = self.chain.types[j] == "prismatic"
        scale, unit = (1e3, "mm") if prismatic else (float(np.degrees(1)), "deg")
        limits = [float(x * scale) if np.isfinite(x) else None for x in (self.chain.lower[j], self.chain.upper[j])]
        name, kind = self.chain.names[j], self.chain.types[j]
        return {"name": name, "type": kind, f"lower_{unit}": limits[0], f"upper_{unit}": limits[1]}


def inspect(urdf: str | Path, sensor_link: str | None, angular: str | None, orbital: str | None) -> Inspection:
    """Read a URDF (a path or a bundled name), its joints and sensor link by name or by default.

    Raises InputError for a broken file or an unknown name.
    """
    file = read_urdf(urdf)
    chain = chain_of(file, sensor_link, angular, orbital)
    return Inspection(Path(file.path).name, chain, nominal_geometry(chain), (*file.notes, *chain.notes))


def show(found: Inspection, console: Console) -> None:
    """Print it, its notes left out."""
    data = found.to_dict()
    table = Table(
        "joint",
        "type",
        Column("from", justify="right"),
        Column("to", justify="right"),
        "",
        "role",
        title=f"{escape(found.name)}: {escape(data['base_link'])} to {escape(data['sensor_link'])}",
        box=box.SIMPLE,
        pad_edge=False,
    )
    roles = {data["angular"]: "first axis (alpha)", data["orbital"]: "second axis (beta)"}
    for joint in data["joints"]:
        unit = "mm" if "lower_mm" in joint else "deg"
        low, high = ("" if x is None else f"{x:.1f}" for x in (joint[f"lower_{unit}"], joint[f"upper_{unit}"]))
        name = joint["name"]
        table.add_row(escape(name), joint["type"], low, high, unit, roles.get(name, ""))
    console.print(table)
    isocentric = "isocentric" if data["isocentric"] else "not isocentric"
    x, y, z = data["offset_sensor_pivot_mm"]
    rows = {
        "major radius": f"{data['major_radius_mm']:.3f} mm ({isocentric})",
        "minor radius": f"{data['minor_radius_mm']:.3f} mm",
        "non-orthogonality": f"{data['axis_non_orthogonality_deg']:.3f} deg",
        "offset sensor to rotation centre": f"({x:.3f}, {y:.3f}, {z:.3f}) mm",
    }
    for name, value in rows.items():
        console.print(f"{name:<34}{value}", soft_wrap=True)
