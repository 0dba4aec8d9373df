"""Known lines, lines cut anywhere, and lines that are none."""

import pytest

from crtk_driver_my_sensor.protocol import TARED, Force, decoder

STREAM = b"N 12.3456\nOK\nN -250.0000 OVER\n"


@pytest.mark.parametrize("cut", range(len(STREAM) + 1))
def test_where_the_stream_is_cut_does_not_matter(cut: int) -> None:
    """A serial line keeps no boundaries."""
    stream = decoder()
    found = stream.feed(STREAM[:cut]) + stream.feed(STREAM[cut:])
    assert found == [Force(12.3456, False), TARED, Force(-250.0, True)]


@pytest.mark.parametrize("line", [b"", b"N", b"N x", b"N nan", b"X 1.0", b"N 1.0 more", b"N \xff"])
def test_what_is_no_message_is_left_out_and_counted(line: bytes) -> None:
    """Nothing is guessed, and the next line counts again."""
    stream = decoder()
    assert stream.feed(b"N 1.0\n" + line + b"\n" + b"N 1.0\n") == 2 * [Force(1.0, False)]
    assert stream.damage.total == 1
