"""Fixtures: how drivers are started that are to be killed."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import patch

import pytest

from bench.reliability import procedures
from rigs import victims


@pytest.fixture(scope="session", autouse=True)
def warm_victims() -> Iterator[None]:
    """Fork them."""
    with patch.object(procedures, "_start", victims.start):
        yield
