"""Where output goes: results to standard output, everything about the run to standard error."""

from __future__ import annotations

from typing import IO

from rich.console import Console
from rich.markup import escape
from rich.text import Text
from typing_extensions import override

from crtk_drivers.cli.unhindered import Unhindered
from crtk_drivers.errors import CrtkError
from crtk_drivers.errors.wording import worded


class Told(Console):
    """What is told of the run. Whoever reads it may be held up, or go: who tells goes on.

    When he has gone nothing more is said; Rich would end the thread.
    """

    _unhindered: Unhindered | None = None

    @property  # type: ignore[explicit-override]  # it is not seen where there is a setter, too
    @override
    def file(self) -> IO[str]:
        """Where it goes."""
        stream = super().file
        if self._unhindered is None or self._unhindered.stream is not stream:
            if self._unhindered is not None:
                self._unhindered.close()
            self._unhindered = Unhindered(stream)
        return self._unhindered  # type: ignore[return-value]  # as far as Rich needs it

    @file.setter
    def file(self, stream: IO[str]) -> None:
        self._file = stream

    @override
    def on_broken_pipe(self) -> None:
        self.quiet = True


OUT = Console(highlight=False, emoji=False)
ERR = Told(stderr=True, highlight=False, emoji=False)


def print_error(error: CrtkError) -> None:
    """Show an error without its traceback: where, what, and on a line of its own what to do."""
    line = Text.assemble(("error: ", "bold red"))
    if error.where:
        line.append(f"{error.where}: ", style="bold")
    line.append(worded(error.message))
    ERR.print(line, soft_wrap=True)
    if error.remedy:
        ERR.print(Text.assemble(("  hint: ", "bold green"), worded(error.remedy)), soft_wrap=True)


def ask(what: str) -> None:
    """Tell whoever stands beside a device what to do with it."""
    ERR.bell()
    ERR.print(Text(f" {what} ", "bold reverse"))


def plain(text: str) -> str:
    """Return `text` so that rich takes none of it for markup."""
    return escape(text)


def sentence(text: str) -> str:
    """Return a plugin's summary, which may be written in any way, as a sentence without markup."""
    return plain(as_sentence(text))


def as_sentence(text: str) -> str:
    """Return a summary with a capital at its beginning and a full stop at its end."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
