"""The command line: ``crtk-driver``. `main` is its entry point; see `crtk_drivers.cli.app`."""

from crtk_drivers.cli.app import main

__all__ = ["main"]
