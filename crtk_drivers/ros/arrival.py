"""When a message or a request came, when it was sent, and by how much the clock of its sender is off.

What the network loses DDS sends again, with the next message or seconds later. What arrives while this
process stands still is read afterwards. So a command may come long after it was sent, and after a stop that
somebody sent later. The stamp of its sending is of another clock. The driver learns how far that clock is off
from the messages that came quickest.

Of a message on a topic DDS tells when it was sent and when it came. Of a request it does not tell when it
came: rmw_fastrtps (8.4.3) gives the time of sending for both, rmw_cyclonedds gives nothing.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_drivers.samples import CLOCKS_AGREE, Stamp

LONGEST_NS: Final = 10_000_000_000
"""Nanoseconds that a request waits at most: one that is later still comes from a clock that was set."""

MAY_WAIT_NS: Final = 500_000_000
"""Nanoseconds by which each request of a client may be late while its clock counts as one that agrees."""

ON_ITS_WAY_NS: Final = 50_000_000
"""Nanoseconds that a request takes at most to come, if nothing holds it up."""

MOST_SENDERS: Final = 64

SENT_AGAIN: Final = 4.0
"""Seconds in which DDS has sent again what was lost: Fast DDS tells each 3 s what there is (heartbeat). A
process that has been heard for less is new: all of its messages may be late."""

WINDOW: Final = 4.0
ENOUGH: Final = 10
"""Seconds and messages after which the quickest of them counts, and not one that came before: a delay that
stays is the network's own, or the clock was set back."""

DRIFT: Final = 1e-4
"""Seconds per second by which two clocks drift apart that nobody synchronises."""

LATEST: Final = 30.0
"""Seconds by which a message is late at most: a clock that is further behind was set. DDS forgets after 20 s
who cannot be reached, and sends it nothing again."""

BACKLOG: Final = 0.5
"""Seconds between two messages after which a clock was set, if both are as late: what waits comes at once."""

UNEVEN: Final = 0.25
"""Seconds by which the network keeps one of two messages of a process longer, if it loses neither."""

INVERTED_NS: Final = 100_000_000
"""Nanoseconds by which a message may be stamped before the one that its publisher sent before it: the threads
of a process that publish have no order between stamp and sending (12 ms were seen). More is a clock that was
set back."""

SAME: Final = 0.05
"""Seconds between two latenesses that count as the same."""

_AGREES_NS: Final = round(CLOCKS_AGREE * 1e9)


class Arrival(NamedTuple):
    """Of one message or request. Times are of the clock of this machine, since the epoch.

    Attributes:
        received_ns: when it came; 0 if that is not known.
        sent_ns: when it was sent, as far as the clock of its sender is known; else `received_ns`.
        earliest_ns: as `sent_ns`. Of a sender that is new: by its own stamp, if that is earlier, and by no
            more than `SENT_AGAIN`.
        ahead_ns: by how much the sender's clock is ahead of this machine's, less what the way took. Negative:
            it is behind, or the network kept the message. 0 if that is not known.
    """

    received_ns: int
    sent_ns: int
    earliest_ns: int
    ahead_ns: int

    @property
    def stamp_ns(self) -> int:
        """When it was sent, by the clock of its sender."""
        return self.received_ns + self.ahead_ns

    @property
    def late(self) -> float:
        """Seconds by which it came later than what comes quickest of its sender."""
        return 1e-9 * (self.received_ns - self.sent_ns)


def as_it_came(received_ns: int, sent_ns: int) -> Arrival:
    """Return the arrival of what counts from when it came; 0: the middleware does not tell that time."""
    known = received_ns and sent_ns
    return Arrival(received_ns, received_ns, received_ns, sent_ns - received_ns if known else 0)


class SenderClock:
    """Learns how far the clock of a process is off that sends messages. Tells which are late. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # By how many s the clock of this machine is ahead of its monotonic one.
        self._wall_ahead: float | None = None
        self._begin_anew()

    def _begin_anew(self) -> None:
        # Seconds from stamp to arrival: of the quickest message, and of the quickest of a new window.
        self._least = self._next = math.inf
        # Monotonic seconds: when the window began, the newest message came, the sender became new.
        self._from = self._seen = self._new_since = -math.inf
        self._count = 0  # messages of the window
        self._backlog: tuple[float, float] | None = None
        # By how much the clock of this machine was set, until a message tells whether its sender's was, too.
        self._set = 0.0
        # The sender's newest stop, or change of state: by its own stamp, and when it came.
        self._changed = 0, 0

    def arrival(self, received_ns: int, sent_ns: int, before_ns: int = 0) -> Arrival:
        """Return the arrival of a message.

        Args:
            received_ns, sent_ns: as the middleware tells; 0: it does not.
            before_ns: when the message before it of the same publisher was sent; 0: there is none.
        """
        if not (received_ns and sent_ns):
            return as_it_came(received_ns, sent_ns)
        now = Stamp.now()
        wall_ahead = 1e-9 * now.wall_ns - now.monotonic
        waited = max(0.0, 1e-9 * (now.wall_ns - received_ns))
        by_stamp = 1e-9 * (received_ns - sent_ns)
        with self._lock:
            if sent_ns < before_ns - INVERTED_NS:
                self._begin_anew()
            step = 0.0 if self._wall_ahead is None else wall_ahead - self._wall_ahead
            self._wall_ahead, self._set = wall_ahead, self._set + step
            # How long it waited here is not known where the clock was set meanwhile.
            received = now.monotonic - (waited if abs(step) < SAME else 0.0)
            late = self._late(received, 1e-9 * sent_ns)
            is_new = received - self._new_since < SENT_AGAIN
        latest = max(late, by_stamp) if is_new and by_stamp < SENT_AGAIN else late
        sent, earliest = (received_ns - 1000 * round(1e6 * each) for each in (late, latest))
        return Arrival(received_ns, sent, earliest, sent_ns - received_ns)

    def _late(self, received: float, stamp: float) -> float:
        """Return by how many seconds a message is later than the quickest; learn from it."""
        apart = received - stamp
        late = self._later_than_the_quickest(received, apart)
        is_one_machine = abs(self._set) > SAME and abs(late + self._set) < SAME
        if is_one_machine or (late > LATEST and self._is_no_backlog(received, apart)):
            self._begin_anew()
            return self._later_than_the_quickest(received, apart)
        if late < SAME:
            self._set = 0.0
        return late

    def _later_than_the_quickest(self, received: float, apart: float) -> float:
        """Return by how many seconds a message is later than the quickest, which it may become."""
        drift = DRIFT * max(0.0, received - self._seen)
        if drift > UNEVEN:  # or it has never been heard
            self._new_since = received
        if math.isfinite(drift):
            self._least += drift
            self._next += drift
        self._seen = max(self._seen, received)
        if not self._count:
            self._from = received
        self._next, self._count = min(self._next, apart), self._count + 1
        if received - self._from > WINDOW and self._count > ENOUGH:
            self._least = self._next
            self._next, self._count = math.inf, 0
        self._least = min(self._least, apart)
        return apart - self._least

    def _is_no_backlog(self, received: float, apart: float) -> bool:
        """Whether a message is as late as another one that came some time ago: the clock was set."""
        before = self._backlog
        if before is None or abs(apart - before[1]) > UNEVEN:
            self._backlog = received, apart
            return False
        return received - before[0] > BACKLOG

    def changes_state(self, arrival: Arrival) -> None:
        """Note that what came so is a stop, or changes the state."""
        with self._lock:
            self._changed = max(self._changed, (arrival.stamp_ns, arrival.received_ns))

    def in_order(self, arrival: Arrival) -> Arrival:
        """Return the arrival of a command that is carried out now.

        What was sent after its sender's own stop, and is not late, counts as sent when that came, at the
        earliest: the network may have kept the stop a little longer.
        """
        changed_by, changed = self._changed
        is_after = arrival.stamp_ns >= changed_by and changed <= time.time_ns()
        if not is_after or arrival.late >= UNEVEN:
            return arrival
        sent, earliest = max(arrival.sent_ns, changed), max(arrival.earliest_ns, changed)
        return arrival._replace(sent_ns=sent, earliest_ns=earliest)


@dataclass(slots=True)
class _Sender:
    """What is known of a client: the least by which its requests were late, and when the first was taken."""

    least: int
    first: int


class Requests:
    """The arrivals of requests of one service. For one thread."""

    def __init__(self) -> None:
        self._senders: dict[bytes, _Sender] = {}

    def arrival(self, sender: bytes, received_ns: int, sent_ns: int) -> Arrival:
        """Return the arrival of a request that is taken now.

        What was sent before a stop must not be carried out after it. So a request counts as sent when its
        stamp says, as far as the clock of its sender may agree with ours. The one that was late by least says
        what the clock differs by; of the first ones of a client that is not known yet.

        Args:
            sender: id of the client.
            received_ns, sent_ns: as the middleware tells; 0: it does not.
        """
        if received_ns not in (0, sent_ns) or not sent_ns:
            return as_it_came(received_ns, sent_ns)
        received, now = time.time_ns(), time.monotonic_ns()
        late = received - sent_ns
        known = self._senders.pop(sender, None)
        if known is None or late - known.least > LONGEST_NS:
            known = _Sender(late, now)
        known.least = min(known.least, late)
        self._senders[sender] = known
        for oldest in tuple(self._senders)[:-MOST_SENDERS]:
            del self._senders[oldest]
        is_learnt = now - known.first > LONGEST_NS  # else all of them may have waited
        judged, most = (known.least, MAY_WAIT_NS) if is_learnt else (late, LONGEST_NS)
        may_agree = -_AGREES_NS <= judged <= most
        sent = sent_ns if may_agree else sent_ns + known.least - ON_ITS_WAY_NS
        return Arrival(received, sent, sent, -known.least)
