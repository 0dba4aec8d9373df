"""Files that programs write from what the code says, and that tests compare with it."""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Iterable, Mapping
from pathlib import Path

from crtk_drivers.errors.wording import current_wording


def writer_parser(module: str, description: str) -> ArgumentParser:
    """Return the parser of a program that writes files, with its option ``--check``."""
    parser = ArgumentParser(prog=f"python -m {module}", description=description)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if out of date")
    return parser


def write_or_check(
    texts: Mapping[Path, str], *, only_check: bool, module: str, given: Iterable[object] = ()
) -> int:
    """Write the files that do not hold their texts, or only check them, and say which these are.

    Args:
        texts: what each file is to hold.
        only_check: write nothing.
        module: the program, as ``python -m`` takes it.
        given: the arguments with which the program writes these files.

    Returns:
        The exit code: 1 if a file is out of date, and was not written.
    """
    stale = [
        path
        for path, text in texts.items()
        if not path.is_file() or path.read_text(encoding="utf-8") != text
    ]
    if only_check:
        if stale:
            again = " ".join(map(str, (f"{current_wording().run}python -m {module}", *given)))
            sys.stderr.write(f"out of date: {' '.join(map(_shown, stale))}\nrun: {again}\n")
        return int(bool(stale))
    for path, text in texts.items():
        if path in stale:
            path.write_text(text, encoding="utf-8")
            sys.stdout.write(f"wrote {_shown(path)}\n")
        else:
            sys.stdout.write(f"{_shown(path)} is up to date\n")
    return 0


def _shown(path: Path) -> str:
    """Return a path from the working directory on if it is below that, else the whole one."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
