"""Script text is cut into the same programs and lines however the stream is split."""

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.ur.ports.script_port import MAX_PROGRAM, ScriptCutter

PROGRAM = """def prog():
  # an end in a comment, and a "quote
  textmsg("if it ends # here: end", 1)
  global blend = 3
  thread worker():
    while True:
      sync()
    end
  end
  if blend == 3:
    endless = 1
  elif blend == 4:
    end_force_mode()
  else:
    stopj(2)
  end
end"""

SECONDARY = "sec second():\n  set_digital_out(1, True)\nend"
ONE_LINE = "def short(): stopj(2) end"

STREAM = (
    "\r\nstop program\n"
    "# a comment: def nothing()\n"
    f"{PROGRAM}\n"
    "   movej([0, -1.5, 1, 0, 0, 0], a=1)\r\n"
    f"  {SECONDARY}\r\n"
    f"{ONE_LINE}\n"
    "define = 3\n"
    "\n\n"
    f"{PROGRAM}\n"
)
UNITS = [
    "stop program",
    PROGRAM,
    "movej([0, -1.5, 1, 0, 0, 0], a=1)",
    SECONDARY,
    ONE_LINE,
    "define = 3",
    PROGRAM,
]


def cut(pieces):
    cutter = ScriptCutter()
    return [unit for piece in pieces for unit in cutter.feed(piece)]


def test_a_stream_is_cut_into_programs_and_lines():
    assert cut([STREAM.encode()]) == UNITS


def test_a_stream_may_be_split_at_every_single_place():
    data = STREAM.encode()
    for place in range(len(data)):
        assert cut([data[:place], data[place:]]) == UNITS, place


@given(st.lists(st.integers(0, len(STREAM)), max_size=30))
def test_a_stream_may_be_split_anywhere(places):
    data = STREAM.encode()
    bounds = [0, *sorted(places), len(data)]
    pieces = [data[a:b] for a, b in itertools.pairwise(bounds)]
    assert cut(pieces) == UNITS


@given(st.lists(st.binary(max_size=50), max_size=20))
def test_nonsense_is_cut_into_lines_and_survived(pieces):
    cutter = ScriptCutter()
    for piece in pieces:
        cutter.feed(piece)
    cutter.finish()
    assert all(unit.strip() for unit in cutter.feed(b"\n"))


@pytest.mark.parametrize(
    "statement",
    [
        "s = struct(a=1, for_=2)",
        "textmsg(time(2).sec)",
        "textmsg('while it # lasts')",
        "textmsg(\"it's an if\") # isn't it if",
        "$ 3 'def'",
        "for = 1 switch = 2",
    ],
)
def test_what_only_looks_like_a_block_opens_none(statement):
    program = f"def p():\n  {statement}\nend"
    assert cut([f"{program}\ntextmsg(1)\n".encode()]) == [program, "textmsg(1)"]


def test_an_unfinished_program_is_kept_and_not_run():
    cutter = ScriptCutter()
    assert cutter.feed(PROGRAM.removesuffix("end").encode()) == []
    assert cutter.finish() == []
    assert cutter.feed(b"end\n") != []


@pytest.mark.parametrize("unit", [PROGRAM, ONE_LINE, "stopj(2)"])
def test_the_last_unit_needs_no_line_end_when_the_client_closes(unit):
    cutter = ScriptCutter()
    assert cutter.feed(unit.encode()) == []
    assert cutter.finish() == [unit]
    assert cutter.finish() == []


def test_an_endless_program_is_given_up():
    cutter = ScriptCutter()
    line = b"  x = 1\n" * 1000
    cutter.feed(b"def endless():\n")
    fed = 0
    while cutter.discarded == 0:
        assert cutter.feed(line) == []
        fed += len(line)
        assert fed <= MAX_PROGRAM + len(line)
    assert cutter.feed(b"stopj(2)\n") == ["stopj(2)"]


def test_a_program_in_small_pieces_takes_time_in_proportion_to_its_length():
    """Each byte is looked at once: a quadratic cutter does not finish this within its limit."""
    text = b"def big():\n" + b"  x = 1 # some text\n" * 40_000 + b"end\n"
    generator = random.Random(1)
    cutter = ScriptCutter()
    units, place = [], 0
    while place < len(text):
        size = generator.randrange(1, 200)
        units += cutter.feed(text[place : place + size])
        place += size
    assert units == [text.decode().strip()]
