"""Which SYNC a drive has answered: a gateway may hold frames back, all by the same time too. No I/O.

Nothing in a TPDO says which SYNC it answers. But the first answers the first, and each the one after: where
answers are missing, they may be lost, or held back. An answer to something else that was sent behind a SYNC
tells which: frames overtake nothing, so that what was sent before has been answered, or is lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from typing import Final

__all__ = ["SyncAnswers"]

KEPT: Final = 4096
"""SYNCs of which it is known when they were sent: those before are as old as the oldest of them."""


class SyncAnswers:
    """The SYNCs of one bus, and what the TPDOs that come with each of them answer.

    Args:
        nodes: of each TPDO the node; None where it does not come with every SYNC.
    """

    def __init__(self, nodes: Sequence[int | None]) -> None:
        self._nodes = tuple(nodes)
        self._counted = tuple(slot for slot, node in enumerate(nodes) if node is not None)
        self.start()

    def start(self) -> None:
        """Begin anew: no answer is on its way."""
        self.number = 0
        """Of the newest SYNC; the first has 1."""
        self._sent: deque[float] = deque(maxlen=KEPT)
        self._answered = [0] * len(self._nodes)
        self._doubtful: set[int] = set()

    def sync(self, now: float) -> None:
        """Take note of a SYNC that was sent at monotonic seconds."""
        self.number += 1
        self._sent.append(now)

    def take(self, slot: int) -> None:
        """Take note of a TPDO."""
        self._answered[slot] = min(self._answered[slot] + 1, self.number)

    def settle(self, node: int, number: int) -> None:
        """A node has answered what was sent behind a SYNC: it owes no answer to that, nor to those before."""
        self._doubtful.discard(node)
        for slot in self._counted:
            if self._nodes[slot] == node:
                self._answered[slot] = min(max(self._answered[slot], number), self.number)

    def doubt(self, nodes: Collection[int]) -> None:
        """Let nodes that are silent, or have started anew, hold nobody up until they have settled."""
        self._doubtful.update(nodes)

    @property
    def owing(self) -> set[int]:
        """Nodes that owe answers to SYNCs before the newest, or are in doubt."""
        return self._doubtful | {
            node
            for slot in self._counted
            if (node := self._nodes[slot]) is not None and self._answered[slot] < self.number - 1
        }

    @property
    def time(self) -> float:
        """When the newest SYNC was sent that all have answered, in monotonic seconds; 0 if there is none.

        All but those in doubt, as long as there are others.
        """
        sure = [slot for slot in self._counted if self._nodes[slot] not in self._doubtful]
        slots = sure or self._counted
        answered = min((self._answered[slot] for slot in slots), default=self.number)
        if not answered:
            return 0.0
        return self._sent[max(-len(self._sent), answered - self.number - 1)]
