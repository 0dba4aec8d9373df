"""The codec of the DYNAMIXEL driver beside dynamixel-sdk: what a group costs, and values that arrive wrong.

The frames of the second table are statuses with ten bytes of data, made byte by byte from the manual.
"Stuffing": data full of FF, FD and 00. "Damaged": as well, and behind their length one to three bits are
changed, or a burst of up to 16, all of which the CRC tells. "Noise": random bytes before a frame.
Corrupted: taken as good with other data than were sent. Lost: not taken though they arrived undamaged.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from typing import Any

from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler

from bench.report import options, show, show_calls
from crtk_driver_dynamixel import protocol2
from crtk_driver_dynamixel.crc import crc16, table_crc16
from crtk_driver_dynamixel.group_replies import PlainReplies
from crtk_driver_dynamixel.protocol2 import StatusParser

LENGTH = 10
TRICKY = (0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00)
HEAD = 9


def status(id: int, data: bytes) -> bytes:
    """Return a status packet, with stuffing byte by byte."""
    body = bytearray()
    for byte in b"\x55\x00" + data:
        body.append(byte)
        if body[-3:] == b"\xff\xff\xfd":
            body.append(0xFD)
    packet = b"\xff\xff\xfd\x00" + bytes((id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + table_crc16(packet).to_bytes(2, "little")


def tricky(generator: random.Random) -> bytes:
    """Return data full of what needs stuffing."""
    return bytes(generator.choices(TRICKY, k=LENGTH))


def damaged(packet: bytes, generator: random.Random) -> bytes:
    """Return a packet that the CRC proves to be damaged."""
    bits = 8 * (len(packet) - HEAD)
    number = int.from_bytes(packet[HEAD:], "big")
    if generator.random() < 0.5:
        for at in generator.sample(range(bits), generator.choice((1, 2, 3))):
            number ^= 1 << at
    else:
        width = generator.randrange(1, 17)
        burst = generator.getrandbits(width) | 1 | 1 << (width - 1)
        number ^= burst << generator.randrange(16, bits - width + 1)  # not across the swapped CRC
    return packet[:HEAD] + number.to_bytes(len(packet) - HEAD, "big")


class Line:
    """A port for the SDK's packet handler, which reads what it is given."""

    is_using = False

    def __init__(self) -> None:
        self.data = b""

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return the next bytes."""
        data, self.data = self.data[:length], self.data[length:]
        return data

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Return whether nothing is left."""
        return not self.data


class Ours:
    """Our parser."""

    def __init__(self) -> None:
        self.parser = StatusParser(longest=64)

    def take(self, data: bytes) -> list[bytes]:
        """Return the data of the statuses in `data`."""
        return [s.params for s in (*self.parser.feed(data), *self.parser.finish())]


class Sdk:
    """The receiver of dynamixel-sdk."""

    def __init__(self) -> None:
        self.line = Line()
        self.handler = Protocol2PacketHandler()

    def take(self, data: bytes) -> list[bytes]:
        """Return the data of the status in `data`."""
        self.line.data = data
        packet, result = self.handler.rxPacket(self.line, False)
        if result != COMM_SUCCESS:
            return []
        length = packet[5] | packet[6] << 8
        return [bytes(packet[HEAD : 7 + length - 2])]


def frames(kind: str, count: int, seed: int) -> Iterator[tuple[bytes, bytes | None]]:
    """Yield what arrives, and the data in it; None if it is damaged."""
    generator = random.Random(seed)
    for _ in range(count):
        data = tricky(generator)
        packet = status(1, data)
        if kind == "damaged":
            yield damaged(packet, generator), None
        elif kind == "noise":
            yield generator.randbytes(generator.randrange(1, 9)) + packet, data
        else:
            yield packet, data


def judge(take: Callable[[bytes], list[bytes]], kind: str, count: int) -> tuple[int, int, float]:
    """Return how many values came as others, how many were lost, and the seconds for all."""
    corrupted = lost = 0
    spent = 0.0
    for packet, data in frames(kind, count, 1):
        begin = time.perf_counter()
        found = take(packet)
        spent += time.perf_counter() - begin
        corrupted += any(value != data for value in found)
        lost += data is not None and not found
    return corrupted, lost, spent


def sent(count: int) -> int:
    """Return how many writes the SDK does not stuff though they need it."""

    class Wire(Line):
        sent = b""

        def clearPort(self) -> None:  # noqa: N802
            """Forget what has arrived."""

        def writePort(self, packet: Any) -> int:  # noqa: N802
            """Take a packet."""
            self.sent = bytes(packet)
            return len(packet)

    generator = random.Random(2)
    wire, handler = Wire(), Protocol2PacketHandler()
    wrong = 0
    for _ in range(count):
        data = tricky(generator)
        wire.is_using = False
        handler.writeTxOnly(wire, 1, 100, LENGTH, list(data))
        wrong += wire.sent != protocol2.write(1, 100, data)
    return wrong


def show_costs(calls: int) -> None:
    """Print what reading one group costs."""
    usual = b"\x12\x00\x34\x00\x00\x00\x08\x00\x00\x00"
    cases: dict[str, Callable[[], object]] = {}
    for count in (6, 12, 24):
        blocks = [(id, LENGTH) for id in range(1, count + 1)]
        stream = b"".join(status(id, usual) for id, _ in blocks)
        plain, parser = PlainReplies(blocks), StatusParser()
        cases[f"{count} replies, as expected"] = lambda p=plain, s=stream: p.whole(s)  # type: ignore[misc]
        cases[f"{count} replies, searched"] = lambda p=parser, s=stream: p.feed(s)  # type: ignore[misc]
    packet = status(1, usual)
    sdk = Sdk()
    cases["1 reply, dynamixel-sdk"] = lambda: sdk.take(packet)
    cases["CRC of 21 bytes, chosen"] = lambda: crc16(packet)
    cases["CRC of 21 bytes, table"] = lambda: table_crc16(packet)
    show_calls("Replies of a group", cases, calls)


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        frames=(1_000_000, "of which a third of each kind"),
        calls=(2000, "in each round"),
    )
    show_costs(int(given.calls))
    count = int(given.frames) // 3
    rows = []
    for kind in ("stuffing", "damaged", "noise"):
        for name, client in (("ours", Ours()), ("dynamixel-sdk", Sdk())):
            corrupted, lost, spent = judge(client.take, kind, count)
            each = spent / count * 1e6
            rows.append((f"{kind}: {name}", f"{count}", f"{corrupted}", f"{lost}", f"{each:.1f}"))
    wrong = sent(count // 10)
    notes = [
        f"of {count // 10} writes of such values the SDK sends {wrong} as other bytes than ours."
    ]
    columns = ("frames", "number", "corrupted", "lost", "µs each")
    show("Adversarial frames", columns, rows, notes)


if __name__ == "__main__":
    main()
