"""Known lines, lines cut anywhere, and lines that are none."""

import pytest
from crtk_driver_one_axis.protocol import Report, decoder, position_line, velocity_line

STREAM = b"M 0.250000 -0.010000 1\nM 0.260000 0.000000 0 motor overload\n"
REPORTS = [Report(0.25, -0.01, True, ""), Report(0.26, 0.0, False, "motor overload")]


def test_known_lines() -> None:
    """As the README has them."""
    assert position_line(0.25) == b"P 0.250000\n"
    assert velocity_line(-0.1) == b"V -0.100000\n"
    assert decoder().feed(STREAM) == REPORTS


@pytest.mark.parametrize("cut", range(len(STREAM) + 1))
def test_where_the_stream_is_cut_does_not_matter(cut: int) -> None:
    """TCP keeps no boundaries."""
    stream = decoder()
    assert stream.feed(STREAM[:cut]) + stream.feed(STREAM[cut:]) == REPORTS


@pytest.mark.parametrize(
    "line", [b"", b"M", b"X 0 0 1", b"M nan 0 1", b"M 0 inf 1", b"M a b c", b"M \xff 0 1"]
)
def test_what_is_no_report_is_left_out_and_counted(line: bytes) -> None:
    """Nothing is guessed, and the next line counts again."""
    stream = decoder()
    assert stream.feed(STREAM + line + b"\n" + STREAM) == 2 * REPORTS
    assert stream.damage.total == 1


def test_a_line_without_end_is_left_out() -> None:
    """Memory stays bounded."""
    stream = decoder()
    assert stream.feed(b"M" * 1000) == []
    assert "without an end" in stream.damage.last
