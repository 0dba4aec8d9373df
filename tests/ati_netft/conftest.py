"""What all tests of the NetFT driver need."""

from collections.abc import Iterator
from unittest.mock import patch

import pytest

from crtk_driver_ati_netft import stream

LATE_STREAM = 0.6
"""Seconds, in place of a tenth of one, of silence after which a stream is asked for again."""


@pytest.fixture(scope="session", autouse=True)
def late_streams() -> Iterator[None]:
    """Have no stream count as another client's because others had the processor."""
    with patch.object(stream, "PATIENCE", LATE_STREAM):
        yield
