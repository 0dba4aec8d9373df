"""The command line: ``crtk-driver``. `main` is its entry point; see `crtk_drivers.cli.app`."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["main"]

_INTERRUPTED = 130
"""The exit code after Ctrl-C, as of any program that a signal ends."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        # Not before: it takes up to a second, in which Ctrl-C must not print where it hit.
        from crtk_drivers.cli.app import main as run

        return run(arguments)
    except KeyboardInterrupt:
        return _INTERRUPTED
