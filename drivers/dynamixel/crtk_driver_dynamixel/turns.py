"""Which turn joints of more than one turn are in, kept in a file over a loss of power.

The file is believed only where it cannot be old. It is marked as not clean as long as a driver has the chain
open, and written as the joints turn; only a driver that ends in order marks it as clean. Where it is not
clean, a servo that still has its bus watchdog set has not lost its power since, and counts on: its shift of
that time holds. Otherwise the position is a guess, and the joint is not homed.
"""

from __future__ import annotations

import logging
import math
import threading
from pathlib import Path
from typing import Final, NamedTuple

from pydantic import Field, FiniteFloat

from crtk_driver_dynamixel.calibration import write_whole
from crtk_driver_dynamixel.units import Servo
from crtk_drivers.config import Settings, from_file, load
from crtk_drivers.errors import ConfigError

logger = logging.getLogger(__name__)

MOST_OFF: Final = 0.25
"""Of a turn of the servo that a joint may have moved without power, and be believed."""
WORTH_KEEPING: Final = 0.125
"""Of a turn, by which a joint has turned when it is kept again."""
END_TIME: Final = 1.0
"""Seconds for which the end of writing is waited for."""

_HEAD: Final = (
    "# Where the joints are, in rad, and by how many counts their servos are in other turns than they\n"
    "# count. Not to be believed after a loss of power, unless it is clean.\n"
)


class Turns(Settings):
    """The content of the file."""

    clean: bool = Field(
        default=False, description="Nothing has moved since, as far as a driver knows."
    )
    positions: dict[str, FiniteFloat] = Field(description="Joint positions in rad, by name.")
    shifts: dict[str, int] = Field(
        default={},
        description="Counts by which servos are in other turns than they count, by bus/id; without those "
        "whose turn was not known.",
    )


class Placed(NamedTuple):
    """Where a servo of more than one turn is.

    Attributes:
        shift: counts by which it is in another turn than it counts.
        doubt: why that is no more than a guess, in words; empty if it is not.
    """

    shift: int
    doubt: str = ""


def placed(
    servo: Servo, count: int, last: float, shift: int | None, *, clean: bool, has_run_on: bool
) -> Placed:
    """Return which turn a servo is in, by what the file says of it.

    Args:
        servo: in a mode of more than one turn.
        count: its present position.
        last: position of its joint in the file, in rad.
        shift: of the servo in the file; None if it is not there: its turn was not known.
        clean: the file is.
        has_run_on: the servo has not lost its power since the file was marked as not clean.
    """
    family = servo.model.family
    period = family.counts * family.position_unit / servo.gear
    if has_run_on and shift is not None and not clean:
        return Placed(shift)
    off = last - servo.position(count)
    turns = round(off / period)
    guess = -servo.sign * turns * family.counts
    if not clean:
        why = "it was not homed before" if has_run_on else "the servo lost its power"
        return Placed(guess, f"the driver did not end in order, and {why}")
    if abs(off - turns * period) > MOST_OFF * period:
        return Placed(guess, "it was turned by more than a quarter of a turn while nobody looked")
    return Placed(guess)


class TurnsFile:
    """The file; written by a thread of its own, so that a slow disk holds nobody up.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._newest: Turns | None = None
        self._ends = False
        self._changed = threading.Condition()
        self._writer: threading.Thread | None = None

    def load(self) -> Turns | None:
        """Return what it says; None if there is no such file yet.

        Raises:
            ConfigError: not such a file; with its line.
        """
        return load(Turns, from_file(self.path)) if self.path.exists() else None

    def save(self, turns: Turns) -> None:
        """Write it now.

        Raises:
            ConfigError: it cannot be written.
        """
        write_whole(self.path, _HEAD, turns.model_dump(mode="json"))

    def keep(self, turns: Turns) -> None:
        """Write it soon; the newest counts."""
        with self._changed:
            self._newest = turns
            if self._writer is None:
                self._ends = False
                self._writer = threading.Thread(target=self._write, name="turns", daemon=True)
                self._writer.start()
            self._changed.notify()

    def end(self) -> bool:
        """End writing; return whether all of it has been written."""
        writer, self._writer = self._writer, None
        if writer is None:
            return True
        with self._changed:
            self._ends = True
            self._changed.notify()
        writer.join(END_TIME)
        return not writer.is_alive()

    def _write(self) -> None:
        while True:
            with self._changed:
                while self._newest is None and not self._ends:
                    self._changed.wait()
                newest, self._newest = self._newest, None
                if newest is None:
                    return
            try:
                self.save(newest)
            except ConfigError as error:
                logger.warning("%s", error)


def has_turned(servo: Servo, before: float, now: float) -> bool:
    """Whether a joint has turned by so much that it is worth keeping."""
    family = servo.model.family
    period = family.counts * family.position_unit / servo.gear
    return not math.isclose(now, before, rel_tol=0.0, abs_tol=WORTH_KEEPING * period)
