"""Limits of speed that were lowered in drives, and what these held before: they get it back at the end.

A limit that stayed would be taken for a wrong unit by the next start with a much greater one, until the drive
is switched off.
"""

from __future__ import annotations

import logging
from collections.abc import Container
from typing import Final, NamedTuple

from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import Entry
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.transfers import SdoChannel
from crtk_drivers.errors import ConnectionLost, CrtkError

logger = logging.getLogger(__name__)

_ANSWER: Final = 0.25
"""Seconds for an answer: the end of a program does not wait for drives that do not answer."""


class _Lowered(NamedTuple):
    """What an object held, and what it was given."""

    found: int
    given: int


class LoweredLimits:
    """Of the drives of an arm, for as long as the program runs: a drive may be set up again and again."""

    def __init__(self) -> None:
        self._rows: dict[tuple[int, Entry], _Lowered] = {}

    def note(self, node: int, entry: Entry, found: int, given: int) -> None:
        """Take note of an object, of its axis, that held `found` and holds what it was `given`."""
        self._rows[node, entry] = _Lowered(found, given)

    def give_back(self, master: Master, nodes: Container[int]) -> None:
        """Let drives without power hold what they held; what somebody else has changed since is left.

        It is the last that these nodes are asked: it takes their answers.

        Args:
            master: of the open bus.
            nodes: that answer.

        Raises:
            ConnectionLost: the bus cannot be used.
        """
        try:
            for (node, entry), row in list(self._rows.items()):
                if node not in nodes:
                    continue
                sdo = Sdo(SdoChannel(master.link, node, _ANSWER, master.poll))
                if sdo.read(entry) == row.given:
                    sdo.ensure(entry, row.found)
                del self._rows[node, entry]
        except ConnectionLost:
            raise
        except CrtkError as error:
            logger.warning(
                "%s: a drive may keep a limit that was lowered: %s", master.link.where, error
            )
