"""Help that names what there is, of this package and of others; it is looked for when the help is shown."""

from collections.abc import Callable
from typing import Any

from typer.core import TyperCommand


class Naming(TyperCommand):
    """A command in whose help ``{solvers}``, ``{loci}``, ``{exports}`` and ``{effects}`` stand for their names."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        for option in self.params:
            text = getattr(option, "help", None)
            for place, names in _NAMES.items():
                if text and place in text:
                    text = text.replace(place, ", ".join(names()))
                    option.help = text  # pyright: ignore[reportAttributeAccessIssue]
        super().format_help(ctx, formatter)


def _solvers() -> tuple[str, ...]:
    from solvers import SOLVERS

    return SOLVERS.listed()


def _loci() -> tuple[str, ...]:
    from solvers.loci import LOCI, by_option

    return by_option(LOCI.listed())


def _exports() -> tuple[str, ...]:
    from carm_kin.exports import EXPORTS

    return EXPORTS.listed()


def _effects() -> tuple[str, ...]:
    from solvers.effects.columns import EFFECTS

    return tuple(EFFECTS)


_NAMES: dict[str, Callable[[], tuple[str, ...]]] = {
    "{solvers}": _solvers,
    "{loci}": _loci,
    "{exports}": _exports,
    "{effects}": _effects,
}
