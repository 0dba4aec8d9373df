"""Fixtures: rigs of the table of faults, and how drivers are started that are to be killed."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import patch

import pytest

from bench.reliability import procedures
from rigs import victims
from rigs.fault_rigs import FaultRigs


@pytest.fixture(scope="session", autouse=True)
def warm_victims() -> Iterator[None]:
    """Fork them."""
    with patch.object(procedures, "_start", victims.start):
        yield


@pytest.fixture(scope="module")
def rigs() -> Iterator[FaultRigs]:
    """Return the rigs, of which one at a time is open."""
    opened = FaultRigs()
    yield opened
    opened.drop()
