"""Modbus RTU, or TCP by a gateway: an instance begins one register below its number, bytes as in the image.

Source: fieldbus manual of the Modbus RTU modules; SCHUNK's driver library. Only functions 3 and 16 are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from crtk_driver_schunk.gripper.image import SIZE, STATUS
from crtk_driver_schunk.gripper.link import Question, Reply
from crtk_driver_schunk.gripper.parameters import ASKED
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.modbus_link import ModbusLink

__all__ = ["Registers", "RtuLink", "Told"]


def _reading(question: Question) -> modbus_frames.Question:
    return modbus_frames.read(question.instance - 1, (question.size + 1) // 2)


_STATUS: Final = Question(STATUS, SIZE)
_PROBES: Final = tuple(_reading(Question(*ASKED[name])) for name in ("model", "firmware", "lower"))
"""Answers of three sizes, none of them that of a status."""


class Told(NamedTuple):
    """A question, and what was answered to it."""

    question: Question
    data: bytes


class Registers:
    """What a gripper is asked in Modbus; see `crtk_drivers.kit.modbus_link.RegisterMap`."""

    silent = "Is it powered (24 V), and are wiring, baud rate, parity and address right?"
    other = "Is it a SCHUNK EGU, EGK or EZU with Modbus RTU?"

    def __init__(self) -> None:
        self._asked = _STATUS

    def read(self) -> modbus_frames.Question:
        """See `RegisterMap`."""
        return self.write(_STATUS)

    def write(self, command: Question) -> modbus_frames.Question:
        """See `RegisterMap`: whatever is asked, be it read or written."""
        self._asked = command
        return self.aside(command)

    def probe(self, turn: int) -> modbus_frames.Question:
        """See `RegisterMap`."""
        return _PROBES[turn % len(_PROBES)]

    def variant(self, question: modbus_frames.Question) -> None:
        """See `RegisterMap`: all eight registers of the status are needed, and no other function is known."""

    def aside(self, command: Question) -> modbus_frames.Question:
        """See `RegisterMap`."""
        if command.data:
            return modbus_frames.write(command.instance - 1, command.data)
        return _reading(command)

    def status(self, question: modbus_frames.Question, reply: bytes) -> Told | None:
        """See `RegisterMap`; None: that was a probe."""
        if any(question is probe for probe in _PROBES):
            return None
        return Told(self._asked, b"" if self._asked.data else reply[2:])


class RtuLink:
    """See `crtk_driver_schunk.gripper.link.Link`.

    Args:
        link: to the registers of a gripper.
    """

    def __init__(self, link: ModbusLink[Question, Told]) -> None:
        self._link = link
        self.open, self.close, self.shout = link.open, link.close, link.shout

    @property
    def where(self) -> str:
        """See `Link`."""
        return self._link.where

    @property
    def counters(self) -> Mapping[str, float]:
        """See `Link`."""
        return self._link.counters

    @property
    def trouble(self) -> tuple[str, str]:
        """See `Link`."""
        return self._link.trouble

    def exchange(self, question: Question, deadline: float) -> Reply | None:
        """See `Link`."""
        answer = self._link.exchange(question, deadline)
        if answer is None:
            return None
        if answer.status.question == question:
            return Reply(answer.status.data, answer.stamp)
        is_written = question.data and answer.delivered == question
        return Reply(b"", answer.stamp) if is_written else None
