"""CRC-16 of protocol 2.0: both implementations, against the packets of the manual and the SDK's table."""

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.crc import crc16, table_crc16

PACKETS = [
    "FF FF FD 00 01 03 00 01 19 4E",
    "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
    "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
]

both = pytest.mark.parametrize("crc", [crc16, table_crc16], ids=["chosen", "table"])


def test_the_library_is_chosen_where_it_is_installed():
    fastcrc = pytest.importorskip("fastcrc")
    assert crc16 is fastcrc.crc16.umts


@both
@pytest.mark.parametrize("text", PACKETS)
def test_packets_of_the_manual(crc, text):
    data = bytes.fromhex(text)
    assert crc(data[:-2]).to_bytes(2, "little") == data[-2:]


@both
def test_the_check_value_of_the_catalogue(crc):
    assert crc(b"123456789") == 0xFEE8  # CRC-16/UMTS


@both
@given(data=st.binary(max_size=300), start=st.integers(0, 0xFFFF), cut=st.integers(0, 300))
def test_as_the_sdk_and_in_pieces(crc, data, start, cut):
    expected = Protocol2PacketHandler().updateCRC(start, data, len(data))
    assert crc(data, start) == expected
    assert crc(data[cut:], crc(data[:cut], start)) == expected
