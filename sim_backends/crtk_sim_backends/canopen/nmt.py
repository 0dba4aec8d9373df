"""Network management of a node: its state, its heartbeat and those of others (CiA 301, 7.2.8)."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Final

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.dictionary import ObjectDictionary


class NmtState(IntEnum):
    """State of a node, as its heartbeat tells it."""

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


# For those who ask at every frame: a member is looked up slowly in Python 3.11.
INITIALISING: Final = NmtState.INITIALISING
STOPPED: Final = NmtState.STOPPED
OPERATIONAL: Final = NmtState.OPERATIONAL
PRE_OPERATIONAL: Final = NmtState.PRE_OPERATIONAL


class Command(IntEnum):
    """Command specifier of an NMT message."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


ENTERS = {
    Command.START: OPERATIONAL,
    Command.STOP: STOPPED,
    Command.ENTER_PRE_OPERATIONAL: PRE_OPERATIONAL,
}


def command_for(data: bytes, node_id: int) -> Command | None:
    """Decode an NMT message (COB-ID 000) for a node; None when it is for another, or none."""
    if len(data) != 2 or data[1] not in (0, node_id):
        return None
    return Command(data[0]) if data[0] in Command.__members__.values() else None


class Heartbeats:
    """Heartbeat producer (1017) and consumer (1016).

    Args:
        dictionary: of the node.
        lost: called with the node-ID whose heartbeat has stayed away.
        returned: called with the node-ID whose heartbeat is there again.
    """

    def __init__(
        self,
        dictionary: ObjectDictionary,
        lost: Callable[[int], None],
        returned: Callable[[int], None],
    ) -> None:
        self._dictionary = dictionary
        self._lost = lost
        self._returned = returned
        self._due: float | None = None
        self._deadlines: dict[int, float] = {}  # by node, once heard
        self._missing: set[int] = set()
        self._times: dict[int, float] = {}  # s, by monitored node
        dictionary.guards[0x1016] = self._guard_consumer
        dictionary.written[0x1016] = lambda _: self._read_times()
        dictionary.written[0x1017] = lambda _: self._restart()

    def reset(self, now: float) -> None:
        """Begin anew with what the dictionary says."""
        self._deadlines.clear()
        self._missing.clear()
        self._read_times()
        self._due = now if self._dictionary[0x1017, 0] else None

    def _restart(self) -> None:
        self._due = 0.0 if self._dictionary[0x1017, 0] else None

    def _guard_consumer(self, sub: int, value: int) -> None:
        node, time = value >> 16 & 0xFF, value & 0xFFFF
        if node > 127:
            raise SdoAbort(Abort.VALUE)
        others = (self._dictionary[0x1016, other] for other in range(1, 5) if other != sub)
        if node and time and any(other >> 16 == node and other & 0xFFFF for other in others):
            raise SdoAbort(Abort.INCOMPATIBLE_PARAMETER)

    def _read_times(self) -> None:
        entries = (self._dictionary[0x1016, sub] for sub in range(1, 5))
        self._times = {
            entry >> 16: (entry & 0xFFFF) / 1000
            for entry in entries
            if entry >> 16 and entry & 0xFFFF
        }
        self._deadlines = {node: t for node, t in self._deadlines.items() if node in self._times}
        self._missing &= self._times.keys()

    @property
    def monitored(self) -> list[int]:
        """Identifiers of the heartbeats that are expected."""
        return [0x700 + node for node in self._times]

    def on_heartbeat(self, node: int, now: float) -> None:
        """Note the heartbeat or boot-up message of another node."""
        if node not in self._times:
            return
        self._deadlines[node] = now + self._times[node]
        if node in self._missing:
            self._missing.remove(node)
            self._returned(node)

    def extend(self, seconds: float) -> None:
        """Let the deadlines of the others be later."""
        for node in self._deadlines:
            self._deadlines[node] += seconds

    def check(self, now: float) -> None:
        """Report the heartbeats that have stayed away."""
        for node, deadline in list(self._deadlines.items()):
            if now >= deadline:
                del self._deadlines[node]
                self._missing.add(node)
                self._lost(node)

    def produce(self, now: float) -> bool:
        """Whether a heartbeat is to be sent now."""
        if self._due is None or now < self._due:
            return False
        period = self._dictionary[0x1017, 0] / 1000
        self._due = self._due + period if now < self._due + period else now + period
        return True

    @property
    def next_timer(self) -> float | None:
        """When `produce` or `check` have something to do, None for never."""
        times = [*self._deadlines.values(), *([] if self._due is None else [self._due])]
        return min(times, default=None)
