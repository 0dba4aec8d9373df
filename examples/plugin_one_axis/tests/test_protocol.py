"""Known lines, lines cut anywhere, and lines that are none."""

import pytest
from crtk_driver_one_axis.protocol import Report, decoder, position_line, velocity_line

from crtk_drivers.kit import BadData

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
def test_what_is_no_report_is_refused(line: bytes) -> None:
    """Nothing is guessed."""
    with pytest.raises(BadData):
        decoder().feed(line + b"\n")


def test_a_line_without_end_is_refused() -> None:
    """Memory stays bounded."""
    with pytest.raises(BadData, match="without an end"):
        decoder().feed(b"M" * 1000)
