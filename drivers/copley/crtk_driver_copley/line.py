"""The serial line of the drives: one command at a time, and the answer that is its own.

A drive listens at 9600 bit/s after power on, reset or a break, and is raised from there. Answers do not say
to what they are. So after anything that does not fit (no answer, a damaged one, one too many) a question goes
out whose answer is known, the rate of the line, and all that comes before that answer is dropped.

Source: ASCII Programmer's Guide (16-01196), chapter 1; the break as in the vendor's and JHU's programs.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from statistics import median
from typing import Final

from crtk_driver_copley.codec import END, LONGEST, Reply, get, is_question, parse, put
from crtk_driver_copley.config import CopleyConfig
from crtk_driver_copley.tables import Parameter
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, ProtocolError
from crtk_drivers.kit import LineDecoder, MessageLink
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import Stamp

__all__ = ["Exchange", "Line", "Take"]

FIRST_BAUD: Final = 9600
BREAK: Final = 0.06
"""Seconds of a break: the vendor asks for 50 ms."""
SETTLE: Final = 0.1
"""Seconds after which both ends have a new rate (sawCopleyController)."""
QUIET: Final = 0.02
"""Seconds without a byte after which what a break has left is over."""
TRIES: Final = 3
OUTSIDE: Final = 0.01
"""Seconds that a stop from another thread waits for a write of this one."""

_REMEDY: Final = "Is the drive on, the cable a crossed one with ground, and is it this port?"

Take = Callable[[Reply | None], object]


class Exchange:
    """A command that waits for its turn, or for its answer. Without `take` it is the line's own question.

    See `Line.ask`.
    """

    __slots__ = ("answers", "once", "sent", "take", "text", "tries", "until", "wanted")

    def __init__(self, text: str, take: Take | None, *, once: bool = False) -> None:
        self.text = text
        self.take = take
        self.once = once
        self.tries = 1 if once else TRIES
        self.wanted = "v" if is_question(text) else "ok"
        self.until = 0.0
        self.sent = self.answers = 0


def _nothing(_: Reply | None) -> None:
    pass


RECENT: Final = 31
"""Answers of which it is known how long they took."""


class Line:
    """One serial line. It belongs to the I/O thread, but for `stop_aside`.

    Args:
        config: its port and rates.

    Attributes:
        echoes: lines that were the command before them.
        doubts: commands whose answer did not come, was damaged, or not alone.
        sent: when the command went out whose answer is taken: what it tells is no older.
    """

    def __init__(self, config: CopleyConfig) -> None:
        self._config = config
        self._port = SerialPort(config.port, config.baud)
        self._link = MessageLink[Reply](
            self._port,
            lambda: LineDecoder(parse, end=END, longest=LONGEST, errors="replace", strict=True),
            _REMEDY,
        )
        self._soon: deque[Exchange] = deque()
        self._waiting: deque[Exchange] = deque()
        self._asked: Exchange | None = None
        self._is_lost = False  # it cannot be told what is answered to what
        self._is_hearing = False
        self._rate_told: tuple[int, ...] = ()
        self._said_aside = threading.Event()
        self.echoes = 0
        self.doubts = 0
        self.sent = Stamp(0, 0.0)
        self._answer_times: deque[float] = deque(maxlen=RECENT)

    @property
    def answer_time(self) -> float:
        """Seconds that answers take lately, as a rule; 0.0 as long as few have come."""
        times = self._answer_times
        return median(times) if len(times) > RECENT // 2 else 0.0

    @property
    def where(self) -> str:
        """For messages."""
        return self._link.where

    @property
    def is_idle(self) -> bool:
        """Whether nothing waits for an answer."""
        return self._asked is None and not self._soon and not self._waiting

    # ------------------------------------------------------------------------------------------- open

    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        """Open the port, and let the drive have its rate.

        Args:
            deadline: monotonic seconds.
            given_up: whether to leave off.

        Raises:
            ConnectionFailed: nobody answers.
        """
        self._link.open(deadline)
        self._forget()
        while not given_up():
            if not self._port.has_own_rate:
                self._raise_rate()
            answer = self._first_answer(deadline)
            if answer is not None:
                self._rate_told = answer
                return
            if time.monotonic() > deadline:
                break
        raise ConnectionFailed("nobody answers", where=self.where, remedy=_REMEDY)

    def _raise_rate(self) -> None:
        """From whatever rate the drive has to 9600, and from there to ours; the answer comes at either."""
        port, wanted = self._port, self._config.baud
        port.set_baud(FIRST_BAUD)
        port.send_break(BREAK)
        self._link.forget(QUIET)
        if wanted != FIRST_BAUD:
            self._link.write(_line(put("", Parameter.BAUD, wanted)))
            time.sleep(SETTLE)
            port.set_baud(wanted)
            self._link.forget()

    def _first_answer(self, deadline: float) -> tuple[int, ...] | None:
        """Return the rate that the drive tells at this one; None: it tells none, or another."""
        found: list[tuple[int, ...]] = []
        question = get("", Parameter.BAUD)
        self._link.write(END + _line(question))
        until = min(deadline, time.monotonic() + self._config.reply_timeout) + self._wire_time
        while not found and time.monotonic() < until:
            found += [reply.values for reply in self._read(until) if reply.kind == "v"]
        own = self._port.has_own_rate
        return found[0] if found and (own or found[0] == (self._config.baud,)) else None

    @property
    def _wire_time(self) -> float:
        """Seconds that the longest command and its answer are on the wire."""
        return self._port.wire_time(2 * LONGEST)

    def close(self) -> None:
        """Close the port. May be called twice."""
        self._link.close()
        self._forget()

    def _forget(self) -> None:
        self._soon.clear()
        self._waiting.clear()
        self._asked, self._is_lost = None, False
        self._said_aside.clear()
        self._answer_times.clear()

    # --------------------------------------------------------------------------------------- commands

    def ask(
        self, text: str, take: Take = _nothing, *, once: bool = False, soon: bool = False
    ) -> Exchange:
        """Let a command be sent in its turn, at once if nothing is under way; return it, for `withdraw`.

        Args:
            text: of it, without its end.
            take: gets the answer, which may be an error; None: it did not come, and the command may have been
                taken or not.
            once: it must not be carried out twice. Others are sent again, and lead to a `ConnectionLost` in
                the end.
            soon: before all that is not.
        """
        exchange = Exchange(text, take, once=once)
        (self._soon if soon else self._waiting).append(exchange)
        if self._asked is None and not self._is_hearing:
            self._send_next()
        return exchange

    def ask_first(self, commands: Sequence[tuple[str, Take]]) -> None:
        """Let commands be sent before all that waits."""
        self._soon.extendleft(Exchange(text, take) for text, take in reversed(commands))
        if self._asked is None and not self._is_hearing:
            self._send_next()

    def withdraw(self, exchanges: Iterable[Exchange]) -> None:
        """Do not send what waits still; one that is under way is answered to nobody, and not sent again."""
        for exchange in exchanges:
            exchange.take, exchange.once = _nothing, True
            for waiting in (self._soon, self._waiting):
                if exchange in waiting:
                    waiting.remove(exchange)

    def distrust(self) -> None:
        """An answer told what cannot be: find out anew what is answered to what."""
        self.doubts += 1
        self._is_lost = True

    def stop_aside(self, texts: list[str]) -> None:
        """Send commands from another thread, and wait for no answers: the I/O thread does not come back."""
        self._said_aside.set()
        self._port.write_from_outside(END + b"".join(map(_line, texts)), OUTSIDE)

    def pump(self, deadline: float) -> None:
        """Send what waits and deal with answers, until all is answered or the monotonic `deadline` has come.

        Raises:
            ConnectionLost: the line is gone, or a drive does not answer.
        """
        if self._said_aside.is_set():
            self._said_aside.clear()
            self._doubt()
        while not self.is_idle:
            if self._asked is None:
                self._send_next()
            asked = self._asked
            assert asked is not None
            self._hear(min(deadline, asked.until))
            now = time.monotonic()
            if self._asked is asked and now >= asked.until:
                if asked.answers:  # one was lost, and another came
                    self._asked = None
                else:
                    self._doubt()
            if now >= deadline:
                return

    def listen(self, deadline: float) -> None:
        """Wait until the monotonic `deadline`; nobody should say anything.

        Raises:
            ConnectionLost: the line is gone.
        """
        while time.monotonic() < deadline:
            self._hear(deadline)

    def _hear(self, deadline: float) -> None:
        """Deal with what has come; nothing is sent meanwhile, for it may be one answer too many."""
        self._is_hearing = True
        try:
            for reply in self._read(deadline):
                self._heard(reply)
        finally:
            self._is_hearing = False

    def _read(self, deadline: float) -> list[Reply]:
        try:
            return self._link.read(deadline)
        except ProtocolError:  # bytes without an end
            self._link.forget()
            return [Reply("", (), "")]

    def _send_next(self) -> None:
        if self._read(0.0):
            self.distrust()
        if self._is_lost:
            self._link.forget()
            self._is_lost = False
            self._send(Exchange(get("", Parameter.BAUD), None), END)
        else:
            self._send((self._soon or self._waiting).popleft())

    def _send(self, exchange: Exchange, before: bytes = b"") -> None:
        """Send a command, after an end of whatever a drive has heard of another one."""
        self._asked = exchange
        exchange.sent += 1
        self.sent = Stamp.now()
        self._link.write(before + _line(exchange.text))
        exchange.until = time.monotonic() + self._config.reply_timeout + self._wire_time

    def _heard(self, reply: Reply) -> None:
        asked = self._asked
        if asked is None:
            self.distrust()
        elif reply.text == asked.text:
            self.echoes += 1
        elif asked.take is None:
            if reply.kind == "v" and reply.values == self._rate_told:
                asked.answers += 1
                if asked.answers == asked.sent:  # those that came late, too
                    self._asked = None
        elif reply.error and asked.tries > 1:
            self._doubt()  # it may have been damaged on its way: an error is believed when it stays
        elif reply.kind in (asked.wanted, "e"):
            self._asked = None
            if asked.sent == 1:
                self._answer_times.append(time.monotonic() - self.sent.monotonic)
            asked.take(reply)
        else:
            self._doubt()

    def _doubt(self) -> None:
        """What is under way was not answered, or not so that it can be told what was answered to what."""
        asked, self._asked = self._asked, None
        self.distrust()
        if asked is None:
            return
        asked.tries -= 1
        if asked.once and asked.take is not None:
            asked.take(None)
        elif asked.tries == 0:
            raise ConnectionLost(f"no answer to {asked.text!r}", where=self.where, remedy=_REMEDY)
        elif asked.take is not None:
            self._soon.appendleft(asked)
        else:
            self._link.forget()
            self._is_lost = False
            self._send(asked, END)


def _line(text: str) -> bytes:
    return text.encode() + END
