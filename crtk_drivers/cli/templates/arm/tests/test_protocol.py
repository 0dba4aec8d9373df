"""Known lines, lines cut anywhere, and lines that are none."""

import pytest

from crtk_driver_my_arm.protocol import Report, decoder, position_line, velocity_line

STREAM = b"M 0.1 0.2 0.3 0 0 -0.5 1\nM 0 0 0 0 0 0 0 motor overload\n"
REPORTS = [
    Report((0.1, 0.2, 0.3), (0.0, 0.0, -0.5), True, ""),
    Report((0.0,) * 3, (0.0,) * 3, False, "motor overload"),
]


def test_known_lines() -> None:
    """As the README has them."""
    assert position_line([0.1, 0.2, 0.3]) == b"P 0.100000 0.200000 0.300000\n"
    assert velocity_line([0.1, 0.0, -0.5]) == b"V 0.100000 0.000000 -0.500000\n"


@pytest.mark.parametrize("cut", range(len(STREAM) + 1))
def test_where_the_stream_is_cut_does_not_matter(cut: int) -> None:
    """TCP keeps no boundaries."""
    stream = decoder()
    assert stream.feed(STREAM[:cut]) + stream.feed(STREAM[cut:]) == REPORTS


@pytest.mark.parametrize(
    "line",
    [b"", b"M", b"M 0 0 0 0 0 0", b"M 0 0 0 0 0 nan 1", b"X 0 0 0 0 0 0 1", b"M 0 0 0 0 0 x 1"],
)
def test_what_is_no_report_is_left_out_and_counted(line: bytes) -> None:
    """Nothing is guessed, and the next line counts again."""
    stream = decoder()
    assert stream.feed(STREAM + line + b"\n" + STREAM) == 2 * REPORTS
    assert stream.damage.total == 1
