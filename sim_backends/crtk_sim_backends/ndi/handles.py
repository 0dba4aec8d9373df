"""Port handles, and the tool definitions behind them."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Final

ROM_SIZE: Final = 752
MEMORY: Final = 1024

OCCUPIED, INITIALISED, ENABLED = 1 << 0, 1 << 4, 1 << 5


def make_rom(
    part_number: str,
    kind: int = 2,
    manufacturer: str = "CRTK SIM",
    markers: tuple[tuple[float, float, float], ...] = (
        (0, 0, 0),
        (0, 50, 0),
        (35, 75, 0),
        (0, 100, 0),
    ),
) -> bytes:
    """Return a tool definition: what a wired tool has in its memory, and tests in a file.

    Args:
        part_number: at most 20 characters.
        kind: main type; 1 reference, 2 pointer.
        manufacturer: at most 12 characters.
        markers: x, y, z in mm.
    """
    rom = bytearray(ROM_SIZE)
    rom[0:4] = b"NDI\0"
    rom[8], rom[15], rom[24] = 1, kind, 90
    rom[28], rom[32] = len(markers), 3
    struct.pack_into("<f", rom, 36, 2.0)
    for index, marker in enumerate(markers):
        struct.pack_into("<3f", rom, 72 + 12 * index, *marker)
        struct.pack_into("<3f", rom, 312 + 12 * index, 0.0, 0.0, 1.0)
    rom[580 : 580 + len(manufacturer)] = manufacturer.encode()
    rom[592 : 592 + len(part_number)] = part_number.encode()
    rom[655] = 41
    struct.pack_into("<H", rom, 4, sum(rom[6:]) & 0xFFFF)
    return bytes(rom)


@dataclass
class Handle:
    """One port handle.

    Attributes:
        number: of it.
        tool: which of the tracker's tools is behind it, by its place.
        wired: the tool hangs on a wire, and its definition in its own memory.
        memory: the definition, as far as it was written.
        serial_number: of the tool.
        port, channel: where it is plugged in; 0 of a wireless one.
    """

    number: int
    tool: int
    wired: bool
    memory: bytearray = field(default_factory=lambda: bytearray(MEMORY))
    serial_number: str = ""
    port: int = 0
    channel: int = 0
    initialised: bool = False
    enabled: bool = False

    @property
    def status(self) -> int:
        """As in PHSR, and the low bits of the port status."""
        return OCCUPIED | self.initialised * INITIALISED | self.enabled * ENABLED

    @property
    def is_empty(self) -> bool:
        """Whether there is no definition."""
        return not any(self.memory)

    @property
    def is_sound(self) -> bool:
        """Whether the definition has the right sum."""
        (wanted,) = struct.unpack_from("<H", self.memory, 4)
        found = sum(self.memory[6:ROM_SIZE]) & 0xFFFF
        return self.memory[:4] == b"NDI\0" and found == wanted

    @property
    def part_number(self) -> str:
        """As its definition says."""
        return self.memory[592:612].split(b"\0")[0].decode("ascii", "replace")

    def information(self, options: int) -> str:
        """Return what PHINF says, for the options of this simulator: 0001, 0004, 0008, 0010, 0020."""
        memory = self.memory
        maker = memory[580:592].split(b"\0")[0].decode("ascii", "replace")
        general = (
            f"{memory[15]:02X}000000{maker:<12.12}{0:03d}{self.serial_number:<8.8}{self.status:02X}"
        )
        parts = {
            0x0001: general,
            0x0004: f"{self.part_number:<20.20}",
            0x0008: "00",
            0x0010: f"{memory[655]:02X}",
            0x0020: f"{'00000000':<8}0{0 if self.wired else 1}{self.port:02d}{self.channel:02d}",
        }
        return "".join(text for bit, text in parts.items() if options & bit)
