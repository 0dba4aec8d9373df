"""How the devices of other machines are, as seen on ROS: one JSON object a line, over a pipe.

The process that watches them writes these lines, and whoever started it reads them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from crtk_drivers.labs.reports import line_of, read_objects, shortened
from crtk_drivers.samples import ClockOffset

__all__ = ["Seen", "read_seen"]


@dataclass(frozen=True, slots=True)
class Seen:
    """How a device of another machine is. What is not known has its default.

    Attributes:
        name: of the device, in the lab.
        seen: it is there on ROS.
        state: operating state.
        cause: of it, in words.
        is_busy, is_homed: as in the operating state.
        measures: its samples are fresh.
        host: what its machine calls itself.
        offset: seconds that the clock of its machine is ahead of this one's; None: not known yet.
        uncertainty: of that, in seconds.
        ago: seconds since it was seen last, of one that is not seen; None: it never was.
    """

    name: str
    seen: bool
    state: str = ""
    cause: str = ""
    is_busy: bool = False
    is_homed: bool = False
    measures: bool = False
    host: str = ""
    offset: float | None = None
    uncertainty: float | None = None
    ago: float | None = None

    @property
    def is_ready(self) -> bool:
        """Whether what comes after it may start."""
        return self.seen and self.measures

    @property
    def has_other_time(self) -> bool:
        """Whether its clock is surely further from this one's than `CLOCKS_AGREE`."""
        return (
            self.offset is not None and ClockOffset(self.offset, self.uncertainty or 0.0).is_apart
        )

    @property
    def line(self) -> bytes:
        """The same as a line for the pipe, which takes it as a whole or not at all."""
        short = replace(self, cause=shortened(self.cause), host=shortened(self.host))
        return line_of(asdict(short))


def read_seen(descriptor: int, rest: bytes) -> tuple[list[Seen], bytes]:
    """Return what has come of devices, the oldest first, and what has come of the next line.

    Args:
        descriptor: of a pipe, which does not block.
        rest: what had come before of the next line.
    """
    found, rest = read_objects(descriptor, rest)
    return [Seen(**each) for each in found], rest
