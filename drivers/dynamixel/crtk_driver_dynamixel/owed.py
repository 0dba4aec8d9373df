"""Which replies may still come to requests that were given up. Pure: no I/O, no clock.

A status tells its servo and its length, not the request that it answers; and an adapter, a hub or the system
may hold it back for any time. But bytes do not overtake each other. So a reply that nothing else can be
shows that all those before it have come: an answer that is expected, or else that to a *probe*, a harmless
read whose length no reply has that is owed.
"""

from __future__ import annotations

from itertools import count

from crtk_driver_dynamixel.framing import Status

_Key = tuple[int, int]
"""Id of the servo, and bytes of the reply's data."""


class Owed:
    """The replies that are owed on one line.

    Every probe that is kept here was sent after all requests whose replies are in `_before`, so that the
    reply to any of them shows that none of these comes any more.
    """

    def __init__(self) -> None:
        self._before: set[_Key] = set()
        self._probes: set[_Key] = set()
        self._now: set[_Key] = set()

    @property
    def none(self) -> bool:
        """Whether every reply is an answer to the newest request."""
        return not (self._before or self._probes or self._now)

    def begin(self) -> None:
        """A request follows that is not the one before it once more: what comes late answers nothing."""
        if self._now:
            self._close()
            self._before |= self._now
            self._now.clear()

    def is_ambiguous(self, id: int, length: int) -> bool:
        """Whether a reply of this servo and length could be owed to an earlier request."""
        return (id, length) in self._before or (id, length) in self._probes

    def holds(self, status: Status) -> bool:
        """Whether a status could be owed to an earlier request; if it has an error, it lacks its data."""
        return self.is_ambiguous(status.id, len(status.params)) or self._holds_error(status)

    def holds_besides_probes(self, status: Status) -> bool:
        """Whether a status could be owed to an earlier request that was no probe."""
        return (status.id, len(status.params)) in self._before or self._holds_error(status)

    def probe(self, id: int, length: int) -> int:
        """Return how much to read of a servo, so that its reply is none that is owed.

        Args:
            length: of the reply that is wanted afterwards, from which that to the probe differs too.
        """
        if (id, length) in self._probes:
            self._close()
        taken = {other for servo, other in self._before if servo == id} | {length}
        chosen = next(size for size in count(1) if size not in taken)
        self._probes.add((id, chosen))
        return chosen

    def probed(self) -> None:
        """A probe was answered: nothing that was asked for before it comes any more."""
        self._before.clear()

    def answered(self, *, again: bool) -> None:
        """A request was answered: nothing that was asked for before it comes any more.

        Args:
            again: or the same request before it, between which and this one there may have been probes.
        """
        self._before.clear()
        if not again:
            self._probes.clear()

    def missed(self, id: int, length: int) -> None:
        """A servo has not answered in its time."""
        self._now.add((id, length))

    def _close(self) -> None:
        self._before |= self._probes
        self._probes.clear()

    def _holds_error(self, status: Status) -> bool:
        return status.error != 0 and any(id == status.id for id, _ in self._before)
