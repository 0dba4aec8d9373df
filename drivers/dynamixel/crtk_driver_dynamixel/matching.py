"""Which of the replies that are expected the statuses are that arrive. Pure: no I/O, no clock."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.replies import Failure, Reply


@dataclass(frozen=True, slots=True)
class Slot:
    """The reply that is expected of one servo.

    Attributes:
        length: of its data, without stuffing.
        size: of the whole packet without stuffing.
        time: seconds in which it comes after whatever comes before it.
        keeps_data: whether a reply with an error may bring data as well: protocol 1.0.
    """

    id: int
    length: int
    size: int
    time: float
    keeps_data: bool = False


class Matcher:
    """Puts statuses in their slots. Servos reply in the order of the slots, each once.

    Args:
        slots: in the order of the request.

    Attributes:
        at: index of the slot whose reply is due; those before it are answered or passed over.
    """

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._slots = slots
        self._found: list[Reply | None] = [None] * len(slots)
        self._index = {slot.id: index for index, slot in enumerate(slots)}
        self.at = 0

    @property
    def done(self) -> bool:
        """Whether the last slot is answered."""
        return self.at == len(self._slots)

    @property
    def complete(self) -> bool:
        """Whether every slot is answered."""
        return None not in self._found

    @property
    def answered(self) -> int:
        """One more than the index of the last slot that is answered."""
        return next((i + 1 for i in range(self.at - 1, -1, -1) if self._found[i]), 0)

    def place(self, status: Status) -> list[int]:
        """Take a status and return the ids of replies that turn out not to belong here, its own among them.

        A reply of a servo that was passed over shows that those taken since were not the ones asked for. Of
        two replies of one servo the later counts.
        """
        index = self._index.get(status.id)
        if index is None:
            return [status.id]
        slot = self._slots[index]
        has_data = len(status.params) == slot.length and (
            not status.error or (slot.keeps_data and slot.length > 0)
        )
        if not (has_data or status.error):
            return [status.id]
        strays = [status.id] if self._found[index] else []
        if index < self.at and not strays:
            strays = [reply.id for reply in self._found[index + 1 : self.at] if reply]
            self._found[index + 1 : self.at] = [None] * (self.at - index - 1)
            self.at = index + 1
        self._found[index] = Reply(
            status.id,
            status.params if has_data else None,
            status.error,
            status.alert,
            None if has_data else Failure.REFUSED,
            status.hardware,
        )
        self.at = max(self.at, index + 1)
        return strays

    def replies(self, corrupt: Collection[int]) -> list[Reply]:
        """Return the reply of each slot up to `at`, and of that one if it has let its time pass.

        Args:
            corrupt: ids of the packets that arrived damaged.
        """
        end = min(self.at + 1, len(self._slots))
        return [
            self._found[index] or _missing(slot.id, corrupt)
            for index, slot in enumerate(self._slots[:end])
        ]


def _missing(id: int, corrupt: Collection[int]) -> Reply:
    return Reply(id, None, failure=Failure.CORRUPT if id in corrupt else Failure.SILENT)
