"""From bytes as they arrive, cut anywhere, to messages. No I/O and no clock: bytes in, messages out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Generic, Protocol, TypeVar, runtime_checkable

__all__ = [
    "BadData",
    "Damage",
    "Decoder",
    "FrameDecoder",
    "LineDecoder",
    "SeekingDecoder",
    "Tolerant",
]

Message = TypeVar("Message")

_SHOWN: Final = 40
"""Bytes of a damaged record that are shown to people."""


class BadData(ValueError):
    """Bytes that the protocol does not allow. What follows them cannot be told apart any more."""


class Damage:
    """What a decoder has left out, since it was made.

    Attributes:
        total: damaged records.
        in_a_row: those since the last sound one.
        last: what the last one was, for messages.
    """

    def __init__(self) -> None:
        self.total = self.in_a_row = 0
        self.last = ""

    def left_out(self, what: str) -> None:
        """Count a damaged record."""
        self.total += 1
        self.in_a_row += 1
        self.last = what

    def sound(self) -> None:
        """Note that a sound record has come."""
        self.in_a_row = 0


class Decoder(Protocol[Message]):
    """The shape of a decoder. A new connection begins with a new one."""

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first.

        Raises:
            BadData: they are none; the connection is of no use any more.
        """


@runtime_checkable
class Tolerant(Protocol):
    """A decoder that leaves damaged records out, and counts them."""

    damage: Damage


class LineDecoder(Generic[Message]):
    """Messages that are lines of text. A line that is none is left out; the next one counts again.

    The first line of a connection may be the end of one that began before: if it is none, it is not counted.
    Where half a line may be a whole one (numbers alone), give lines of a stream a head or a checksum.

    Args:
        parse: returns the message of a line, without its end; raises ValueError if it is damaged, and
            BadData if nothing that follows can be right either.
        end: of a line.
        longest: bytes; more without an end are damaged.
        encoding: of the text.
        errors: what becomes of bytes that it does not have: "strict" refuses them, "replace" marks them.
        strict: take a damaged line for BadData: for who asks, and had better ask again at once.

    Attributes:
        damage: what was left out.
    """

    def __init__(
        self,
        parse: Callable[[str], Message],
        *,
        end: bytes = b"\n",
        longest: int = 200,
        encoding: str = "ascii",
        errors: str = "strict",
        strict: bool = False,
    ) -> None:
        self._strict = strict
        self.damage = Damage()
        self._parse = parse
        self._end = end
        self._longest = longest
        self._encoding = encoding
        self._errors = errors
        self._rest = b""
        self._has_begun = False
        self._is_too_long = False

    def feed(self, data: bytes) -> list[Message]:
        """See `Decoder`."""
        self._rest += data
        if not self._has_begun:
            self._leave_out_half_an_end()
        *lines, self._rest = self._rest.split(self._end)
        found: list[Message] = []
        for line in lines:
            self._take(line, found)
        if len(self._rest) > self._longest:
            for _ in range(len(self._rest) // (self._longest + 1)):  # as often as cut smaller
                self._leave_out(self._unended(self._rest))
            keep = len(self._end) - 1  # the beginning of an end may have come
            self._rest = self._rest[len(self._rest) - keep :]
            self._is_too_long = self._has_begun = True
        return found

    def _leave_out_half_an_end(self) -> None:
        for cut in range(1, len(self._end)):
            if self._rest.startswith(self._end[cut:]):
                self._rest = self._rest[len(self._end) - cut :]
                self._has_begun = True
                return

    def _take(self, line: bytes, found: list[Message]) -> None:
        if self._is_too_long:  # its end, which is counted already
            self._is_too_long = False
            return
        is_first, self._has_begun = not self._has_begun, True
        if len(line) > self._longest:
            self._leave_out(self._unended(line))
            return
        try:
            message = self._parse(line.decode(self._encoding, self._errors))
        except BadData:
            raise
        except ValueError:
            if not is_first or self._strict:
                self._leave_out(repr(line[:_SHOWN]))
            return
        self.damage.sound()
        found.append(message)

    @staticmethod
    def _unended(data: bytes) -> str:
        return f"{len(data)} bytes without an end of line"

    def _leave_out(self, what: str) -> None:
        if self._strict:
            raise BadData(what)
        self.damage.left_out(what)


class FrameDecoder(Generic[Message]):
    """Messages that are frames, which say how long they are. A frame that is damaged is left out.

    Args:
        size: returns how many bytes the frame at the start of a buffer has, 0 while that cannot be told;
            raises BadData if there is none.
        parse: returns the message of a whole frame; raises ValueError if it is damaged.
        strict: take a damaged frame for BadData: for who asks, and had better ask again at once.

    Attributes:
        damage: what was left out.
    """

    def __init__(
        self,
        size: Callable[[bytes], int],
        parse: Callable[[bytes], Message],
        *,
        strict: bool = False,
    ) -> None:
        self.damage = Damage()
        self._size = size
        self._parse = parse
        self._strict = strict
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
                what = f"{frame[:_SHOWN].hex(' ')}: {error}"
                if self._strict:
                    raise BadData(what) from error
                self.damage.left_out(what)
            else:
                self.damage.sound()
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
        damage: frames that began as one and were none.
    """

    def __init__(
        self, head: bytes, size: Callable[[bytes], int], parse: Callable[[bytes], Message]
    ) -> None:
        self.corrupt = self.strange = 0
        self.damage = Damage()
        self._head = head
        self._size = size
        self._parse = parse
        self._rest = b""
        self._left_out = 0
        self._in_step = False
        self._told = 0
        """Bytes of what has come that belong to a damaged frame which is counted already."""

    @property
    def pending(self) -> int:
        """How many bytes have come of a frame that is not whole yet."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes, oldest first."""
        self._rest += data
        found: list[Message] = []
        while len(self._rest) >= len(self._head):
            if not self._rest.startswith(self._head):
                self._leave_out()
                continue
            size = len(self._head)
            try:
                size = self._size(self._rest)
                if not 0 < size <= len(self._rest):
                    break
                message = self._parse(self._rest[:size])
            except ValueError:
                self._damaged(size)
                self._leave_out()
                continue
            self._rest, self._told = self._rest[size:], 0
            self.corrupt += bool(self._left_out) and self._in_step
            self._left_out, self._in_step = 0, True
            self.damage.sound()
            found.append(message)
        return found

    def _damaged(self, size: int) -> None:
        """Count a damaged frame, but not the heads that are found in it when it is searched for the next."""
        if not self._told:
            if self._in_step:
                self.damage.left_out(self._rest[:_SHOWN].hex(" "))
            self._told = size

    def _leave_out(self) -> None:
        """Go on to where the next frame may begin."""
        at = self._rest.find(self._head, 1)
        if at < 0:
            cut = range(len(self._head) - 1, 0, -1)
            at = len(self._rest) - next(
                (size for size in cut if self._rest.endswith(self._head[:size])), 0
            )
        self._rest = self._rest[at:]
        self._told = max(0, self._told - at)
        self._left_out += at
        self.strange += at
