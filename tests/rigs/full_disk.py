"""A disk that is full: no file of this process, or of one that it starts, grows beyond some bytes.

Python compiles what it imports meanwhile into files that are cut off, and does not notice: whoever reads them
later fails. So it must not.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

NO_BYTECODE: Mapping[str, str] = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
"""The environment of a process that is started with `limit`."""


def limit(size: int) -> None:
    """Limit this process for good: for `preexec_fn`."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limit this process within. From the main thread only."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    compiles, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = compiles
        signal.signal(signal.SIGXFSZ, handler)
