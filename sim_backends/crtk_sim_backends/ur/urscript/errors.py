"""What can go wrong with a script, in the controller's words and with its position."""

from __future__ import annotations

from typing_extensions import override

_SYNTAX_ERROR = "syntax_error_on_line"


class ScriptError(Exception):
    """A script that cannot be compiled or that failed while it ran.

    ``text`` is what the controller writes into its runtime exception message; ``line`` and
    ``column`` count from 1 in the script text and are 0 as long as nobody knows them.
    """

    def __init__(self, text: str, line: int = 0, column: int = 0) -> None:
        super().__init__(text, line, column)
        self.text = text
        self.line = line
        self.column = column

    @override
    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.text}"


class CompileError(ScriptError):
    """The text is no program: it was refused before anything ran."""

    @property
    def is_syntax(self) -> bool:
        """Whether the text is not URScript at all."""
        return self.text.startswith(_SYNTAX_ERROR)

    @classmethod
    def name_not_found(cls, name: str, line: int, column: int) -> CompileError:
        """Build the error for a name that is neither a function nor a variable in reach."""
        return cls(f"compile_error_name_not_found:{name}:", line, column)

    @classmethod
    def not_simulated(cls, name: str, line: int, column: int) -> CompileError:
        """Build the error for a function of the controller that the simulated one does not have."""
        text = f"compile_error_name_not_found:{name}: (a function that is not simulated)"
        return cls(text, line, column)

    @classmethod
    def syntax(cls, source_line: str, line: int, column: int) -> CompileError:
        """Build the error for text that is not URScript; the controller quotes the line."""
        return cls(f"{_SYNTAX_ERROR}:{line}:{source_line}:", line, column)


class ScriptRuntimeError(ScriptError):
    """The program failed while it ran and must be stopped.

    A built-in raises it with a text only; the runtime adds line and column.
    """


class Halt(Exception):
    """Unwind the running thread and end the whole program (the statement ``halt``)."""
