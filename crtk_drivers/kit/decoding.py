"""From bytes as they arrive, cut anywhere, to messages. No I/O and no clock: bytes in, messages out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

__all__ = ["BadData", "Decoder", "FrameDecoder", "LineDecoder"]

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
