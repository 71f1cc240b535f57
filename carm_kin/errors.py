"""The one exception tree. A message says what was wrong, where, and what would be right."""


class CarmKinError(Exception):
    """Base of every error that a user can cause."""


class InputError(CarmKinError):
    """Bad usage or bad input; exit status 2.

    The place is part of the message: ``rec.csv, line 7, column qw: ...``.
    """

    def __init__(self, problem: str, *, file: object = None, line: int | None = None, column: str | None = None):
        place = [str(file)] if file is not None else []
        place += [f"line {line}"] if line is not None else []
        place += [f"column {column}"] if column is not None else []
        super().__init__(f"{', '.join(place)}: {problem}" if place else problem)


def wrong_type(given: object, needed: str, hint: str = "") -> InputError:
    """The error for an argument of another kind; ``needed`` is in words, such as ``a recording (its path)``."""
    return InputError(f"{needed} is needed, not {_kind_of(given)}" + (f"; {hint}" if hint else ""))


def _kind_of(given: object) -> str:
    """``a list``, ``an array of shape (5, 4, 4)``, ``None``."""
    if given is None or isinstance(given, (bool, int, float)):
        return repr(given)
    name = given.__name__ if isinstance(given, type) else type(given).__name__
    if (shape := getattr(given, "shape", None)) is not None:
        return f"an array of shape {tuple(shape)}"
    kind = f"the class {name}" if isinstance(given, type) else name
    return kind if kind.startswith("the ") else f"{'an' if name[0].lower() in 'aeiou' else 'a'} {kind}"


class MissingDependencyError(CarmKinError):
    """A package that this platform or installation lacks is needed; the message says how to get it."""


class RefusedError(CarmKinError):
    """The data cannot support a result; exit status 3. ``code`` is stable."""

    def __init__(self, code: str, message: str):
        super().__init__(code, message)
        self.code = code

    def __str__(self) -> str:
        return self.args[1]


def printable(text: str) -> str:
    """Control characters as escapes; line breaks stay."""
    return "\n".join(map(on_one_line, text.split("\n")))


def on_one_line(text: str) -> str:
    """Control characters and line breaks as escapes."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
