"""The two protocols by number, and what both can say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Protocol

from crtk_driver_dynamixel import protocol1, protocol2


class Codec(Protocol):
    """What `protocol1` and `protocol2` have in common."""

    @property
    def TAIL(self) -> int:  # noqa: N802
        """Bytes of the CRC or checksum."""
        ...

    def ping(self, id: int) -> bytes:
        """Ask whether it is there."""
        ...

    def read(self, id: int, address: int, length: int) -> bytes:
        """Ask for bytes from an address."""
        ...

    def write(self, id: int, address: int, data: bytes) -> bytes:
        """Write."""
        ...

    def reboot(self, id: int) -> bytes:
        """Restart."""
        ...

    def bulk_read(self, items: Sequence[tuple[int, int, int]]) -> bytes:
        """Ask several for (id, address, length)."""
        ...

    def sync_write(self, address: int, length: int, values: Mapping[int, bytes]) -> bytes:
        """Write the same range of several."""
        ...

    def seal(self, unsealed: bytes | bytearray) -> bytes:
        """Complete a packet that lacks its last bytes."""
        ...

    def status_size(self, parameters: int) -> int:
        """Return the bytes of a status."""
        ...

    def error_text(self, error: int) -> str:
        """Return what the error of a status says."""
        ...


PROTOCOLS: Final[Mapping[int, Codec]] = MappingProxyType({1: protocol1, 2: protocol2})
