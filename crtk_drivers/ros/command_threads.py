"""The threads that read commands: one for stops, one for all others. No executor has these subscriptions.

An executor works through what has arrived in the order of its arrival, and a client in a tight loop delays
everybody's stop by as much as it is ahead. Here DDS only counts what arrives, in an eventfd of each topic,
without Python's lock. Whoever reads a topic then takes what DDS still holds: of an absolute stream the newest
message alone. A round has a bound for each topic, and rounds have a shortest period.

Messages of one client are carried out in the order in which they came, although two threads read them: before
a command is carried out, the stops and state commands are that have come by then; and the engine refuses a
command that was sent before they came (`sent_ns` of `crtk_drivers.engine.Engine.submit`).
"""

from __future__ import annotations

import ctypes
import os
import select
import threading
import time
from collections.abc import Callable
from typing import Final

from rclpy.subscription import Subscription

from crtk_drivers.ros.received import Messages, Received
from crtk_drivers.ros.senders import Senders
from crtk_drivers.ros.unlocked import UnlockedNode, rcl_error
from crtk_drivers.status.real_time import ask_for_real_time

PERIOD: Final = 0.0005
"""Shortest time in s between two rounds: no device takes commands more often."""
MOST: Final = 50
"""Messages of one topic in one round, at most. Of absolute commands DDS holds one."""
MOST_STOPS: Final = 2000
"""Stops and state commands of one topic in one round, at most: more than DDS holds."""
REAL_TIME_PRIORITY: Final = 1
"""Below the I/O threads: who has Python's lock must not wait for a processor while they wait for the lock."""
WAIT: Final = 1.0
"""Longest time in s that a thread waits for messages."""

_BEHIND_STAMP: Final = 12
"""Where a message with a header differs no more from the same one that was sent a moment before."""

# It is in this process already: rclpy is linked with it.
_tell_of_messages = ctypes.CDLL("librcl.so").rcl_subscription_set_on_new_message_callback
_tell_of_messages.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
_COUNT: Final = ctypes.cast(ctypes.CDLL(None).eventfd_write, ctypes.c_void_p)
"""Called by DDS with an eventfd and how many messages have come; no Python is run by it."""


class HeardTopic:
    """A subscription that `CommandThreads` reads.

    Args:
        node: that the subscription was made by, before an executor has it.
        subscription: not used otherwise from now on.
        receive: called with each message; must not raise.
        senders: of the node.

    Attributes:
        arrived: file descriptor that is readable while there may be something to take.
    """

    def __init__(
        self,
        node: UnlockedNode,
        subscription: Subscription,
        receive: Callable[[Received], None],
        senders: Senders,
    ) -> None:
        self.receive = receive
        self._handle = subscription.handle
        self._topic = subscription.topic_name
        self._messages = Messages(subscription, senders)
        self.arrived = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        node.leave_to_others(subscription)
        self._call(_COUNT)

    def _call(self, function: ctypes.c_void_p | None) -> None:
        with self._handle:
            if _tell_of_messages(self._handle.pointer, function, self.arrived):
                raise RuntimeError(f"DDS does not tell of messages on {self._topic}: {rcl_error()}")

    def close(self) -> None:
        """Let DDS count no more. Once nobody takes messages."""
        self._call(None)
        os.close(self.arrived)

    def take(self, most: int) -> list[Received]:
        """Return what has come, the oldest first, so many at most."""
        os.eventfd_read(self.arrived)
        taken: list[Received] = []
        while len(taken) < most:
            message = self._messages.take()
            if message is None:
                return taken
            taken.append(message)
        os.eventfd_write(self.arrived, 1)  # there may be more
        return taken


class CommandThreads:
    """Reads the command topics of one device.

    Args:
        name: of the device.
    """

    def __init__(self, name: str) -> None:
        self._stops = _Topics()
        self._others = _Topics()
        self._turn = threading.Lock()  # who carries out stops
        self._ended = threading.Event()
        self._threads = [
            threading.Thread(
                target=self._run, args=(topics, step), name=f"{what} {name}", daemon=True
            )
            for what, topics, step in (
                ("stops", self._stops, self._carry_out_stops),
                ("commands", self._others, self._carry_out_others),
            )
        ]

    def add(self, topic: HeardTopic, *, stops: bool) -> None:
        """Read a topic too. Before `start`.

        Args:
            topic: from now on closed by `stop`.
            stops: it has stops or state commands.
        """
        (self._stops if stops else self._others).add(topic)

    def start(self) -> None:
        """Begin to carry out."""
        for thread in self._threads:
            thread.start()

    def stop(self, timeout: float) -> bool:
        """Carry out no more; False if a thread is not done after `timeout` s."""
        self._ended.set()
        for topics in (self._stops, self._others):
            topics.wake()
        end = time.monotonic() + timeout
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(max(0.0, end - time.monotonic()))
        if any(thread.is_alive() for thread in self._threads):
            return False
        self._stops.close()
        self._others.close()
        return True

    def _run(self, topics: _Topics, step: Callable[[], None]) -> None:
        ask_for_real_time(REAL_TIME_PRIORITY)
        begun = 0.0
        while topics.wait(WAIT) or not self._ended.is_set():
            if self._ended.is_set():
                return
            early = begun + PERIOD - time.monotonic()
            if early > 0.0:
                time.sleep(early)
            begun = time.monotonic()
            step()

    def _carry_out_stops(self) -> None:
        with self._turn:
            for topic, message in _without_repetitions(self._stops.take(MOST_STOPS)):
                topic.receive(message)

    def _carry_out_others(self) -> None:
        for topic, message in self._others.take(MOST):
            if self._ended.is_set():
                return
            self._carry_out_stops()
            topic.receive(message)


_Taken = tuple[HeardTopic, Received]


class _Topics:
    """The topics of one thread, and what wakes it."""

    def __init__(self) -> None:
        self._topics: dict[int, HeardTopic] = {}
        self._poll = select.epoll()
        self._awake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll.register(self._awake, select.EPOLLIN)

    def add(self, topic: HeardTopic) -> None:
        self._topics[topic.arrived] = topic
        self._poll.register(topic.arrived, select.EPOLLIN)

    def wake(self) -> None:
        """Let `wait` return from now on."""
        os.eventfd_write(self._awake, 1)

    def wait(self, timeout: float) -> bool:
        """Wait until something has come, for so many seconds; return whether it has."""
        return bool(self._poll.poll(timeout, 1))

    def take(self, most: int) -> list[_Taken]:
        """Return what has come on all of them in the order in which it came, so many of each at most."""
        ready = [self._topics[file] for file, _ in self._poll.poll(0) if file in self._topics]
        taken = [(topic, message) for topic in ready for message in topic.take(most)]
        return (
            sorted(taken, key=lambda pair: pair[1].arrival.received_ns) if len(taken) > 1 else taken
        )

    def close(self) -> None:
        """Leave them. Once the thread has ended."""
        self._poll.close()
        os.close(self._awake)
        for topic in self._topics.values():
            topic.close()


def _without_repetitions(taken: list[_Taken]) -> list[_Taken]:
    """Return what is to be carried out: of what a sender says again and again, the last."""
    said: set[tuple[int, int, bytes]] = set()
    kept = []
    for topic, message in reversed(taken):
        what = id(topic), id(message.sender), message.data[_BEHIND_STAMP:]
        if what not in said:
            said.add(what)
            kept.append((topic, message))
    return kept[::-1]
