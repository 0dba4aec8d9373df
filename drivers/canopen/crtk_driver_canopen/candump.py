"""A log of all frames in the format of candump, written by a thread of its own."""

from __future__ import annotations

import queue
import threading
from pathlib import Path
from typing import Self, TextIO

from crtk_driver_canopen.frames import ERROR, EXTENDED, REMOTE, Frame
from crtk_drivers.errors import ConfigError


def candump_line(frame: Frame, channel: str) -> str:
    """Return a frame as ``candump -L`` writes it: ``(seconds) can0 181#3702...``."""
    digits = 8 if frame.can_id & (EXTENDED | ERROR) else 3
    data = "R" if frame.can_id & REMOTE else frame.data.hex().upper()
    return f"({frame.time:.6f}) {channel} {frame.can_id & ~(EXTENDED | REMOTE):0{digits}X}#{data}\n"


class CandumpLog:
    """Writes frames to a file until it is closed.

    Args:
        path: is written anew when it is opened first, and gone on with after that.
        channel: name of the bus in the file.

    Attributes:
        lost: frames that could not be written in time.
    """

    def __init__(self, path: Path, channel: str = "can0") -> None:
        self.path = path
        self.lost = 0
        self._mode = "w"
        self._channel = channel.replace(" ", "_") or "can0"
        self._frames: queue.Queue[Frame | None] = queue.Queue(100_000)
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Begin.

        Raises:
            ConfigError: the file cannot be written.
        """
        try:
            file = self.path.open(self._mode, encoding="ascii")
        except OSError as error:
            raise ConfigError(
                f"the log of frames cannot be written: {error}",
                where=str(self.path),
                remedy="Give another file, or leave it out.",
            ) from error
        self._mode = "a"
        self._thread = threading.Thread(target=self._run, args=(file,), name="candump", daemon=True)
        self._thread.start()

    def put(self, frame: Frame) -> None:
        """Take a frame; never waits."""
        try:
            self._frames.put_nowait(frame)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write what is left, and close the file."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._frames.put(None)
            thread.join()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self, file: TextIO) -> None:
        with file:
            while (frame := self._frames.get()) is not None:
                file.write(candump_line(frame, self._channel))
