"""What a servo answered, or why there is no answer; and the errors that are made of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from crtk_driver_dynamixel.protocols import PROTOCOLS
from crtk_drivers.errors import DataTimeout, DeviceError, ProtocolError


class Failure(StrEnum):
    """Why a servo's data are missing."""

    SILENT = "silent"
    """No status arrived in the time of its slot."""

    CORRUPT = "corrupt"
    """A status arrived damaged."""

    REFUSED = "refused"
    """The servo answered with an error number and without data."""

    LEFT_OUT = "left_out"
    """It was not waited for this time: it was silent several times in a row, or several before it were."""


class Reply(NamedTuple):
    """The answer of one servo.

    Attributes:
        id: of the servo.
        data: None if it failed; empty for an instruction that has none.
        error: number (protocol 2.0) or bits (1.0) of what was wrong with the request, 0 if nothing was.
        alert: whether the servo reports a hardware error.
        failure: why there are no data; None if there are.
        hardware: bits of the hardware error, if they came with the status: protocol 1.0 only.
    """

    id: int
    data: bytes | None
    error: int = 0
    alert: bool = False
    failure: Failure | None = None
    hardware: int = 0


@dataclass(slots=True)
class Counters:
    """What came from one servo since the bus was made.

    Attributes:
        replies: valid ones.
        timeouts: times that it was silent.
        corrupt: damaged ones.
        refused: replies with an error number.
        alerts: replies with the alert bit.
        strays: replies that nothing had asked for: late, doubled, or of another length.
    """

    replies: int = 0
    timeouts: int = 0
    corrupt: int = 0
    refused: int = 0
    alerts: int = 0
    strays: int = 0

    def take(self, failure: Failure | None = None, *, error: int = 0, alert: bool = False) -> None:
        """Count a reply, or why there was none."""
        self.replies += failure in (None, Failure.REFUSED)
        self.timeouts += failure is Failure.SILENT
        self.corrupt += failure is Failure.CORRUPT
        self.refused += error != 0
        self.alerts += alert


class ServoSilent(DataTimeout):
    """A servo did not answer."""


class ServoCorrupt(ProtocolError):
    """What a servo answered arrived damaged."""


class ServoRefused(DeviceError):
    """A servo answered that it cannot do what it was asked.

    Attributes:
        error: number (protocol 2.0) or bits (1.0).
    """

    error = 0


def failure_error(reply: Reply, what: str, where: str, protocol: int) -> DeviceError | DataTimeout:
    """Return the error that says why `reply` has no data.

    Args:
        what: was asked, for example ``read of 4 bytes at 132``.
        where: the port.
    """
    servo = f"id {reply.id}: {what}"
    if reply.failure is Failure.REFUSED:
        error = ServoRefused(
            f"{servo} refused: {PROTOCOLS[protocol].error_text(reply.error)}",
            where=where,
            remedy="Check the address and value against the control table of its model and firmware.",
        )
        error.error = reply.error
        return error
    if reply.failure is Failure.CORRUPT:
        return ServoCorrupt(
            f"{servo}: the answer arrived damaged",
            where=where,
            remedy="Look for two servos of one id, a loose cable, or a rate too high for its length.",
        )
    return ServoSilent(
        f"{servo}: no answer",
        where=where,
        remedy="Check its power, cable, id and baud rate: 'crtk-driver dynamixel scan' shows who answers.",
    )
