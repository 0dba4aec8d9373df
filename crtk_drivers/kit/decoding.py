"""From bytes as they arrive, cut anywhere, to messages. No I/O and no clock: bytes in, messages out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

__all__ = ["BadData", "Decoder", "FrameDecoder", "LineDecoder", "SeekingDecoder"]

Message = TypeVar("Message")


class BadData(ValueError):
    """Bytes that the protocol does not allow. What follows them cannot be told apart any more."""


class Decoder(Protocol[Message]):
    """The shape of a decoder. A new connection begins with a new one."""

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first.

        Raises:
            BadData: they are none; the connection is of no use any more.
        """


class LineDecoder(Generic[Message]):
    """Messages that are lines of text.

    Args:
        parse: returns the message of a line, without its end; raises ValueError if it is none.
        end: of a line.
        longest: bytes; more without an end is not this protocol.
        encoding: of the text.
        errors: what becomes of bytes that it does not have: "strict" refuses them, "replace" marks them.
    """

    def __init__(
        self,
        parse: Callable[[str], Message],
        *,
        end: bytes = b"\n",
        longest: int = 200,
        encoding: str = "ascii",
        errors: str = "strict",
    ) -> None:
        self._parse = parse
        self._end = end
        self._longest = longest
        self._encoding = encoding
        self._errors = errors
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """See `Decoder`; the error has the line."""
        *lines, self._rest = (self._rest + data).split(self._end)
        if len(self._rest) > self._longest:
            raise BadData(f"{len(self._rest)} bytes without an end of line")
        return [self._message(line) for line in lines]

    def _message(self, line: bytes) -> Message:
        try:
            return self._parse(line.decode(self._encoding, self._errors))
        except ValueError as error:
            raise BadData(repr(line)) from error


class FrameDecoder(Generic[Message]):
    """Messages that are frames, which say how long they are.

    Args:
        size: returns how many bytes the frame at the start of a buffer has, 0 while that cannot be told;
            raises BadData if there is none.
        parse: returns the message of a whole frame; raises ValueError if it is none.
    """

    def __init__(self, size: Callable[[bytes], int], parse: Callable[[bytes], Message]) -> None:
        self._size = size
        self._parse = parse
        self._rest = b""

    def feed(self, data: bytes) -> list[Message]:
        """See `Decoder`."""
        self._rest += data
        found: list[Message] = []
        while 0 < (size := self._size(self._rest)) <= len(self._rest):
            frame, self._rest = self._rest[:size], self._rest[size:]
            try:
                found.append(self._parse(frame))
            except BadData:
                raise
            except ValueError as error:
                raise BadData(f"{frame[:40].hex(' ')}: {error}") from error
        return found


class SeekingDecoder(Generic[Message]):
    """Frames out of a stream that may begin anywhere and may be damaged anywhere: what is none is left out.

    Args:
        head: bytes with which every frame begins.
        size: returns how many bytes the frame at the start of a buffer has, 0 while that cannot be told;
            raises ValueError if there is none.
        parse: returns the message of a whole frame; raises ValueError if it is none.

    Attributes:
        corrupt: how many times bytes were left out between two frames that were sound.
        strange: how many bytes were left out.
    """

    def __init__(
        self, head: bytes, size: Callable[[bytes], int], parse: Callable[[bytes], Message]
    ) -> None:
        self.corrupt = self.strange = 0
        self._head = head
        self._size = size
        self._parse = parse
        self._rest = b""
        self._left_out = 0
        self._in_step = False

    @property
    def pending(self) -> int:
        """How many bytes have come of a frame that is not whole yet."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first."""
        self._rest += data
        found: list[Message] = []
        while len(self._rest) >= len(self._head):
            try:
                if not self._rest.startswith(self._head):
                    raise ValueError("no frame begins here")
                size = self._size(self._rest)
                if not 0 < size <= len(self._rest):
                    break
                message = self._parse(self._rest[:size])
            except ValueError:
                self._leave_out()
                continue
            self._rest = self._rest[size:]
            self.corrupt += bool(self._left_out) and self._in_step
            self._left_out, self._in_step = 0, True
            found.append(message)
        return found

    def _leave_out(self) -> None:
        """Go on to where the next frame may begin."""
        at = self._rest.find(self._head, 1)
        if at < 0:
            cut = range(len(self._head) - 1, 0, -1)
            at = len(self._rest) - next(
                (size for size in cut if self._rest.endswith(self._head[:size])), 0
            )
        self._rest = self._rest[at:]
        self._left_out += at
        self.strange += at
