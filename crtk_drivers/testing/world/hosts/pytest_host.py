"""Runs tests in worlds, as `pytest_worlds` asks for them.

``python -m crtk_drivers.testing.world.hosts.pytest_host JSON``: JSON has the arguments of pytest, and
modules that are imported first. A forked child collects one file, begins a world, and runs tests of the file
in it, one after the other.
"""

from __future__ import annotations

import importlib
import json
from contextlib import suppress

from crtk_drivers.testing.world.hosts import forking
from crtk_drivers.testing.world.machine.kernel import NotSimulated


def main() -> None:
    """Answer requests until whoever asks has gone."""
    requests, (text,) = forking.begin()
    given = json.loads(text)
    for name in given["preload"]:
        with suppress(ImportError, NotSimulated):  # a test that needs it says so
            importlib.import_module(name)

    import pytest

    from crtk_drivers.testing.world.hosts.pytest_inside import Inside

    pytest.main(given["arguments"], plugins=[Inside(requests)])


if __name__ == "__main__":
    main()
