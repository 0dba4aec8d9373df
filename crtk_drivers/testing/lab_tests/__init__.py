"""A lab's own tests: pytest over the devices of a lab file, judged and kept as the bench does.

This is the entry point (``pytest11``), which every pytest of the environment imports: nothing of the rest is
imported, and no fixture is there, until a lab file is given.
"""

from __future__ import annotations

from collections.abc import Generator

import pytest

FILE = "crtk_lab_file"
"""Where the option is kept."""

_METAVAR = {"metavar": "FILE", "dest": FILE, "default": None}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("crtk-lab", "a lab's own tests (crtk-drivers)")
    group.addoption(
        "--lab-file", help="Test the devices of this lab file; --lab for short.", **_METAVAR
    )
    group.addoption("--lab-sim", action="store_true", help="Simulate all of them.")
    group.addoption(
        "--lab-machine",
        metavar="NAME",
        default="",
        help="Test the devices of this machine of the lab; all: of all. Default: by host name.",
    )
    group.addoption(
        "--may-move",
        action="store_true",
        help="Real devices may be enabled and moved, within their `space`. Stand beside them.",
    )
    group.addoption(
        "--lab-out",
        metavar="DIR",
        help="For the results; default: runs/TIME-NAME, as of the bench.",
    )
    group.addoption(
        "--inconclusive-ok",
        action="store_true",
        help="End with 0 though something of the lab is not decided.",
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_load_initial_conftests(parser: pytest.Parser) -> Generator[None]:
    """Add ``--lab``, unless a conftest.py of the user's has it for something else."""
    yield
    _, unknown = parser.parse_known_and_unknown_args(["--lab=x"])
    if unknown:
        group = parser.getgroup("crtk-lab")
        group.addoption("--lab", help="The same as --lab-file.", **_METAVAR)


def pytest_configure(config: pytest.Config) -> None:
    """Begin, if there is a lab."""
    config.addinivalue_line(
        "markers", "needs(name, ...): devices or features of the lab without which it is skipped"
    )
    if config.getoption(FILE):
        from crtk_drivers.testing.lab_tests import hooks, lab_fixtures

        config.pluginmanager.register(hooks.begun(config), "crtk-lab")
        config.pluginmanager.register(lab_fixtures, "crtk-lab-fixtures")
