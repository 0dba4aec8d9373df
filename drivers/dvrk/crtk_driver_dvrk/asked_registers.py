"""Registers that are asked for beside the states of boards: one between two readings, none is waited for.

Belongs to the I/O thread.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from typing import Final

from crtk_driver_dvrk.boards import Boards
from crtk_driver_dvrk.registers import Register
from crtk_driver_dvrk.safeguards import Trouble
from crtk_drivers.errors import DeviceFault
from crtk_drivers.kit.waiting_steps import until

Place = tuple[int, int]
"""Number of a board, and address of a register."""

_EVERY: Final = 4
"""Readings from one register that must stay to the next."""

_TOLD: Final = 2.0
"""Seconds in which a register must have been told."""


class AskedRegisters:
    """Asks.

    Args:
        boards: the way to them.

    Attributes:
        trouble: a register that must stay has changed.
    """

    def __init__(self, boards: Boards) -> None:
        self._boards = boards
        self._nodes: Mapping[int, int] = {}
        self._wanted: dict[Place, int | None] = {}  # by procedures, and what was told
        self._kept: dict[Place, int] = {}
        self._round: list[Place] = []
        self._readings = 0
        self._strange: Place | None = None
        self._asked: tuple[Place, int] | None = None  # and the label of the answer
        self.trouble: Trouble | None = None

    def reached(self, nodes: Mapping[int, int]) -> None:
        """The boards of the arm have been found anew, at these nodes, by number."""
        self._nodes, self._asked = nodes, None

    def ask(self) -> None:
        """Ask for the next register, if there is one to ask for. Nothing else may be asked for meanwhile.

        Raises:
            ConnectionLost: the connection is gone.
        """
        missing = (place for place, value in self._wanted.items() if value is None)
        place = next(missing, None) or self._next()
        if place is not None:
            board, address = place
            self._asked = place, self._boards.ask_register(self._nodes[board], address)

    def collect(self) -> None:
        """Take what has come in answer; what has not is asked for again.

        Raises:
            ConnectionLost: as `Boards.answer`.
        """
        asked, self._asked = self._asked, None
        if asked is None:
            return
        place, label = asked
        reply = self._boards.answer(self._nodes[place[0]], label, 0.0)
        if reply is None or len(reply.quadlets) != 1:
            return
        value = _masked(place[1], reply.quadlets[0])
        if place in self._wanted:
            self._wanted[place] = value
        if place not in self._kept or value == self._kept[place]:
            self._strange = None
        elif self._strange != place:
            self._strange = place  # looked at once more: the board with the cable sends no CRC
        else:
            self.trouble = _changed(place, value)

    def _next(self) -> Place | None:
        if self._strange is not None:
            return self._strange
        self._readings += 1
        if not self._kept or self._readings % _EVERY:
            return None
        self._round = self._round or list(self._kept)
        return self._round.pop()

    def keep(self, values: Mapping[Place, int]) -> None:
        """Look again and again whether registers still hold these values; none: no more."""
        self._kept, self._round = dict(values), []
        self._strange = self.trouble = None

    def read(self, place: Place) -> Generator[None, None, int]:
        """Return a register, as a part of a procedure: ``value = yield from registers.read(...)``.

        Raises:
            DeviceFault: it is not told.
        """
        self._wanted[place] = None
        try:
            yield from until(lambda: self._wanted[place] is not None, _TOLD)
        finally:
            value = self._wanted.pop(place)
        if value is None:
            raise DeviceFault(
                f"board {place[0]} does not tell register {place[1]:#x}",
                where=self._boards.where,
                remedy="Look at the network of the boards.",
            )
        return value

    def write(self, place: Place, value: int) -> Generator[None, None, None]:
        """Write a register until it is read back, as a part of a procedure.

        Raises:
            DeviceFault: it is not read back.
            ConnectionLost: the connection is gone.
        """
        deadline = time.monotonic() + _TOLD
        while True:
            self._boards.write(self._nodes[place[0]], place[1], value)
            found = yield from self.read(place)
            if found == value:
                return
            if time.monotonic() > deadline:
                raise DeviceFault(
                    f"board {place[0]}: register {place[1]:#x} is {found:#x} after {value:#x} was written",
                    where=self._boards.where,
                    remedy="Does another program write it (dVRK's own)? End it, then try again.",
                )


def _masked(address: int, value: int) -> int:
    return value & (0xFFFF if address == Register.WATCHDOG else 0xFFFFFF)


def _changed(place: Place, value: int) -> Trouble:
    board, address = place
    remedy = "Another program writes to it: end it (dVRK's own?), then send enable."
    if address == Register.WATCHDOG:
        return Trouble(f"board {board}: the period of its watchdog was changed to {value}", remedy)
    return Trouble(f"board {board}: the encoder of axis {(address >> 4) - 1} was set anew", remedy)
