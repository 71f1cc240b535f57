"""One self-contained HTML page from a template: styles, scripts, data and plotly.js are in it."""

import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from carm_kin.files import write_atomically
from carm_kin.report.marks import Figure, keys
from carm_kin.report.plotly_figures import plotly_figure, with_words_once


def write_page(template: str, out: Path, **content: Any) -> None:
    """Fill a template of this package and write the page, whole or not at all.

    Everything is escaped but what this module marks as safe. Raises InputError where the place cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("carm_kin.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data"] = embedded
    environment.globals |= {"keys": keys, "content_of": content_of, "plotlyjs": _plotlyjs, "own": _own}
    write_atomically(out, environment.get_template(template).render(**content))


def embedded(value: Any) -> Markup:
    """JSON for the inside of a ``<script>``: no character that could end it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def content_of(figure: Figure) -> dict[str, Any]:
    """What the page's script draws a figure from."""
    return with_words_once(plotly_figure(figure))


def _plotlyjs() -> Markup:
    """The library that draws the figures."""
    from plotly.offline import get_plotlyjs

    return Markup(get_plotlyjs())


def _own(name: str) -> Markup:
    """The text of a file beside the templates."""
    return Markup((Path(__file__).parent / "templates" / name).read_text(encoding="utf-8"))
