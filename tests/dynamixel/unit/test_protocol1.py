"""Protocol 1.0: packets of the manual, the SDK, and properties of the parser."""

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol1PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel import protocol1
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.protocol1 import StatusParser
from rigs.dynamixel_packets import Wire, status1

IDS = st.integers(0, 252)
STATUSES = st.tuples(IDS, st.binary(max_size=12), st.integers(0, 0x7F))


def expected(id, data, error):
    hardware = error & 0x25
    return Status(id, error & ~0x25, hardware != 0, data, hardware)


# E-manual, protocol 1.0, the examples of the instructions.
MANUAL = {
    "ping": (protocol1.ping(1), "FF FF 01 02 01 FB"),
    "read": (protocol1.read(1, 43, 1), "FF FF 01 04 02 2B 01 CC"),
    "write": (protocol1.write(0xFE, 3, b"\x01"), "FF FF FE 04 03 03 01 F6"),
    "sync write": (
        protocol1.sync_write(
            0x1E,
            4,
            {
                0: bytes.fromhex("10 00 50 01"),
                1: bytes.fromhex("20 02 60 03"),
                2: bytes.fromhex("30 00 70 01"),
                3: bytes.fromhex("20 02 80 03"),
            },
        ),
        "FF FF FE 18 83 1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03 12",
    ),
    "bulk read": (
        protocol1.bulk_read([(1, 0x1E, 2), (2, 0x24, 2)]),
        "FF FF FE 09 92 00 02 01 1E 02 02 24 1D",
    ),
}


@pytest.mark.parametrize("name", MANUAL)
def test_instructions_of_the_manual(name):
    packet, text = MANUAL[name]
    assert packet == bytes.fromhex(text)


def test_statuses_of_the_manual():
    parser = StatusParser()
    assert parser.feed(bytes.fromhex("FF FF 01 03 00 20 DB")) == [Status(1, 0, False, b"\x20")]
    assert parser.feed(bytes.fromhex("FF FF 01 02 24 D8")) == [Status(1, 0, True, b"", 0x24)]


def test_reboot_has_its_code():
    assert protocol1.reboot(7)[4] == 0x08


@pytest.mark.parametrize(
    "call",
    [
        lambda: protocol1.ping(255),
        lambda: protocol1.read(1, 256, 1),
        lambda: protocol1.write(1, 0, bytes(254)),
        lambda: protocol1.bulk_read([(1, 30, 2), (1, 36, 2)]),
        lambda: protocol1.sync_write(30, 2, {}),
        lambda: protocol1.sync_write(30, 2, {1: b"a"}),
        lambda: protocol1.sync_write(30, 2, {0xFE: b"ab"}),
    ],
)
def test_what_cannot_be_said_is_refused(call):
    with pytest.raises(ValueError):  # noqa: PT011
        call()


def test_texts_of_errors():
    assert protocol1.error_text(0) == ""
    assert "overheating" in protocol1.error_text(0x24)
    assert "overload" in protocol1.error_text(0x24)


@given(id=IDS, address=st.integers(0, 255), data=st.binary(min_size=1, max_size=20))
def test_writes_are_those_of_the_sdk(id, address, data):
    wire = Wire()
    Protocol1PacketHandler().writeTxOnly(wire, id, address, len(data), list(data))
    assert protocol1.write(id, address, data) == wire.sent


@given(status=STATUSES)
def test_statuses_are_those_of_the_sdk(status):
    packet = status1(*status)
    received, result = Protocol1PacketHandler().rxPacket(Wire(packet))
    assert result == COMM_SUCCESS
    (ours,) = StatusParser().feed(packet)
    assert ours == expected(received[2], bytes(received[5:-1]), received[4]) == expected(*status)


@given(statuses=st.lists(STATUSES, min_size=1, max_size=4), data=st.data())
def test_statuses_arrive_however_they_are_split(statuses, data):
    stream = b"".join(status1(*status) for status in statuses)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    parser = StatusParser()
    found = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += parser.feed(stream[begin:end])
    assert found == [expected(*status) for status in statuses]
    assert (parser.garbage, parser.bad_crc, parser.pending) == (0, 0, 0)


def test_noise_and_damage_cost_only_themselves():
    parser = StatusParser(longest=32)
    damaged = bytearray(status1(4, b"\x10\x20"))
    damaged[5] ^= 1
    found = parser.feed(b"\xff\x00" + status1(3, b"\x01") + damaged + status1(5, b"\x02"))
    assert found == [Status(3, 0, False, b"\x01"), Status(5, 0, False, b"\x02")]
    assert (parser.bad_crc, parser.corrupt) == (1, [4])
    assert parser.feed(status1(6, b"\x03")[:-1]) == []
    assert parser.finish() == []
    assert parser.corrupt == [4, 6]
    assert parser.feed(status1(6)) == [Status(6, 0, False, b"")]


def test_an_echo_is_told_from_a_status_by_what_follows():
    request = protocol1.ping(1)
    assert request == status1(1, b"", 0x01)  # a status with a voltage error looks the same
    parser = StatusParser()
    parser.expect_echo(request)
    assert parser.feed(request) == []
    assert parser.feed(status1(1)) == [Status(1, 0, False, b"")]
    assert parser.echoes == 1

    parser.expect_echo(request)
    assert parser.feed(request) == []
    assert parser.finish() == [Status(1, 0, True, b"", 0x01)]
    assert parser.echoes == 1
