"""The command line: ``crtk-driver``. `main` is its entry point; see `crtk_drivers.cli.app`."""

from __future__ import annotations

from collections.abc import Sequence

from crtk_drivers.cli.unhindered import open_missing_streams
from crtk_drivers.status.stop_request import INTERRUPTED, left_at_interrupt

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    open_missing_streams()
    try:
        with left_at_interrupt():  # until a command runs
            from crtk_drivers.cli.app import main as run

            return run(arguments)
    except KeyboardInterrupt:
        return INTERRUPTED
