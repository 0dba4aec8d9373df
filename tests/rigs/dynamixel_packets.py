"""Status packets as servos would send them, from the manual and without the driver's codec."""

from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import strategies as st

BROADCAST = 0xFE
NASTY = st.lists(
    st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0xFE, 0x01]), max_size=24
).map(bytes)
"""Bytes of which headers are made, and what is stuffed."""


def crc(data: bytes) -> bytes:
    """The SDK's table, which is right."""
    return Protocol2PacketHandler().updateCRC(0, data, len(data)).to_bytes(2, "little")


def stuffed(body: bytes) -> bytes:
    out = bytearray()
    for byte in body:
        out.append(byte)
        if out[-3:] == b"\xff\xff\xfd":
            out.append(0xFD)
    return bytes(out)


def status2(id: int, params: bytes = b"", error: int = 0) -> bytes:
    body = stuffed(bytes((0x55, error)) + params)
    packet = b"\xff\xff\xfd\x00" + bytes((id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc(packet)


def status1(id: int, params: bytes = b"", error: int = 0) -> bytes:
    body = bytes((id, len(params) + 2, error)) + params
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def fast_status2(blocks: list[tuple[int, int, bytes]]) -> bytes:
    """Of (id, error, data)."""
    length = 1 + sum(len(data) + 4 for _, _, data in blocks)
    packet = b"\xff\xff\xfd\x00\xfe" + length.to_bytes(2, "little") + b"\x55"
    for id, error, data in blocks:
        packet += bytes((error, id)) + data
        packet += crc(packet)
    return packet


class Wire:
    """A port for the SDK's packet handler: what it sends, and what it is to receive."""

    is_using = False
    baudrate = 1_000_000

    def __init__(self, incoming=b""):
        self.incoming = incoming
        self.sent = b""

    def clearPort(self): ...  # noqa: N802

    def writePort(self, packet):  # noqa: N802
        self.sent += bytes(packet)
        return len(packet)

    def readPort(self, length):  # noqa: N802
        data, self.incoming = self.incoming[:length], self.incoming[length:]
        return data

    def setPacketTimeout(self, length): ...  # noqa: N802

    def isPacketTimeout(self):  # noqa: N802
        return not self.incoming
