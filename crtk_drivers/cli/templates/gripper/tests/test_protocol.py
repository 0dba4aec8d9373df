"""Known lines, lines cut anywhere, and lines that are none."""

import pytest

from crtk_driver_my_gripper.protocol import Report, decoder, opening_line

STREAM = b"G 40.00 0.00 1 0\nG 25.00 -10.00 0 1\n"
REPORTS = [Report(0.04, 0.0, True, False), Report(0.025, -0.01, False, True)]


def test_a_known_line() -> None:
    """As the README has it."""
    assert opening_line(0.025) == b"G 25.00\n"


@pytest.mark.parametrize("cut", range(len(STREAM) + 1))
def test_where_the_stream_is_cut_does_not_matter(cut: int) -> None:
    """A serial line keeps no boundaries."""
    stream = decoder()
    assert stream.feed(STREAM[:cut]) + stream.feed(STREAM[cut:]) == REPORTS


@pytest.mark.parametrize(
    "line", [b"", b"G", b"G 1 0 1", b"G nan 0 1 0", b"X 1 0 1 0", b"G \xff 0 1 0"]
)
def test_what_is_no_report_is_left_out_and_counted(line: bytes) -> None:
    """Nothing is guessed, and the next line counts again."""
    stream = decoder()
    assert stream.feed(STREAM + line + b"\n" + STREAM) == 2 * REPORTS
    assert stream.damage.total == 1
