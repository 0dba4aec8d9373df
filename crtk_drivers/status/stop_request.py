"""The request to end, which a signal handler may make."""

from __future__ import annotations


class StopRequest:
    """Set once, looked at again and again. It takes no lock, as `threading.Event` does.

    A signal handler interrupts the main thread anywhere, also where that holds the lock of an event, or in
    another handler that does: it would wait for itself for ever.
    """

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Set it; from anywhere."""
        self._is_set = True

    def is_set(self) -> bool:
        """Whether it was set."""
        return self._is_set
