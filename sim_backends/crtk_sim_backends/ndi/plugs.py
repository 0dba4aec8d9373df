"""What is plugged into a simulated tracker, as its option `wired` says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

WITHOUT_MEMORY = "?"


class Sensor(NamedTuple):
    """One sensor of a wired tool.

    Attributes:
        part_number: in the memory of its plug; empty where that has none.
        port: where it is plugged in, from 1.
        channel: of it at that plug, from 0.
    """

    part_number: str
    port: int
    channel: int

    @property
    def serial_number(self) -> str:
        """Of the tool: all of its sensors have it."""
        return f"{0x34000000 + self.port - 1:08X}" if self.part_number else ""


def sensors_of(wired: str) -> Sequence[Sensor]:
    """Return the sensors of ``PART,PART*2,,?``: a plug each; two channels; an empty port; one without memory.

    Raises:
        ValueError: a plug is none of these.
    """
    found: list[Sensor] = []
    for port, each in enumerate(wired.split(","), start=1):
        if not each:
            continue
        match = re.fullmatch(r"([^*]{1,20})(\*2)?", each)
        if match is None:
            raise ValueError(f"wired: {each!r} is no part number, nor one with *2 behind it")
        part_number = "" if match[1] == WITHOUT_MEMORY else match[1]
        found += [Sensor(part_number, port, channel) for channel in range(2 if match[2] else 1)]
    return found
