"""When a message came, by the clock of this machine, and by how much the clock of its sender is off.

Of a message on a topic DDS tells when it was sent and when it came. Of a request it does not tell when it
came: rmw_fastrtps (8.4.3) gives the time of sending for both, rmw_cyclonedds gives nothing. By the time of
sending, each goal of a client whose clock is behind would be older than the last stop, and refused. So the
arrival is reckoned here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_drivers.samples import CLOCKS_AGREE

LONGEST_NS: Final = 10_000_000_000
"""Nanoseconds that a request waits at most: one that is later still comes from a clock that was set."""

MAY_WAIT_NS: Final = 500_000_000
"""Nanoseconds by which each request of a client may be late while its clock counts as one that agrees."""

ON_ITS_WAY_NS: Final = 50_000_000
"""Nanoseconds that a request takes at most to come, if nothing holds it up."""

MOST_SENDERS: Final = 64

_AGREES_NS: Final = round(CLOCKS_AGREE * 1e9)


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

        What was sent before a stop must not be carried out after it. So a request counts as come when it was
        sent, as far as the clock of its sender may agree with ours. The one that was late by least says what
        the clock differs by; of the first ones of a client that is not known yet.

        Args:
            sender: id of the client.
            received_ns, sent_ns: as the middleware tells; 0: it does not.
        """
        if received_ns not in (0, sent_ns) or not sent_ns:
            return of_message(received_ns, sent_ns)
        late, now = time.time_ns() - sent_ns, time.monotonic_ns()
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
        came = sent_ns if may_agree else sent_ns + known.least - ON_ITS_WAY_NS
        return Arrival(came, -known.least)
