"""The bytes of the TCP channel."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft import tcp49151 as tcp


def test_requests_are_20_bytes() -> None:
    assert tcp.encode_read() == bytes(20)
    assert tcp.encode_read(bias=True) == bytes(19) + b"\x01"
    assert tcp.encode_read(clear_latch=True) == bytes(19) + b"\x02"
    assert tcp.encode_read(True, True) == bytes(19) + b"\x03"
    assert tcp.encode_read_calibration() == b"\x01" + bytes(19)


def test_a_reading() -> None:
    reply = bytes.fromhex("1234 8002 0001 FFFF 7FFF 8000 0000 0100")
    assert tcp.decode_reading(reply) == (0x80020000, (1, -1, 32767, -32768, 0, 256))


def test_the_scale_of_a_nano17() -> None:
    reply = bytes.fromhex("1234 02 04 000F4240 000F4240 042D 042D 042D 1DCE 1DCE 1DCE")
    found = tcp.decode_calibration(reply)
    assert found.steps == (1069, 1069, 1069, 7630, 7630, 7630)
    assert found.factors[:3] == pytest.approx([1.069e-3] * 3)
    assert found.factors[3:] == pytest.approx([7.63e-6] * 3)  # N·mm per step, in N·m


@pytest.mark.parametrize(
    "reply",
    [
        "1234 09 04 000F4240 000F4240 042D 042D 042D 1DCE 1DCE 1DCE",
        "1234 02 00 000F4240 000F4240 042D 042D 042D 1DCE 1DCE 1DCE",
        "1234 02 04 00000000 000F4240 042D 042D 042D 1DCE 1DCE 1DCE",
        "4321 02 04 000F4240 000F4240 042D 042D 042D 1DCE 1DCE 1DCE",
        "1234 02 04 000F4240",
    ],
)
def test_a_scale_that_cannot_be_is_refused(reply) -> None:
    with pytest.raises(ValueError, match=r"units|above zero|header|bytes"):
        tcp.decode_calibration(bytes.fromhex(reply))


@given(st.binary(max_size=40))
def test_any_bytes_are_a_reply_or_an_error(data: bytes) -> None:
    for decode in (tcp.decode_reading, tcp.decode_calibration):
        try:
            decode(data)
        except ValueError:
            continue
