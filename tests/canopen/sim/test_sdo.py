"""The SDO server of the simulated drive, frame by frame (CiA 301, 7.2.4)."""

import binascii
import struct

import pytest

from crtk_sim_backends.canopen.personality import PERSONALITIES
from rigs.canopen_drive import NODE, Aborted, Bench

DEVICE_NAME = b"CRTK simulated drive"


@pytest.fixture
def bench():
    return Bench()


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # 4 bytes up
        ("40 17 10 00 00 00 00 00", "4b 17 10 00 00 00 00 00"),  # 2 bytes
        ("40 01 10 00 00 00 00 00", "4f 01 10 00 00 00 00 00"),  # 1 byte
        ("2b 17 10 00 e8 03 00 00", "60 17 10 00 00 00 00 00"),  # 2 bytes down
        ("23 7a 60 00 ff ff ff ff", "60 7a 60 00 00 00 00 00"),
        ("2f 60 60 00 08 00 00 00", "60 60 60 00 00 00 00 00"),
        ("22 7a 60 00 01 02 03 04", "60 7a 60 00 00 00 00 00"),  # size not indicated
        ("40 08 10 00 00 00 00 00", "41 08 10 00 14 00 00 00"),  # segmented: 20 bytes
    ],
)
def test_initiates(bench, request_, answer):
    assert bench.ask(request_) == answer


@pytest.mark.parametrize(
    ("request_", "abort"),
    [
        ("40 00 30 00 00 00 00 00", 0x06020000),  # no object
        ("40 18 10 09 00 00 00 00", 0x06090011),  # no sub-index
        ("23 00 10 00 00 00 00 00", 0x06010002),  # read-only
        ("2f 17 10 00 00 00 00 00", 0x06070013),  # too short
        ("23 17 10 00 00 00 00 00", 0x06070012),  # too long
        ("2b 5a 60 00 09 00 00 00", 0x06090031),  # value too high
        ("2b 5a 60 00 ff ff 00 00", 0x06090032),  # value too low
        ("2f 60 60 00 02 00 00 00", 0x06090030),  # mode that does not exist
        ("2f 98 60 00 0f 00 00 00", 0x06090030),  # homing method 15 is reserved
        ("2f 19 10 00 01 00 00 00", 0x06090030),  # SYNC counter of 1
        ("40 03 10 01 00 00 00 00", 0x08000024),  # no error in the history
        ("23 10 10 01 00 00 00 00", 0x08000020),  # store without its signature
        ("23 05 10 00 80 00 00 40", 0x06090030),  # produces no SYNC
        ("60 00 00 00 00 00 00 00", 0x05040001),  # segment of no transfer
        ("00 00 00 00 00 00 00 00", 0x05040001),
        ("e0 17 10 00 00 00 00 00", 0x05040001),  # no such command
        ("a2 00 00 00 00 00 00 00", 0x05040001),  # block answers without a block
        ("a3 00 00 00 00 00 00 00", 0x05040001),
        ("c1 00 00 00 00 00 00 00", 0x05040001),
        ("a0 08 10 00 00 00 00 00", 0x05040002),  # block of 0 segments
        ("a0 08 10 00 80 00 00 00", 0x05040002),  # and of 128
    ],
)
def test_refuses(bench, request_, abort):
    answer = bytes.fromhex(bench.ask(request_))
    assert answer[0] == 0x80
    assert answer[1:4] == bytes.fromhex(request_)[1:4]
    assert int.from_bytes(answer[4:], "little") == abort


def test_heartbeat_of_a_node_is_consumed_once(bench):
    bench.write(0x1016, 1, 0x007F03E8)
    assert bench.abort_of(bench.write, 0x1016, 2, 0x007F03E8) == 0x06040043
    bench.write(0x1016, 2, 0x007E03E8)


def test_limits_must_not_cross(bench):
    bench.write(0x607D, 2, -1000, "i")
    assert bench.abort_of(bench.write, 0x607D, 1, 0, "i") == 0x06090036
    bench.write(0x607D, 1, -2000, "i")


def upload_segments(bench):
    data, toggle = b"", 0
    while True:
        answer = bytes.fromhex(bench.ask(f"{0x60 | toggle << 4:02x} 00 00 00 00 00 00 00"))
        assert answer[0] >> 4 & 1 == toggle
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        if answer[0] & 1:
            return data
        toggle ^= 1


def test_segmented_upload(bench):
    bench.ask("40 08 10 00 00 00 00 00")
    assert upload_segments(bench) == DEVICE_NAME
    assert bench.ask("60 00 00 00 00 00 00 00")[:2] == "80"  # it has ended


def test_toggle_that_does_not_toggle_aborts(bench):
    bench.ask("40 08 10 00 00 00 00 00")
    bench.ask("60 00 00 00 00 00 00 00")
    assert bench.ask("60 00 00 00 00 00 00 00") == "80 08 10 00 00 00 03 05"


def test_segmented_download(bench):
    assert bench.ask("21 00 20 00 0a 00 00 00") == "60 00 20 00 00 00 00 00"
    assert bench.ask("00 01 02 03 04 05 06 07") == "20 00 00 00 00 00 00 00"
    assert bench.ask("19 08 09 0a 00 00 00 00") == "30 00 00 00 00 00 00 00"
    assert bench.drive.dictionary.values[0x2000, 0] == bytes(range(1, 11))


@pytest.mark.parametrize(
    ("size", "last", "abort"),
    [(8, "11 08 09 0a 0b 0c 0d 0e", 0x06070012), (20, "11 08 09 0a 0b 0c 0d 0e", 0x06070013)],
)
def test_segmented_download_of_another_length(bench, size, last, abort):
    bench.ask(f"21 00 20 00 {size:02x} 00 00 00")
    bench.ask("00 01 02 03 04 05 06 07")
    assert bench.ask(last) == "80 00 20 00 " + struct.pack("<I", abort).hex(" ")


def test_segmented_download_of_a_number_of_the_wrong_size(bench):
    assert bench.ask("21 17 10 00 04 00 00 00") == "80 17 10 00 12 00 07 06"


def test_domain_has_an_end(bench):
    request = struct.pack("<BHBI", 0x21, 0x2000, 0, 1 << 20).hex(" ")
    assert bench.ask(request) == "80 00 20 00 05 00 04 05"


def block_upload(bench, block, crc=4):
    """Upload 1021 in blocks of `block` segments."""
    answer = bytes.fromhex(bench.ask(f"{0xA0 | crc:02x} 21 10 00 {block:02x} 00 00 00"))
    assert answer[:4] == bytes((0xC6, 0x21, 0x10, 0))
    size = int.from_bytes(answer[4:], "little")
    data, request = b"", "a3 00 00 00 00 00 00 00"
    while True:
        segments = [bytes.fromhex(d) for _, d in bench.frame(0x600 + NODE, request)]
        assert [s[0] & 0x7F for s in segments] == list(range(1, len(segments) + 1))
        assert len(segments) <= block
        data += b"".join(s[1:] for s in segments)
        request = f"a2 {len(segments):02x} {block:02x} 00 00 00 00 00"
        if segments[-1][0] & 0x80:
            break
    end = bytes.fromhex(bench.ask(request))
    assert end[0] & 0xE3 == 0xC1
    data = data[: len(data) - (end[0] >> 2 & 7)]
    assert len(data) == size
    assert bench.frame(0x600 + NODE, "a1 00 00 00 00 00 00 00") == []
    return data, int.from_bytes(end[1:3], "little")


@pytest.mark.parametrize("block", [1, 20, 127])
def test_block_upload(bench, block):
    data, crc = block_upload(bench, block)
    assert data == bench.drive.dictionary.read(0x1021, 0)
    assert crc == binascii.crc_hqx(data, 0)


def test_block_upload_sends_again_what_was_lost(bench):
    bench.ask("a4 21 10 00 05 00 00 00")
    first = bench.frame(0x600 + NODE, "a3 00 00 00 00 00 00 00")
    again = bench.frame(0x600 + NODE, "a2 02 05 00 00 00 00 00")
    assert [d[3:] for _, d in again[:3]] == [d[3:] for _, d in first[2:]]
    assert again[0][1].startswith("01 ")


def test_block_upload_of_little_is_no_block_upload(bench):
    assert bench.ask("a4 17 10 00 7f 04 00 00") == "4b 17 10 00 00 00 00 00"


def begin_block_download(bench, data, crc=True):
    request = struct.pack("<BHBI", 0xC6 if crc else 0xC2, 0x2000, 0, len(data))
    assert bench.ask(request.hex(" ")) == "a4 00 20 00 7f 00 00 00"
    pieces = [data[n : n + 7].ljust(7, b"\0") for n in range(0, len(data), 7)]
    return [
        bytes((n % 127 + 1 | (0x80 if n + 1 == len(pieces) else 0),)) + piece
        for n, piece in enumerate(pieces)
    ]


def end_block_download(bench, data, crc=None):
    crc = binascii.crc_hqx(data, 0) if crc is None else crc
    return bench.ask(struct.pack("<BH5x", 0xC1 | (-len(data) % 7) << 2, crc).hex(" "))


@pytest.mark.parametrize("size", [1, 7, 8, 889, 890, 2000])
def test_block_download(bench, size):
    data = bytes(n * 7 & 0xFF for n in range(size))
    answers = []
    for segment in begin_block_download(bench, data):
        answers += bench.frame(0x600 + NODE, segment)
    assert [answer for _, answer in answers] == [
        f"a2 {n:02x} 7f 00 00 00 00 00"
        for n in [127] * (-(-size // 7) // 127) + [-(-size // 7) % 127] * bool(-(-size // 7) % 127)
    ]
    assert end_block_download(bench, data) == "a1 00 00 00 00 00 00 00"
    assert bench.drive.dictionary.values[0x2000, 0] == data


def test_block_download_asks_again_for_what_was_lost(bench):
    data = bytes(range(35))
    segments = begin_block_download(bench, data)
    del segments[2]
    answers = [a for segment in segments for a in bench.frame(0x600 + NODE, segment)]
    assert answers == [(0x580 + NODE, "a2 02 7f 00 00 00 00 00")]
    for n in (3, 4, 5):  # the rest once more, numbered anew
        last = 0x80 if n == 5 else 0
        answers = bench.frame(0x600 + NODE, bytes((n - 2 | last,)) + data[7 * n - 7 : 7 * n])
    assert answers == [(0x580 + NODE, "a2 03 7f 00 00 00 00 00")]
    assert end_block_download(bench, data).startswith("a1")
    assert bench.drive.dictionary.values[0x2000, 0] == data


def test_block_download_with_a_wrong_crc(bench):
    data = bytes(10)
    for segment in begin_block_download(bench, data):
        bench.frame(0x600 + NODE, segment)
    assert end_block_download(bench, data, crc=0x1234) == "80 00 20 00 04 00 04 05"
    assert bench.drive.dictionary.values[0x2000, 0] == b""


def test_block_download_with_a_segment_number_of_none(bench):
    begin_block_download(bench, bytes(100))
    answer = bench.frame(0x600 + NODE, "00 00 00 00 00 00 00 00")
    assert answer == [(0x580 + NODE, "80 00 20 00 03 00 04 05")]


def test_drive_without_block_transfer_says_so():
    bench = Bench(personality=PERSONALITIES["plain"])
    bench.run(1.0)
    assert bench.ask("c2 00 20 00 05 00 00 00") == "80 00 20 00 01 00 04 05"
    assert bench.ask("a4 08 10 00 7f 00 00 00") == "80 08 10 00 01 00 04 05"


def test_client_that_falls_silent_is_told_of_the_timeout(bench):
    bench.ask("40 08 10 00 00 00 00 00")
    bench.run(0.9)
    assert bench.take(0x580 + NODE) == []
    bench.run(0.2)
    assert [d.hex(" ") for d in bench.take(0x580 + NODE)] == ["80 08 10 00 00 00 04 05"]


def test_client_that_aborts_has_no_answer(bench):
    bench.ask("40 08 10 00 00 00 00 00")
    assert bench.frame(0x600 + NODE, "80 08 10 00 00 00 00 08") == []
    assert bench.ask("60 00 00 00 00 00 00 00")[:2] == "80"


def test_new_transfer_ends_the_old_one(bench):
    bench.ask("40 08 10 00 00 00 00 00")
    assert bench.ask("40 00 10 00 00 00 00 00").startswith("43")
    assert bench.ask("60 00 00 00 00 00 00 00")[:2] == "80"


@pytest.mark.parametrize("length", [0, 1, 7])
def test_frames_that_are_no_sdo_have_no_answer(bench, length):
    assert bench.frame(0x600 + NODE, bytes(length)) == []


def test_other_nodes_are_not_meant(bench):
    assert bench.frame(0x601 + NODE, "40 00 10 00 00 00 00 00") == []


def test_parameters_are_stored_and_restored(bench):
    bench.write(0x6065, 0, 4321)
    bench.write(0x1010, 1, 0x65766173)
    bench.write(0x6065, 0, 99)
    bench.frame(0, bytes((0x81, NODE)))
    bench.run(0.1)
    assert bench.read(0x6065) == 4321
    bench.write(0x1011, 1, 0x64616F6C)
    assert bench.read(0x6065) == 4321  # until the next reset
    bench.frame(0, bytes((0x81, NODE)))
    bench.run(0.1)
    assert bench.read(0x6065) == 65536


def test_nothing_is_stored_while_the_motor_is_powered(bench):
    bench.enable()
    assert bench.abort_of(bench.write, 0x1010, 1, 0x65766173) == 0x08000022


def test_local_control_refuses_the_controlword(bench):
    bench.axis.local = True
    with pytest.raises(Aborted, match=str(0x08000021)):
        bench.control(6)
    assert not bench.statusword & 0x0200
