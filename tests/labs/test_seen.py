"""What an observer tells of the devices of other machines."""

import os
import select

import pytest

from crtk_drivers.labs.seen import Seen, read_seen
from crtk_drivers.samples import CLOCKS_AGREE


def test_what_is_seen_comes_over_a_pipe():
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    arm = Seen("arm", True, "ENABLED", measures=True, host="control", offset=0.0012)
    camera = Seen("camera", False, ago=12.3)
    lines = arm.line + camera.line
    os.write(writing, lines[:-5])
    found, rest = read_seen(reading, b"")
    assert found == [arm]
    os.write(writing, lines[-5:])
    assert read_seen(reading, rest) == ([camera], b"")
    os.close(writing)
    os.close(reading)


def test_a_line_fits_into_the_pipe_as_a_whole():
    line = Seen("arm", True, cause="x" * 9999 + "\N{SNOWMAN}", host="h" * 9999).line
    assert len(line) < select.PIPE_BUF
    assert line.endswith(b"\n")


@pytest.mark.parametrize("letter", ["\N{GRINNING FACE}", "\N{SNOWMAN}", '"', "\n", "\ud83d"])
def test_a_line_of_any_letters_fits_and_is_read(letter):
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    line = Seen("arm", True, cause=letter * 9999, host=letter * 9999).line
    assert len(line) < select.PIPE_BUF
    os.write(writing, line)
    [found], _ = read_seen(reading, b"")
    assert found.cause.startswith(letter)
    os.close(writing)
    os.close(reading)


@pytest.mark.parametrize(
    ("offset", "uncertainty", "other"),
    [
        (None, None, False),
        (0.9 * CLOCKS_AGREE, 0.0, False),
        (-2.0 * CLOCKS_AGREE, None, True),
        (2.0 * CLOCKS_AGREE, 1.5 * CLOCKS_AGREE, False),
    ],
)
def test_a_clock_is_judged_beyond_its_uncertainty(offset, uncertainty, other):
    seen = Seen("arm", True, offset=offset, uncertainty=uncertainty)
    assert seen.has_other_time is other
