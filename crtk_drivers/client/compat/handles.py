"""What a move returns: as in the official client, waiting never raises."""

from __future__ import annotations

import logging
from typing import Any

from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.errors import CrtkError

logger = logging.getLogger(__name__)


class WaitMoveHandle:
    """The handle of a move that was sent.

    Args:
        move: what follows it; None if there is no operating state to tell it from.
    """

    def __init__(self, move: RemoteMove | None) -> None:
        self._move = move

    def wait(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Wait until the move has ended, or with `is_busy` until it has begun; return whether it has.

        False also if it was refused or ended before its goal; the log says why.

        Raises:
            RuntimeWarning: the class has no operating state (`add_operating_state`).
        """
        try:
            return self._required.wait(timeout, is_busy)
        except CrtkError as error:
            logger.warning("%s", error)
            return False

    def is_busy(self, *_: Any, **__: Any) -> bool:
        """Whether the move has not ended yet."""
        return self._required.is_busy()

    @property
    def _required(self) -> RemoteMove:
        if self._move is None:
            raise RuntimeWarning("cannot wait: the class has no CRTK operating state")
        return self._move
