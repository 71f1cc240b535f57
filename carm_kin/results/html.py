"""A result as a table for a notebook: HTML that needs nothing else, every text in it escaped."""

from collections.abc import Sequence
from html import escape

from carm_kin.errors import printable
from carm_kin.results.summary import Row
from solvers.estimate import Note

_LEFT, _RIGHT = "text-align: left; white-space: pre", "text-align: right"


def html_table(head: str, rows: Sequence[Row], warnings: Sequence[Note], refusal: Note | None) -> str:
    """The rows with their sigmas under ``head``, then why there are none or what to be warned of."""
    lines = [f'<tr><th colspan="4" style="{_LEFT}">{_text(head)}</th></tr>', *map(_row, rows)]
    if refusal:
        lines.append(_wide(f"refused ({refusal.code}): {refusal.message}"))
    lines += [_wide(f"warning ({note.code}): {note.message}") for note in warnings]
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def _row(row: Row) -> str:
    if not row.value:
        return _wide(row.name)
    sigma = f"± {row.sigma}" if row.sigma else ""
    cells = ((row.name, _LEFT), (row.value.strip(), _RIGHT), (sigma, _RIGHT), (row.unit, _LEFT))
    return "<tr>" + "".join(f'<td style="{style}">{_text(text)}</td>' for text, style in cells) + "</tr>"


def _wide(text: str) -> str:
    return f'<tr><td colspan="4" style="text-align: left">{_text(text)}</td></tr>'


def _text(text: str) -> str:
    return escape(printable(text))
