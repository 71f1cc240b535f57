"""What the operator's keys do: mark sweeps, the moving joint, labels and placements; stop."""

from carm_kin.errors import InputError
from carm_kin.streams.live import Live

HELP = "s sweep begins   e sweep ends   m other joint moves   l label   p base moved   q stop"


class Operator:
    """Follows the keys; `stopped` once it was told to stop."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self.stopped = False
        self.entry: str | None = None
        """The label as far as it is typed; None where none is asked for."""

    @property
    def prompt(self) -> str:
        """What to type or press."""
        if self.entry is None:
            return HELP
        return f"{self._live.marks.held} stands at (deg, Enter; Esc: no label): {self.entry}_"

    def press(self, keys: str) -> None:
        """Some keys were pressed, one after the other."""
        for key in keys:
            if self.entry is None:
                self._command(key.lower())
            else:
                self._type(key)

    def _command(self, key: str) -> None:
        live = self._live
        if key == "q":
            self.stopped = True
        elif key == "s":
            live.marks = live.marks.new_sweep()
        elif key == "e":
            live.marks = live.marks.end_sweep()
        elif key == "m":
            live.marks = live.marks.next_moving()
        elif key == "p":
            live.marks = live.marks.new_placement()
        elif key == "l" and live.marks.held:
            self.entry = ""
        elif key == "l":
            live.tell("press m first to say which joint moves; the label is of the other one")

    def _type(self, key: str) -> None:
        assert self.entry is not None
        if key in "\r\n":
            self._label(self.entry)
            self.entry = None
        elif key == "\x1b":
            self.entry = None
        elif key in "\x7f\b":
            self.entry = self.entry[:-1]
        elif key.isprintable() and len(self.entry) < 20:
            self.entry += key

    def _label(self, degrees: str) -> None:
        try:
            self._live.marks = self._live.marks.labelled(degrees)
        except InputError as error:
            self._live.tell(str(error))
