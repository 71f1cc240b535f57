"""What the operator says of the poses as they arrive: the sweep, the joint that moves, its label, the placement."""

from dataclasses import dataclass, replace
from math import isfinite

from carm_kin.errors import InputError


@dataclass(frozen=True)
class Marks:
    """What is written beside each pose. A change gives other marks; nothing is ever modified.

    A sweep has one moving joint, one label and one placement, so a change of these within a sweep begins another.
    """

    angular: str = "angular"
    orbital: str = "orbital"
    sweep: int = 0
    """The number of the last sweep that began."""
    within: bool = False
    """Whether that sweep goes on."""
    moving: str = ""
    """The joint that moves; "" = not said."""
    held_deg: float | None = None
    """The label of the joint that is held."""
    placement: int = 1

    def __post_init__(self) -> None:
        """Raise InputError for names of joints that cannot be those of columns."""
        for joint in (self.angular, self.orbital):
            if not joint or any(c.isspace() or c in ',"#' or not c.isprintable() for c in joint):
                raise InputError(f"'{joint}' cannot be the name of a joint: no white space, comma, quote or #")
        if self.angular == self.orbital:
            raise InputError(f"the two joints need different names, not '{self.angular}' twice")

    @property
    def held(self) -> str:
        """The joint that is held; "" where it is not said which one moves."""
        return {self.angular: self.orbital, self.orbital: self.angular}.get(self.moving, "")

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """Of the columns sweep, moving, placement and the joints' values in degrees, angular first."""
        if not self.within:
            return "", "", str(self.placement), "", ""
        label = "" if self.held_deg is None else f"{self.held_deg:.9g}"
        angular, orbital = (label if joint == self.held else "" for joint in (self.angular, self.orbital))
        return str(self.sweep), self.moving, str(self.placement), angular, orbital

    def new_sweep(self) -> "Marks":
        """A sweep begins; the one before ends."""
        return replace(self, sweep=self.sweep + 1, within=True, held_deg=None)

    def end_sweep(self) -> "Marks":
        """The sweep ends; the poses that follow belong to none."""
        return replace(self, within=False, held_deg=None)

    def next_moving(self) -> "Marks":
        """The other joint moves, first the orbital one."""
        changed = replace(self, moving=self.angular if self.moving == self.orbital else self.orbital)
        return changed.new_sweep() if self.within else changed

    def begun(self, moving: str | None, held_deg: float | None) -> "Marks":
        """With a sweep in which the joint `moving` moves and the other one stands at ``held_deg``, where they are said.

        Raises InputError for a name that is none of the two joints, and for a label of an unknown joint.
        """
        if moving is None and held_deg is None:
            return self
        if moving is not None and moving not in (self.angular, self.orbital):
            raise InputError(f"the moving joint '{moving}' is neither '{self.angular}' nor '{self.orbital}'")
        begun = replace(self, moving=moving or "").new_sweep()
        return begun if held_deg is None else begun.labelled(repr(held_deg))

    def labelled(self, degrees: str) -> "Marks":
        """The held joint stands at so many degrees; where no sweep goes on, or it has a label, another begins.

        Raises InputError where it is no finite number, or not said which joint moves.
        """
        if not self.held:
            raise InputError("say first which joint moves; the label is of the other one")
        try:
            value = float(degrees)
        except ValueError:
            value = float("nan")
        if not isfinite(value) or abs(value) > 360:
            raise InputError(f"the label '{degrees}' is no angle in degrees")
        begun = self if self.within and self.held_deg is None else self.new_sweep()
        return replace(begun, held_deg=value)

    def new_placement(self) -> "Marks":
        """The base was moved; the sweep ends."""
        return replace(self.end_sweep(), placement=self.placement + 1)
