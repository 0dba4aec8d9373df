"""A number that a user may change while a gripper runs: the force of the next grip, for example."""

from __future__ import annotations

import math
from collections.abc import Callable

from crtk_drivers.commands import Payload
from crtk_drivers.device import Input
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import Number

__all__ = ["Adjustable"]


class Adjustable:
    """An input of a device that keeps what it is given, or refuses it.

    Args:
        name: of the input.
        summary: for people.
        value: as configured.
        limits: return the least and the greatest.
        unit: for people; empty: a share.
        above: the least one is none itself.

    Attributes:
        value: that counts now.
    """

    def __init__(
        self,
        name: str,
        summary: str,
        value: float,
        limits: Callable[[], tuple[float, float]],
        unit: str = "",
        *,
        above: bool = False,
    ) -> None:
        self.value = value
        self._name, self._summary, self._unit = name, summary, unit
        self._limits, self._above = limits, above

    def input(self, where: str) -> Input:
        """Return it as an input of the device at an address."""
        return Input(self._summary, Payload.NUMBER, lambda number: self._take(number, where))

    @property
    def name(self) -> str:
        """Of the input."""
        return self._name

    def _take(self, number: Number, where: str) -> None:
        low, high = self._limits()
        value = number.value
        if math.isfinite(value) and low <= value <= high and not (self._above and value == low):
            self.value = value
            return
        unit = f" {self._unit}" if self._unit else ""
        least = f"above {low:g}" if self._above else f"from {low:g}"
        what = f"It is in{unit}, {least}" if unit else f"It is a share, {least}"
        raise CommandRefused(
            self._name,
            Reason.OUT_OF_RANGE if math.isfinite(value) else Reason.NOT_FINITE,
            f"{self._name}: {value:g}{unit}",
            where=where,
            remedy=f"{what} to {high:g}.",
        )
