"""What goes on in a thread of its own beside a test."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager


@contextmanager
def beside(run: Callable[[threading.Event], object]) -> Iterator[None]:
    """Let `run` go on within, until the event that it is given is set.

    Raises:
        Exception: what `run` raised, if the test itself has not failed.
    """
    over = threading.Event()
    with ThreadPoolExecutor(1, "beside a test") as pool:
        running = pool.submit(run, over)
        try:
            yield
        finally:
            over.set()
    running.result()
