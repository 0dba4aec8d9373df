"""Objects of a node read and written by SDO, with typed values and typed errors.

The transfer itself (expedited, segmented, block) is the canopen library's; see `crtk_driver_canopen.bus`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Protocol

from crtk_driver_canopen.objects import Entry, object_text
from crtk_drivers.errors import ConfigError, DataTimeout, DeviceError, ProtocolError

ABORTS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0x05030000: "toggle bit not alternated",
        0x05040000: "protocol timed out",
        0x05040001: "command specifier not valid",
        0x05040002: "block size not valid",
        0x05040003: "sequence number not valid",
        0x05040004: "CRC error",
        0x05040005: "out of memory",
        0x06010000: "access not supported",
        0x06010001: "object can only be written",
        0x06010002: "object can only be read",
        0x06020000: "there is no such object",
        0x06040041: "object cannot be mapped into a PDO",
        0x06040042: "mapped objects are longer than a PDO",
        0x06040043: "parameters are incompatible",
        0x06040047: "internal incompatibility in the device",
        0x06060000: "hardware error",
        0x06070010: "length of the value does not match",
        0x06070012: "value is too long",
        0x06070013: "value is too short",
        0x06090011: "there is no such sub-index",
        0x06090030: "value is not valid",
        0x06090031: "value is too high",
        0x06090032: "value is too low",
        0x06090036: "maximum is less than minimum",
        0x060A0023: "resource not available",
        0x08000000: "general error",
        0x08000020: "value cannot be stored",
        0x08000021: "value cannot be stored: local control",
        0x08000022: "value cannot be stored in this state of the device",
        0x08000023: "no object dictionary",
        0x08000024: "no data available",
    }
)
"""CiA 301, 7.2.4.3.17, SDO abort codes."""

MISSING: Final = frozenset({0x06020000, 0x06090011})
"""Abort codes that say that there is no such object."""

WRITE_ONLY: Final = frozenset({0x06010000, 0x06010001})
"""Abort codes of a read that say that the object can only be written."""


def abort_text(code: int) -> str:
    """Return what an abort code says."""
    return ABORTS.get(code, "unknown reason")


class SdoAborted(DeviceError):
    """A node answered that it cannot read or write an object.

    Args:
        message: what happened.
        where: the node and its bus.
        remedy: what to do next.
        code: of the abort.
    """

    def __init__(self, message: str, *, where: str = "", remedy: str = "", code: int = 0) -> None:
        super().__init__(message, where=where, remedy=remedy)
        self.code = code


class SdoSilent(DataTimeout):
    """A node did not answer an SDO in time."""


class ObjectIgnored(DeviceError):
    """A node acknowledged a value and holds another one."""


class SdoPort(Protocol):
    """What carries out transfers with one node.

    Both methods raise `SdoAborted`, `SdoSilent` or `crtk_drivers.errors.ProtocolError`.
    """

    @property
    def where(self) -> str:
        """The node and its bus, for errors."""
        ...

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object."""
        ...

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object."""
        ...


def aborted(where: str, what: str, index: int, sub: int, code: int) -> SdoAborted:
    """Return the error of an abort.

    Args:
        what: ``read`` or ``write``.
    """
    return SdoAborted(
        f"{what} of {object_text(index, sub)} refused: {abort_text(code)} (abort 0x{code:08x})",
        where=where,
        remedy="Check the object against the manual of the drive and the state that it is in.",
        code=code,
    )


def silent(where: str, what: str, index: int, sub: int) -> SdoSilent:
    """Return the error of an answer that did not come."""
    return SdoSilent(
        f"{what} of {object_text(index, sub)}: no answer",
        where=where,
        remedy="Check power, cable, node id and bit rate: 'crtk-driver canopen scan' shows who answers.",
    )


class Sdo:
    """Typed access to the objects of one node.

    Args:
        port: carries out the transfers.
        axis: of a node with several: objects from 6000h on are those of this axis.
    """

    def __init__(self, port: SdoPort, axis: int = 0) -> None:
        self.port = port
        self.axis = axis

    @property
    def where(self) -> str:
        """The node and its bus, for errors."""
        return self.port.where

    def read(self, entry: Entry) -> int:
        """Return the value of a whole-number object.

        Raises:
            SdoAborted, SdoSilent: it could not be read.
            ProtocolError: too few bytes came.
        """
        entry = entry.on_axis(self.axis)
        data = self.port.upload(entry.index, entry.sub)
        try:
            return int(entry.type.unpack(data))
        except ValueError as error:
            raise ProtocolError(
                f"{entry}: {error}",
                where=self.where,
                remedy="Check the type of the object in the manual of the drive.",
            ) from error

    def read_text(self, entry: Entry) -> str:
        """Return the value of a text object.

        Raises:
            SdoAborted, SdoSilent: it could not be read.
        """
        entry = entry.on_axis(self.axis)
        return str(entry.type.unpack(self.port.upload(entry.index, entry.sub)))

    def find(self, entry: Entry) -> int | None:
        """Return the value of a whole-number object, None if the node has no such object.

        Raises:
            SdoAborted, SdoSilent, ProtocolError: as `read`.
        """
        try:
            return self.read(entry)
        except SdoAborted as error:
            if error.code in MISSING:
                return None
            raise

    def has(self, entry: Entry) -> bool:
        """Return whether the node has an object, whether it can be read or not.

        Raises:
            SdoAborted, SdoSilent: neither was said.
        """
        entry = entry.on_axis(self.axis)
        try:
            self.port.upload(entry.index, entry.sub)
        except SdoAborted as error:
            if error.code not in MISSING | WRITE_ONLY:
                raise
            return error.code in WRITE_ONLY
        return True

    def offer(self, entry: Entry, value: int) -> bool:
        """Write a whole-number object if the node has it; return whether it does.

        Raises:
            SdoAborted, SdoSilent, ConfigError: as `write`.
        """
        try:
            self.write(entry, value)
        except SdoAborted as error:
            if error.code not in MISSING:
                raise
            return False
        return True

    def write(self, entry: Entry, value: int) -> None:
        """Write a whole-number object.

        Raises:
            SdoAborted, SdoSilent: it could not be written.
            ConfigError: it does not fit into the object.
        """
        entry = entry.on_axis(self.axis)
        try:
            data = entry.type.pack(value)
        except ValueError as error:
            raise ConfigError(
                f"{entry}: {error}",
                where=self.where,
                remedy="Correct the value, or the units of the joint, in the configuration.",
            ) from error
        self.port.download(entry.index, entry.sub, data)

    def ensure(self, entry: Entry, value: int, remedy: str = "") -> bool:
        """Make an object hold `value`: write it unless it does already, and read it back.

        Returns:
            Whether it holds the value; False where it can only be written, which nobody can check.

        Raises:
            ObjectIgnored: the node acknowledged it and holds another value.
            SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
        """
        try:
            if self.read(entry) == value:
                return True
        except SdoAborted as error:
            if error.code not in WRITE_ONLY:
                raise
            self.write(entry, value)
            return False
        self.write(entry, value)
        found = self.read(entry)
        if found != value:
            raise ObjectIgnored(
                f"{entry.on_axis(self.axis)}: {value} was acknowledged, but the node holds {found}",
                where=self.where,
                remedy=remedy or "Check in the manual of the drive what the object accepts.",
            )
        return True
