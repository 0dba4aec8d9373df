"""Limits of speed that were lowered in drives, and what these held before: they get it back at the end.

A limit that stayed would be taken for a wrong unit by the next start with a much greater one, until the drive
is switched off.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Container
from typing import Final, NamedTuple

from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS, Entry
from crtk_driver_canopen.sdo import Sdo, SdoSilent
from crtk_driver_canopen.statemachine import POWERED, decode
from crtk_driver_canopen.transfers import SdoChannel
from crtk_drivers.errors import ConnectionLost, CrtkError

logger = logging.getLogger(__name__)

_ANSWER: Final = 0.25
"""Seconds for an answer: the end of a program does not wait for drives that do not answer."""

_ALL: Final = 0.75
"""Seconds for the answers of all drives, for the same reason: each one may be slow."""


class _Place(NamedTuple):
    """An object of an axis of a node."""

    node: int
    axis: int
    entry: Entry


class _Lowered(NamedTuple):
    """What an object held, and what it was given."""

    found: int
    given: int


class LoweredLimits:
    """Of the drives of an arm, for as long as the program runs: a drive may be set up again and again."""

    def __init__(self) -> None:
        self._rows: dict[_Place, _Lowered] = {}

    def note(self, node: int, axis: int, entry: Entry, found: int, given: int) -> None:
        """Take note of an object, of an axis, that held `found` and is `given` another value."""
        self._rows[_Place(node, axis, entry)] = _Lowered(found, given)

    def give_back(self, master: Master, nodes: Container[int]) -> None:
        """Let drives without power hold what they held; what somebody else has changed since is left.

        It is the last that these nodes are asked: it takes their answers.

        Args:
            master: of the open bus.
            nodes: that may answer.

        Raises:
            ConnectionLost: the bus cannot be used.
        """
        deadline = time.monotonic() + _ALL

        def poll(until: float, done: Callable[[], bool]) -> bool:
            return master.poll(min(until, deadline), done)

        silent: set[int] = set()
        for place, row in list(self._rows.items()):
            if place.node not in nodes or place.node in silent:
                continue
            sdo = Sdo(SdoChannel(master.link, place.node, _ANSWER, poll), place.axis)
            try:
                if self._gave_back(sdo, place.entry, row):
                    del self._rows[place]
            except ConnectionLost:
                raise
            except CrtkError as error:
                if isinstance(error, SdoSilent):
                    silent.add(place.node)
                logger.warning("%s: it may keep a limit that was lowered: %s", sdo.where, error)

    @staticmethod
    def _gave_back(sdo: Sdo, entry: Entry, row: _Lowered) -> bool:
        """Give an axis back what an object held; return False if it has power: it could go faster."""
        state = decode(sdo.read(OBJECTS["statusword"]))  # what it told last may be old
        if state is None or state in POWERED:
            return False
        if sdo.read(entry) == row.given:
            sdo.ensure(entry, row.found)
        return True
