"""A serial line through the relay: the driver's end is a pseudo terminal, the other the device's port."""

from __future__ import annotations

import contextlib
import os
import selectors
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from crtk_drivers.errors import ConnectionLost
from crtk_drivers.kit.serial_port import SerialPort

CHUNK: Final = 4096


class SerialLine:
    """One line. What does not pass is lost, as on a wire that is cut.

    Args:
        port: of the device.
        baud: of both ends, in bit/s.
        name: where the driver's end is found; it stays when that is closed and opened.
        selector: tells what can be read, and has a callable of its events for each.
        passes: whether what goes to the device (True), or comes from it, passes now.

    Raises:
        ConnectionFailed: the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        name: Path,
        selector: selectors.BaseSelector,
        passes: Callable[[bool], bool],
    ) -> None:
        self._name = name
        self._device = SerialPort(port, baud)
        self._selector = selector
        self._passes = passes
        self._ends: tuple[int, ...] = ()
        self.open()

    def open(self) -> None:
        """Open both ends, unless they are.

        Raises:
            ConnectionFailed: the port cannot be opened.
        """
        if self._ends:
            return
        self._device.open()
        ours, theirs = os.openpty()
        self._ends = (ours, theirs)  # theirs stays open: a driver that comes back finds the line up
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        unseen = self._name.with_suffix(".new")
        unseen.symlink_to(os.ttyname(theirs))
        unseen.replace(self._name)
        self._selector.register(ours, selectors.EVENT_READ, self._from_driver)
        self._selector.register(self._device, selectors.EVENT_READ, self._from_device)

    def close(self) -> None:
        """Hang up, as an adapter that is pulled out. May be called twice."""
        if not self._ends:
            return
        self._selector.unregister(self._ends[0])
        self._selector.unregister(self._device)
        self._name.unlink(missing_ok=True)
        for end in self._ends:
            os.close(end)
        self._ends = ()
        self._device.close()

    def _from_driver(self, _: int) -> None:
        data = os.read(self._ends[0], CHUNK)
        if self._passes(True):
            with self._hanging_up():
                self._device.write(data)

    def _from_device(self, _: int) -> None:
        with self._hanging_up():
            data = self._device.drain()
            if self._passes(False):
                with contextlib.suppress(BlockingIOError):  # nobody reads it: lost, as on a wire
                    os.write(self._ends[0], data)

    @contextlib.contextmanager
    def _hanging_up(self) -> Iterator[None]:
        try:
            yield
        except ConnectionLost:
            self.close()
