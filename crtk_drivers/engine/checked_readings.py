"""A device's own readings, each checked when it is told: that it is of its payload's class."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

from crtk_drivers.device import Reading
from crtk_drivers.errors import WrongReading
from crtk_drivers.samples import VALUE_TYPES, Value

__all__ = ["checked_readings"]

logger = logging.getLogger(__name__)


def checked_readings(readings: Mapping[str, Reading], where: str) -> dict[str, Reading]:
    """Return readings whose `tell` raises WrongReading for a value of another class than the payload's.

    The first wrong value of each is logged as an error. So whoever looks at all of them leaves it out.

    Args:
        readings: of the device.
        where: the device, for messages.
    """
    return {
        name: replace(reading, tell=_Checked(name, reading, where).tell)
        if reading.payload in VALUE_TYPES
        else reading
        for name, reading in readings.items()
    }


class _Checked:
    def __init__(self, name: str, reading: Reading, where: str) -> None:
        self._name, self._reading, self._where = name, reading, where
        self._wanted = VALUE_TYPES[reading.payload]
        self._is_said = False

    def tell(self) -> Value | None:
        value = self._reading.tell()
        if value is None or isinstance(value, self._wanted):
            return value
        error = WrongReading(
            f"reading {self._name!r}: returned {type(value).__name__}, "
            f"must return {self._wanted.__name__} (crtk_drivers.samples)",
            where=self._where,
        )
        if not self._is_said:
            logger.error("%s", error)
            self._is_said = True
        raise error
