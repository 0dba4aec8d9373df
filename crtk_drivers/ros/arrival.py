"""When a message came, by the clock of this machine, and by how much the clock of its sender is off.

Of a topic DDS tells both times. Of a request rmw_fastrtps (8.4.3) tells twice when it was sent, and
rmw_cyclonedds not when it came: by that, goals of a client whose clock is behind would be older than the
last stop, and refused. When they came is reckoned here.
"""

from __future__ import annotations

import time
from typing import Final, NamedTuple

LONGEST_NS: Final = 10_000_000_000
"""Nanoseconds that a request waits at most: one that is later still comes from a clock that was set."""

MOST_SENDERS: Final = 64


class Arrival(NamedTuple):
    """Of one message or request.

    Attributes:
        received_ns: when it came, by the clock of this machine, since the epoch; 0 if that is not known.
        ahead_ns: by how much the sender's clock is ahead of this machine's, less what the way took. Negative:
            it is behind, or the network kept the message. 0 if that is not known.
    """

    received_ns: int
    ahead_ns: int


def of_message(received_ns: int, sent_ns: int) -> Arrival:
    """Return the arrival of a message on a topic, by what the middleware tells; 0: it does not."""
    known = received_ns and sent_ns
    return Arrival(received_ns, sent_ns - received_ns if known else 0)


class Requests:
    """The arrivals of requests of one service. For one thread."""

    def __init__(self) -> None:
        self._least: dict[bytes, int] = {}

    def arrival(self, sender: bytes, received_ns: int, sent_ns: int) -> Arrival:
        """Return the arrival of a request that is taken now.

        The one that waited least says what the clock of its sender differs by. The first of a sender counts
        as sent by a clock that agrees, unless that would have been longer ago than a request waits, or is
        still to come: what came before a stop must not be carried out after it. So the first request of a
        client whose clock is some seconds behind may be older than a stop that it came after.

        Args:
            sender: id of the client.
            received_ns, sent_ns: as the middleware tells; 0: it does not.
        """
        if received_ns not in (0, sent_ns) or not sent_ns:
            return of_message(received_ns, sent_ns)
        late = time.time_ns() - sent_ns
        least = self._least.pop(sender, None)
        is_first = least is None or late - least > LONGEST_NS
        least = late if least is None or is_first else min(least, late)
        self._least[sender] = least
        for oldest in tuple(self._least)[:-MOST_SENDERS]:
            del self._least[oldest]
        agrees = is_first and 0 <= late <= LONGEST_NS
        return Arrival(sent_ns if agrees else sent_ns + least, -least)
