"""Which drivers there are in a namespace: of several, the one that was there first serves commands.

Each says on ``drivers`` that it is there, as JSON in a std_msgs/String, `RATE` times a second:

    {"id": "9f0c.../1", "driver": "ur 192.168.1.10:30004", "host": "lab", "pid": 4711,
     "started": 1763700000000000000, "established": true, "there": true}

What counts is what is heard: of a process that was killed DDS keeps the endpoints for a while (Fast DDS for
20 s), but it says nothing, and a driver that starts in its place serves at once. One that has served for
`ESTABLISHED_AFTER` goes before one that has not, whatever the clocks of their machines say; otherwise the
one that started earlier. Both sides compare the same values, so that they never both wait.
"""

from __future__ import annotations

import itertools
import json
import logging
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from crtk_drivers.device import Note, Severity
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.errors.wording import printable
from crtk_drivers.ros import qos
from crtk_drivers.ros.names import AMONG_DRIVERS, ANOTHER_DRIVER
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.ros.senders import UNKNOWN_NAME
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

RATE = 2.0
"""Hz."""
GONE_AFTER = 3.0
"""Seconds without a word after which a driver is not there any more."""
ESTABLISHED_AFTER = 5.0
"""Seconds of serving after which a driver goes before any that comes later."""

STOPS = frozenset({"hold", "disable", "pause"})
"""What every driver carries out: a stop is never refused."""

_PROCESS = uuid.uuid4().hex
_numbers = itertools.count(1)

Rank = tuple[bool, int, str]
"""Who goes first: the least."""


@dataclass(frozen=True, slots=True)
class Word:
    """What a driver says of itself.

    Attributes:
        key: its own, of all drivers.
        rank: among those of its namespace.
        driver: with its address.
        pid, host: of its process.
        there: it goes on.
    """

    key: str
    rank: Rank
    driver: str
    pid: str
    host: str
    there: bool

    @property
    def name(self) -> str:
        """Return how it is called in a sentence."""
        return f"{self.driver} (process {self.pid} on {self.host})"


def read_word(text: str) -> Word | None:
    """Return what a message on ``drivers`` says; None if it is not of a driver: anybody may send one."""
    try:
        told = json.loads(text)
        key = str(told["id"])
        rank = (not told["established"], int(told["started"]), key)
        driver, pid, host = (
            printable(str(told[name]), keeping="") for name in ("driver", "pid", "host")
        )
        return Word(key, rank, driver, pid, host, bool(told["there"]))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None


@dataclass(slots=True)
class _Other:
    """Another driver, as it told of itself. `heard` is when, in monotonic seconds."""

    rank: Rank
    name: str
    heard: float


class Presence:
    """Tells others of this driver, and knows whether it serves.

    Args:
        node: of the driver.
        thread: publishes.
        engine: of the device.
        shares: serve whoever else is there.
        changed: called by the publishing thread with whether it serves, when that changes.
    """

    def __init__(
        self,
        node: Node,
        thread: PublishingThread,
        engine: Engine,
        shares: bool,
        changed: Callable[[bool], None],
    ) -> None:
        self._engine = engine
        self._namespace = node.get_namespace()
        self._shares = shares
        self._changed = changed
        self._id = f"{_PROCESS}/{next(_numbers):03}"
        self._started = time.time_ns()
        self._others: dict[str, _Other] = {}
        self._lock = threading.Lock()
        self._there = True
        self._first: _Other | None = None
        self._first_since = time.monotonic()
        self._is_mine = (self._namespace, node.get_name())
        self._node = node
        self._publisher = qos.publisher(node, String, AMONG_DRIVERS, qos.DATA)
        qos.subscription(node, String, AMONG_DRIVERS, self._receive, qos.DATA)
        self._job = thread.job(AMONG_DRIVERS, self._look, RATE)

    @property
    def serves(self) -> bool:
        """Whether this driver serves commands."""
        return self._first is None or self._shares

    def admit(self, command: str, word: str = "") -> None:
        """Let a command through, if it is for this driver. Any thread.

        Args:
            command: the CRTK name, or that of a service or input.
            word: what a state command says.

        Raises:
            CommandRefused: another driver serves; counted.
        """
        first = self._first
        if first is None or self._shares or command in STOPS or word in STOPS:
            return
        refusal = CommandRefused(
            command,
            Reason.SECOND_DRIVER,
            f"{first.name} serves {self._namespace}, and was there before this one",
            where=self._engine.where,
            remedy=_REMEDY,
            state_command=word,
        )
        self._engine.report_refusal(refusal)
        raise refusal

    def leave(self) -> None:
        """Say good-bye, with the publishing thread's last words."""
        self._there = False
        self._job.ask()

    # ----------------------------------------------------------------------------------- receiving

    def _receive(self, message: Any) -> None:
        word = read_word(message.data)
        if word is None:
            logger.debug("%s: not of a driver: %.200s", self._namespace, message.data)
            return
        if word.key == self._id:
            return
        with self._lock:
            known = word.key in self._others
            if word.there:
                self._others[word.key] = _Other(word.rank, word.name, time.monotonic())
            else:
                self._others.pop(word.key, None)
        if known is not word.there:
            self._job.ask()

    # ---------------------------------------------------------------------- in the publishing thread

    def _look(self) -> None:
        now = time.monotonic()
        with self._lock:
            for key, other in tuple(self._others.items()):
                if now - other.heard > GONE_AFTER:
                    del self._others[key]
            others = sorted(self._others.values(), key=lambda other: other.rank)
        rank = self._rank(now)
        self._tell(rank)
        served, was_first = self.serves, self._first is None
        self._first = others[0] if others and others[0].rank < rank else None
        if self._first is None and not was_first:
            self._first_since = now
        if self.serves is not served:
            self._change()
        self._note([other.name for other in others] or self._strangers())

    def _rank(self, now: float) -> Rank:
        established = self._first is None and now - self._first_since >= ESTABLISHED_AFTER
        return (not established, self._started, self._id)

    def _strangers(self) -> list[str]:
        """Return the nodes that tell an operating state here, and are no driver of this kind."""
        infos = self._node.get_publishers_info_by_topic("operating_state")
        nodes = {
            (info.node_namespace, info.node_name) for info in infos
            if info.node_name != UNKNOWN_NAME
        }  # fmt: skip
        return sorted(f"{space.rstrip('/')}/{name}" for space, name in nodes - {self._is_mine})

    def _tell(self, rank: Rank) -> None:
        late, started, key = rank
        content = {
            "id": key,
            "driver": self._engine.where,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": started,
            "established": not late,
            "there": self._there,
        }
        self._publisher.publish(String(data=json.dumps(content)))

    def _change(self) -> None:
        if self.serves:
            logger.warning(
                "%s: the driver that served %s is gone; commands are served here from now on",
                self._engine.where,
                self._namespace,
            )
        else:
            self._hold()
        self._changed(self.serves)

    def _hold(self) -> None:
        """Stop what was begun before the other driver was found."""
        if self._engine.status.state is OperatingState.ENABLED:
            with suppress(CommandRefused):  # it has just left ENABLED
                self._engine.submit("hold")

    def _note(self, others: list[str]) -> None:
        """Let diagnostics and the status line tell who else is there, and the log when that changes."""
        notes: tuple[Note, ...] = ()
        if others:
            what = "serves commands" if self.serves else "does not serve commands"
            text = f"{', '.join(others)} is in {self._namespace} too; this driver {what}"
            notes = (Note(Severity.WARNING, ANOTHER_DRIVER, text),)
            if notes != self._engine.own_notes:
                logger.warning("%s: %s. %s", self._engine.where, text, _REMEDY)
        self._engine.own_notes = notes


_REMEDY = "End one of them, or give one another --ns; node.share_namespace lets a driver serve all the same."
