"""Where output goes: results to standard output, everything about the run to standard error."""

from __future__ import annotations

import os

from rich.console import Console
from rich.markup import escape
from rich.text import Text

from crtk_drivers.errors import CrtkError

OUT = Console(highlight=False, emoji=False)
ERR = Console(stderr=True, highlight=False, emoji=False)


def print_error(error: CrtkError) -> None:
    """Show an error without its traceback: where, what, and on a line of its own what to do."""
    line = Text.assemble(("error: ", "bold red"))
    if error.where:
        line.append(f"{error.where}: ", style="bold")
    line.append(error.message)
    ERR.print(line, soft_wrap=True)
    if error.remedy:
        ERR.print(Text.assemble(("  hint: ", "bold green"), error.remedy), soft_wrap=True)


def ask(what: str) -> None:
    """Tell whoever stands beside a device what to do with it."""
    ERR.bell()
    ERR.print(Text(f" {what} ", "bold reverse"))


def program() -> str:
    """Return how the user started this program, as the beginning of a command to try next."""
    return "uv run crtk-driver" if "UV_RUN_RECURSION_DEPTH" in os.environ else "crtk-driver"


def plain(text: str) -> str:
    """Return `text` so that rich takes none of it for markup."""
    return escape(text)


def sentence(text: str) -> str:
    """Return a plugin's summary, which may be written in any way, as a sentence without markup."""
    return plain(as_sentence(text))


def as_sentence(text: str) -> str:
    """Return a summary with a capital at its beginning and a full stop at its end."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
