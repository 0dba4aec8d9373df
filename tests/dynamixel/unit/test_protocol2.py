"""Protocol 2.0: packets of the manual, the SDK where it is right, and properties where it is not."""

import random

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel import protocol2
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.protocol2 import StatusParser
from rigs.dynamixel_packets import NASTY, Wire, fast_status2, status2

DATA = st.one_of(NASTY, st.binary(max_size=24))
IDS = st.integers(0, 252)
STATUSES = st.builds(
    lambda id, data, number, alert: (id, data, number | alert << 7),
    IDS,
    DATA,
    st.integers(0, 7),
    st.booleans(),
)


def expected(id, data, error):
    return Status(id, error & 0x7F, error >= 0x80, data)


# E-manual, protocol 2.0, the example of each instruction.
MANUAL = {
    "ping": (protocol2.ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
    "ping all": (protocol2.ping(0xFE), "FF FF FD 00 FE 03 00 01 31 42"),
    "read": (protocol2.read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    "write": (
        protocol2.write(1, 116, bytes.fromhex("00 02 00 00")),
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    ),
    "reboot": (protocol2.reboot(1), "FF FF FD 00 01 03 00 08 2F 4E"),
    "sync read": (
        protocol2.sync_read([1, 2], 132, 4),
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    "sync write": (
        protocol2.sync_write(116, 4, {1: bytes.fromhex("96000000"), 2: bytes.fromhex("AA000000")}),
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    "bulk read": (
        protocol2.bulk_read([(1, 144, 2), (2, 146, 1)]),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    "fast sync read": (
        protocol2.fast_sync_read([3, 7, 4], 132, 4),
        "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
    ),
    # The manual prints the CRC of its fast sync read here as well.
    "fast bulk read": (
        protocol2.fast_bulk_read([(3, 132, 4), (7, 124, 2), (4, 146, 1)]),
        "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 DA 2D",
    ),
}


@pytest.mark.parametrize("name", MANUAL)
def test_instructions_of_the_manual(name):
    packet, text = MANUAL[name]
    assert packet == bytes.fromhex(text)


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", Status(1, 0, False, b"\x06\x04\x26")),
        ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", Status(2, 0, False, b"\x06\x04\x26")),
        ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", Status(1, 0, False, b"\xa6\0\0\0")),
        ("FF FF FD 00 01 04 00 55 00 A1 0C", Status(1, 0, False, b"")),
        ("FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE", Status(2, 0, False, b"\x1f\x08\0\0")),
        ("FF FF FD 00 01 06 00 55 00 77 00 C3 69", Status(1, 0, False, b"\x77\0")),
        ("FF FF FD 00 02 05 00 55 00 24 8B A9", Status(2, 0, False, b"\x24")),
    ],
)
def test_statuses_of_the_manual(text, status):
    assert StatusParser().feed(bytes.fromhex(text)) == [status]


@pytest.mark.parametrize("id", [-1, 253, 255, 256])
def test_an_id_that_no_servo_has(id):
    with pytest.raises(ValueError, match="id"):
        protocol2.ping(id)


@pytest.mark.parametrize(
    "call",
    [
        lambda: protocol2.sync_read([1, 1], 132, 4),
        lambda: protocol2.sync_read([], 132, 4),
        lambda: protocol2.sync_read([0xFE], 132, 4),
        lambda: protocol2.bulk_read([(1, 132, 4), (1, 144, 2)]),
        lambda: protocol2.sync_write(116, 4, {1: b"abc"}),
        lambda: protocol2.read(1, -1, 4),
        lambda: protocol2.read(1, 0x10000, 4),
        lambda: protocol2.write(1, 0, bytes(5000)),
    ],
)
def test_what_cannot_be_said_is_refused(call):
    with pytest.raises(ValueError):  # noqa: PT011
        call()


def test_texts_of_errors():
    assert protocol2.error_text(0) == ""
    assert "access" in protocol2.error_text(7)
    assert "99" in protocol2.error_text(99)


@given(id=IDS, address=st.integers(0, 0xFFFF), data=st.binary(min_size=1, max_size=20))
def test_writes_are_those_of_the_sdk_where_nothing_is_stuffed(id, address, data):
    wire = Wire()
    packet = protocol2.write(id, address, data)
    Protocol2PacketHandler().writeTxOnly(wire, id, address, len(data), list(data))
    if protocol2.SEQUENCE not in packet[7:]:
        assert packet == wire.sent


@given(status=STATUSES)
def test_statuses_are_those_of_the_sdk_where_nothing_is_stuffed(status):
    packet = status2(*status)
    if protocol2.SEQUENCE in packet[7:]:
        return
    id, data, error = status
    received, result = Protocol2PacketHandler().rxPacket(Wire(packet), False)
    (ours,) = StatusParser().feed(packet)
    assert result == COMM_SUCCESS
    assert ours == expected(received[4], bytes(received[9:-2]), received[8])
    assert ours == expected(id, data, error)


@given(id=IDS, address=st.integers(0, 0xFFFF), data=DATA)
def test_instructions_are_stuffed_so_that_no_header_is_in_them(id, address, data):
    packet = protocol2.write(id, address, data)
    body = packet[7:-2]
    assert len(packet) == 7 + int.from_bytes(packet[5:7], "little")
    assert body.count(b"\xff\xff\xfd") == body.count(b"\xff\xff\xfd\xfd")
    assert body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd") == (
        b"\x03" + address.to_bytes(2, "little") + data
    )


@given(statuses=st.lists(STATUSES, min_size=1, max_size=4), data=st.data())
def test_statuses_arrive_however_they_are_split(statuses, data):
    stream = b"".join(status2(*status) for status in statuses)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    parser = StatusParser()
    found = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += parser.feed(stream[begin:end])
    assert found == [expected(*status) for status in statuses]
    assert (parser.garbage, parser.bad_crc, parser.pending) == (0, 0, 0)


def test_byte_by_byte():
    stream = status2(1, b"\xff\xff\xfd") + status2(2, b"\xff\xff\xfd\xfd", 0x87)
    parser = StatusParser()
    found = [status for i in range(len(stream)) for status in parser.feed(stream[i : i + 1])]
    assert found == [
        Status(1, 0, False, b"\xff\xff\xfd"),
        Status(2, 7, True, b"\xff\xff\xfd\xfd"),
    ]


@given(status=STATUSES, noise=st.lists(st.one_of(st.binary(max_size=12), NASTY), max_size=3))
def test_garbage_between_packets_costs_no_packet(status, noise):
    """Noise may hold a header that claims bytes of what follows: they are looked at again."""
    parser = StatusParser(longest=64)
    found = []
    for junk in noise:
        found += parser.feed(junk + status2(*status))
    found += parser.finish()
    assert found == [expected(*status)] * len(noise)
    assert parser.pending == 0


@given(statuses=st.lists(STATUSES, min_size=2, max_size=4), data=st.data())
def test_a_changed_byte_costs_its_own_packet(statuses, data):
    packets = [status2(*status) for status in statuses]
    hit = data.draw(st.integers(0, len(packets) - 1))
    at = data.draw(st.integers(0, len(packets[hit]) - 1))
    flip = data.draw(st.integers(1, 255))
    damaged = bytearray(packets[hit])
    damaged[at] ^= flip
    packets[hit] = bytes(damaged)
    parser = StatusParser(longest=64)
    found = parser.feed(b"".join(packets)) + parser.finish()
    good = [expected(*status) for index, status in enumerate(statuses) if index != hit]
    assert found == good
    assert parser.garbage > 0


@given(status=STATUSES, data=st.data())
def test_a_truncated_packet_costs_only_itself(status, data):
    packet = status2(*status)
    cut = data.draw(st.integers(0, len(packet) - 1))
    parser = StatusParser(longest=64)
    found = parser.feed(packet[:cut] + status2(9, b"next")) + parser.finish()
    assert found == [Status(9, 0, False, b"next")]
    assert parser.feed(packet) == [expected(*status)]


def test_the_id_of_a_damaged_or_incomplete_packet_is_known():
    parser = StatusParser()
    packet = status2(5, b"abcd")
    parser.feed(packet[:-1] + b"!")
    assert (parser.bad_crc, parser.corrupt) == (1, [5])
    parser.feed(packet[:-3])
    parser.finish()
    assert parser.corrupt == [5, 5]


@given(status=STATUSES, id=IDS, data=DATA)
def test_an_echo_is_no_status(status, id, data):
    parser = StatusParser()
    assert parser.feed(protocol2.write(id, 116, data) + status2(*status)) == [expected(*status)]
    assert (parser.echoes, parser.garbage) == (1, 0)


def test_the_reply_to_a_fast_read_has_no_stuffing():
    data = b"\x00\x03\xff\xff\xfd\xfd"
    packet = fast_status2([(3, 0, data[2:])])
    (status,) = StatusParser().feed(packet)
    assert status == Status(0xFE, 0, False, packet[9:-2])
    assert status.params.endswith(data[2:])


def test_random_noise_is_not_taken_for_statuses():
    generator = random.Random(5)
    parser = StatusParser(longest=64)
    noise = bytes(generator.choice(b"\xff\xff\xfd\x00\x55\x01\x04") for _ in range(20000))
    assert parser.feed(noise) + parser.finish() == []
    assert parser.garbage == len(noise)
