"""A page of HTML in one file: no script, nothing that is loaded from elsewhere, fit to be printed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files


class Cell(str):
    """HTML as it is; any other text is escaped."""

    __slots__ = ()


def text(value: object) -> Cell:
    """Return a value as HTML."""
    return value if isinstance(value, Cell) else Cell(escape(str(value)))


def badge(word: str, kind: str) -> Cell:
    """Return a word on a colour; `kind` is good, bad, open or none."""
    return Cell(f'<span class="badge {kind}">{escape(word)}</span>')


def details(summary: object, body: str, *, is_open: bool = False) -> Cell:
    """Return what is unfolded by a click, and when it is printed as it stands."""
    opened = " open" if is_open else ""
    return Cell(f"<details{opened}><summary>{text(summary)}</summary>{body}</details>")


def table(
    headings: Sequence[str], rows: Iterable[Sequence[object]], right: Sequence[int] = ()
) -> Cell:
    """Return a table.

    Args:
        headings: of the columns.
        rows: their cells.
        right: indices of the columns with figures.
    """

    def line(cells: Sequence[object], tag: str) -> str:
        told = []
        for index, cell in enumerate(cells):
            begin = f'{tag} class="r"' if index in right else tag
            told.append(f"<{begin}>{text(cell)}</{tag}>")
        return f"<tr>{''.join(told)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    head = line(headings, "th")
    return Cell(
        f'<div class="scroll"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'
    )


def page(title: str, body: str) -> str:
    """Return the whole document."""
    style = files("crtk_drivers.labs.verdicts").joinpath("report.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>\n{style}</style></head>\n<body>{body}</body></html>\n"
    )
