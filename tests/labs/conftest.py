"""Fixtures: how the processes of the bench are started."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import patch

import pytest

from crtk_drivers.labs.bench import programs
from rigs.warm_start import server

STARTED = programs._start
"""How they are started for users."""


@pytest.fixture(scope="session", autouse=True)
def warm_bench() -> Iterator[None]:
    """Fork the processes of the bench, but for tests that use `cold_bench`."""
    with patch.object(programs, "_start", server().start_program):
        yield


@pytest.fixture
def cold_bench() -> Iterator[None]:
    """Start them as users do: for tests of how that is done, and of who is whose parent."""
    with patch.object(programs, "_start", STARTED):
        yield
