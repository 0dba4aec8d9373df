"""Script text to tokens. Line ends mean nothing in URScript, except inside the position."""

from __future__ import annotations

import re
from typing import NamedTuple

from crtk_sim_backends.ur.urscript.errors import CompileError

KEYWORDS = frozenset(
    {"def", "thread", "sec", "end", "if", "elif", "else", "while", "return", "break", "continue"}
    | {"halt", "pass", "global", "local", "run", "kill", "join", "enter_critical", "exit_critical"}
    | {"and", "or", "xor", "not", "True", "False"}
)

_TOKEN = re.compile(
    r"""
    (?P<blank>[ \t\r\f\v]+ | \#[^\n]*)
  | (?P<newline>\n)
  | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
  | (?P<number>0[xX][0-9A-Fa-f]+ | (?:[0-9]+\.?[0-9]* | \.[0-9]+)(?:[eE][+-]?[0-9]+)?)
  | (?P<operator>[=!<>]= | [-+*/%<>=()\[\],:$.!])
  | (?P<string>"[^"]*" | '[^']*')
    """,
    re.VERBOSE,
)


class Token(NamedTuple):
    """One word of a script. ``kind`` is name, keyword, number, string, operator or end."""

    kind: str
    text: str
    line: int
    column: int


def tokenize(text: str) -> list[Token]:
    """Cut a script into tokens, the last of which is of kind ``end``.

    :raises CompileError: a character that begins no token, or a string without an end.
    """
    tokens: list[Token] = []
    line, line_start, position = 1, 0, 0
    match = _TOKEN.match
    while found := match(text, position):
        kind, start = found.lastgroup or "", position
        position = found.end()
        if kind == "newline":
            line, line_start = line + 1, position
        elif kind != "blank":
            word = found.group()
            if kind == "name" and word in KEYWORDS:
                kind = "keyword"
            tokens.append(Token(kind, word, line, start - line_start + 1))
            if kind == "string" and "\n" in word:
                line += word.count("\n")
                line_start = start + word.rindex("\n") + 1
    column = position - line_start + 1
    if position < len(text):
        raise CompileError.syntax(source_line(text, line), line, column)
    tokens.append(Token("end", "", line, column))
    return tokens


def source_line(text: str, line: int) -> str:
    """Return one line of a script as the controller quotes it in an error."""
    return text.split("\n")[line - 1].rstrip()
