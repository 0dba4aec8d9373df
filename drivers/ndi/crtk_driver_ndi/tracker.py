"""The conversation with a tracker: prepared when it is connected, asked for frames or whether it is alive.

One question at a time. What a procedure wants to know (to start, to stop, to beep) goes before the others. It
belongs to the I/O thread, and what it tells may be read from any.
"""

from __future__ import annotations

import logging
import math
import re
import time
from collections.abc import Generator, Mapping
from typing import Final

from crtk_driver_ndi.codec import Reply, error_text
from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.frames import ToolSeen
from crtk_driver_ndi.link import QUIET, NdiLink, Refused, patience_for
from crtk_driver_ndi.setup import Prepared, free, handles_of, prepare
from crtk_driver_ndi.stream import FrameStream
from crtk_drivers.device import Condition
from crtk_drivers.errors import (
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    ProtocolError,
    TransitionFailed,
)
from crtk_drivers.state import OperatingState

__all__ = ["WRONG_MODE", "Tracker"]

logger = logging.getLogger(__name__)

ALIVE: Final = 0.1
"""Seconds between two questions while nothing is tracked."""
REPLY: Final = 0.4
"""Seconds after which an answer that did not come is asked for again."""
FAREWELL: Final = 1.0
"""Seconds in which tracking is stopped and all tools are freed, or not, when it is closed."""
MOST_DAMAGED: Final = 5
"""Damaged replies one after the other that are no accident any more."""
SURPLUS: Final = 20
"""Replies that are dropped before a question at most."""
WRONG_MODE: Final = 0x0C
_RESET: Final = frozenset({0x0E, 0x10})
"""Errors of what was initialised and is not any more."""

_HANDLES: Final = "PHSR:00"
_FRAME: Final = "frame"
_REQUEST: Final = "request"
_MARK: Final = "APIREV:"
"""Asked after a reply was missed: what comes before its answer answers an older question. Nothing else is
answered in this way."""
_MARK_ANSWER: Final = re.compile(r"\w\.\d")
_UNKNOWN_COMMAND: Final = 0x01
"""How a tracker answers `_MARK` that is too old to know it."""


class Tracker:
    """One tracker.

    Args:
        config: of it and its tools.

    Attributes:
        config: as given.
        prepared: what was found when it was connected; None while it is not.
        stream: its frames; None while it does not track.
        alive: monotonic seconds at which it answered last.
        condition: what it allows.
    """

    def __init__(self, config: NdiConfig) -> None:
        self.config = config
        self.prepared: Prepared | None = None
        self.stream: FrameStream | None = None
        self.alive = 0.0
        self.condition = Condition()
        self._link = NdiLink(config)
        self._taken: set[int] = set()
        """Handles to be freed."""
        self._asked = ""
        self._asked_at = 0.0
        self._request = ""
        self._answer: Reply | None = None
        self._damaged = self._surplus = 0
        self._doubts = 0
        """Questions before which a reply that was missed may still come, or that to the one after it."""
        self._missed = False
        """Whether a reply was missed, and no answer to `_MARK` has come since."""
        self._known: frozenset[int] = frozenset()

    @property
    def address(self) -> str:
        """Where it is."""
        config = self.config
        return f"{config.host}:{config.tcp_port}" if config.transport == "tcp" else config.port

    @property
    def counters(self) -> Mapping[str, float]:
        """For diagnostics."""
        stream = self.stream
        own = {
            "damaged_replies": float(self._link.damaged),
            "surplus_replies": float(self._surplus),
        }
        return own if stream is None else {**own, **stream.counters}

    def seen(self, place: int) -> ToolSeen | None:
        """Return what the newest frame says of the tool at a place of the configuration."""
        prepared, stream = self.prepared, self.stream
        if prepared is None or stream is None or stream.newest is None:
            return None
        handle = prepared.handles.get(place)
        return None if handle is None else stream.newest.tools.get(handle)

    # ----------------------------------------------------------------------------------- life cycle

    def open(self, deadline: float) -> None:
        """Connect, and initialise it and its tools.

        Raises:
            ConnectionFailed, ConfigError: it, or a tool, cannot be used.
        """
        self.close()
        try:
            self._link.open(deadline)
            prepared = prepare(self._link, self.config, self.config.tools, deadline, self._taken)
            known = handles_of(self._link.ask(_HANDLES, deadline).text)
            self._require_in_step(deadline)
        except (Refused, ConnectionLost, ProtocolError, ValueError) as error:
            self._give_up(deadline)
            what, remedy = f"{error}", ""
            if isinstance(error, DeviceError):
                what, remedy = error.message, error.remedy
            raise ConnectionFailed(what, where=self._link.where, remedy=remedy) from error
        except BaseException:
            self._give_up(deadline)
            raise
        self._known = frozenset(known)
        self._damaged, self._doubts, self._asked, self._request = 0, 0, "", ""
        self._missed = False
        self.condition = Condition()
        self.prepared = prepared
        self._link.is_ready = True

    def abort(self) -> None:
        """Let an `open` that waits fail soon; from any thread."""
        self._link.abort()

    def close(self) -> None:
        """Stop tracking and free the tools, as far as it can be told, and disconnect. May be called twice.

        A handle that stays initialised makes PINIT of the next program fail (ERROR13).
        """
        self._leave(time.monotonic() + FAREWELL)

    def _give_up(self, deadline: float) -> None:
        """Leave a tracker that cannot be used; one that may not be asked now is left by `close`."""
        if not (self._taken and self._link.is_given_up):
            self._leave(min(deadline, time.monotonic() + FAREWELL))

    def _leave(self, deadline: float) -> None:
        was_prepared = self.prepared is not None
        taken, self._taken = self._taken, set()
        self.prepared = self.stream = None
        if taken or was_prepared:
            self._link.is_ready = True  # it is to answer still
            try:
                if self._stop(deadline):
                    free(self._link, taken, deadline)
            except DeviceError as error:  # TSTOP was sent, if there is a link
                logger.debug("%s: it is not left in order: %s", self.address, error)
        self._link.close()

    def _stop(self, deadline: float) -> bool:
        """Send TSTOP, and once more where nothing sound answers it; return whether anything did at last.

        Replies to questions before it are left out.

        Raises:
            ConnectionLost: the link is gone.
        """
        for _ in range(2):
            self._link.send("TSTOP:")
            until = min(deadline, time.monotonic() + REPLY)
            try:
                while (reply := self._link.receive(until)) is not None:
                    if reply.error is not None or reply.text.startswith("OKAY"):
                        return True
            except ProtocolError as error:
                logger.debug("%s: %s; it is sent again", self.address, error)
        return False

    def _require_in_step(self, deadline: float) -> None:
        """See that no reply was doubled: all later ones would answer the question before.

        Raises:
            ConnectionLost, ConnectionFailed: the link is gone, or no answer comes.
            ProtocolError: the answer is to another question.
        """
        try:
            reply = self._link.ask(_MARK, deadline)
            in_step = _is_mark_answer(reply)
        except Refused as refusal:
            in_step = refusal.code == _UNKNOWN_COMMAND
        if not in_step:
            raise ProtocolError("replies are answers to other questions", where=self.address)

    # ------------------------------------------------------------------------------------- its frames

    def read(self, deadline: float) -> bool:
        """Ask and listen until there is a new frame, or a sign of life; return whether there was one.

        Raises:
            ConnectionLost: the link is gone, or the tracker was reset.
        """
        while True:
            wait = min(deadline, self._due()) - time.monotonic()
            if not self._asked and wait > 0.0:  # poll would be late by up to a millisecond
                time.sleep(wait)
            try:
                self._ask_next()
                reply = self._link.receive(min(deadline, self._patience()))
            except ProtocolError as error:
                self._take_damage(error)
                continue
            now = time.monotonic()
            if reply is not None:
                if self._take(reply, now):
                    return True
            elif self._asked not in ("", _REQUEST) and now > self._asked_at + REPLY:
                self._link.forget()
                self._asked, self._doubts, self._missed = "", 2, True
            if now >= deadline:
                if self._asked == _REQUEST:  # which has a bound of its own
                    self.alive = now
                return self._asked == _REQUEST

    def asking(self, text: str) -> Generator[None, None, Reply]:
        """Let `read` carry out one command, as a part of a procedure, and return its reply.

        Raises:
            TransitionFailed: none came in time.
        """
        deadline = time.monotonic() + patience_for(text)
        try:
            while self._asked == _REQUEST:  # of a procedure that was given up
                yield from self._bounded(text, deadline)
            self._take_answer()
            self._request = text
            while (answer := self._take_answer()) is None:
                yield from self._bounded(text, deadline)
            return answer
        finally:
            self._request = ""

    def _take_answer(self) -> Reply | None:
        answer, self._answer = self._answer, None
        return answer

    def _bounded(self, text: str, deadline: float) -> Generator[None, None, None]:
        if time.monotonic() > deadline:
            self._asked, self._missed = "", True
            raise TransitionFailed(
                f"no answer to {text}", where=self.address, remedy="Look at the tracker's lights."
            )
        yield

    # ----------------------------------------------------------------------------------------- inside

    def _due(self) -> float:
        """Return when the next question is to be asked, in monotonic seconds."""
        if self._request:
            return 0.0
        return self.stream.due if self.stream is not None else self.alive + ALIVE

    def _ask_next(self) -> None:
        """Send what is to be asked now, if no answer is waited for."""
        now = time.monotonic()
        if self._asked or now < self._due():
            return
        self._drop_surplus()
        if self._request:
            self._asked, text = _REQUEST, self._request
        elif self._missed:
            self._asked = text = _MARK
        elif self.stream is not None:
            self._asked, text = _FRAME, self.stream.question
        else:
            self._asked = text = _HANDLES
        self._asked_at = time.monotonic()
        self._link.send(text)

    def _drop_surplus(self) -> None:
        """Leave out what has come before a question: it is the late reply to an earlier one."""
        quiet = QUIET if self._doubts else 0.0
        self._doubts = max(0, self._doubts - 1)
        for _ in range(SURPLUS):
            reply = self._link.receive(time.monotonic() + quiet)
            if reply is None:
                return
            self._check_reset(reply)
            self._surplus += 1

    def _check_reset(self, reply: Reply, asked: str = _REQUEST) -> None:
        if reply.is_reset or (reply.error in _RESET and asked != _REQUEST):
            raise ConnectionLost(
                "the tracker was reset: its tools are not initialised any more",
                where=self.address,
                remedy="The driver initialises it again; enable it then.",
            )

    def _patience(self) -> float:
        """Return until when an answer is waited for."""
        if not self._asked:
            return 0.0
        return math.inf if self._asked == _REQUEST else self._asked_at + REPLY

    def _take_damage(self, error: ProtocolError) -> None:
        self._damaged += 1
        self._asked = ""  # it is asked again
        if self._damaged >= MOST_DAMAGED:
            raise ConnectionLost(
                f"{self._damaged} damaged replies one after the other: {error.message}",
                where=self.address,
                remedy="Check the cable; a serial line that lost its rate is found again.",
            ) from error

    def _take(self, reply: Reply, now: float) -> bool:
        """Take a reply; return whether it is what was waited for."""
        asked = self._asked
        self._check_reset(reply, asked)
        is_late = asked in (_MARK, _FRAME) and _is_mark_answer(reply) != (asked == _MARK)
        if is_late:
            self._surplus += 1
            return False
        self._asked = ""
        try:
            is_new = self._understand(asked, reply, now)
        except ValueError as error:
            self._take_damage(ProtocolError(f"{error}", where=self.address))
            return False
        self._damaged = 0
        self.alive = now
        return is_new

    def _understand(self, asked: str, reply: Reply, now: float) -> bool:
        if asked == _REQUEST:
            self._request, self._answer = "", reply
        elif asked == _MARK:
            self._missed = False
            return self.stream is None  # no new frame
        elif reply.error is not None:
            self._stopped(reply.error)
        elif reply.warning is not None:
            logger.warning("%s: %s was answered with a %s", self.address, asked, reply.text)
        elif asked == _HANDLES:
            self._check_handles(frozenset(handles_of(reply.text)))
        elif asked == _FRAME and self.stream is not None:
            return self.stream.take(reply, self._asked_at, now)
        return True

    def _stopped(self, code: int) -> None:
        """It does not track any more, though nobody here has told it to."""
        if self.stream is None:
            return
        self.stream = None
        if code == WRONG_MODE:
            why = "it does not track any more: is there another client, which stopped it?"
            self.condition = Condition(OperatingState.DISABLED, why)
        else:
            self.condition = Condition(OperatingState.FAULT, error_text(code))

    def _check_handles(self, found: frozenset[int]) -> None:
        if found != self._known:
            raise ConnectionLost(
                "its port handles are others: a tool was plugged in or out, or another client uses it",
                where=self.address,
                remedy="The driver initialises the tools again.",
            )


def _is_mark_answer(reply: Reply) -> bool:
    if reply.error is not None:
        return reply.error == _UNKNOWN_COMMAND
    return not reply.body and _MARK_ANSWER.match(reply.text) is not None
